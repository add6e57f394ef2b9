from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.image import imread

from agents.geometry import GridFrame, Singles
from scenarios.palette import MANY, in_kind_order, kind_colour, robot_colours
from scenarios.pictures.charts import draw_bytes_by_robot, draw_information, sent_kb
from scenarios.pictures.overview import Overview, caption, draw, map_facts
from scenarios.pictures.shading import UNKNOWN_RGB, colours, hillshade, relief
from scenarios.records.summary import Ending, RobotFinal, Truth, summarise
from scenarios.records.tables import EventRow, LookRow, MapRow, Records, TxRow
from scenarios.schema import load

FRAME = GridFrame(100.0, 50.0, 0.5, 24, 32)


def ground() -> Singles:
    north, east = np.mgrid[0:24, 0:32]
    return (0.1 * north + np.sin(east / 3)).astype(np.float32)


def overview(robots: int, *, mapped: bool) -> Overview:
    scenario = load("pair", [f"robots.count={robots}"])
    records = Records(list(scenario.robots))
    truth = Truth(ground(), np.ones((24, 32), bool))
    finals = [
        RobotFinal(
            name,
            "killed" if index else "alive",
            *(5, 9, "aa", 1.0, 10),
            elevation_m=ground() + np.float32(0.1) if mapped else None,
            sigma_m=np.ones((24, 32), np.float32),
        )
        for index, name in enumerate(scenario.robots)
    ]
    if mapped:
        for index, name in enumerate(scenario.robots):
            for seq in range(4):
                t_s = 100.0 * seq
                spot = (104.0 + index, 55.0 + seq, 0.0)
                records.add(LookRow(name, t_s, *spot, 0, 0, 10, 9, 9, 0.0, 0.1))
                records.add(TxRow(name, seq, ("map", "digest")[seq % 2], 99, t_s, t_s, t_s + 1))
                records.add(MapRow(t_s, name, 1, 1, 50.0 * seq, None, 1, 50.0, 0.0))
        records.add(EventRow(200.0, "explorer-1", "kill", ""))
    ending = Ending(400.0, "partial", "the limit was reached")
    summary = summarise(scenario, records, finals, truth, ending)
    return Overview(scenario.title, summary, FRAME, truth, finals, records)


@pytest.mark.parametrize(("robots", "mapped"), [(1, False), (2, True), (9, True)])
def test_a_picture_is_drawn_of_any_team(robots: int, mapped: bool, tmp_path: Path) -> None:
    draw(tmp_path / "overview.png", overview(robots, mapped=mapped))
    picture = imread(tmp_path / "overview.png")
    assert picture.shape[0] > 800
    assert picture.shape[1] > 1200
    assert np.ptp(picture[..., :3], axis=(0, 1)).min() > 0.5
    assert [path.name for path in tmp_path.iterdir()] == ["overview.png"]


def test_the_caption_tells_the_outcome_and_the_figures() -> None:
    told = caption(overview(2, mapped=True).summary)
    assert told.splitlines()[0] == "Partial: the limit was reached"
    words = ("6.7 simulated minutes", "100 % of what", "error 10.0 cm rms", "0.8 kB sent")
    assert all(word in told for word in words)
    assert "rms" not in caption(overview(1, mapped=False).summary)


def test_a_map_is_told_in_a_few_words() -> None:
    shown = overview(2, mapped=True)
    assert map_facts(shown.robots[0], shown.truth) == "100 % of what can be seen, 10.0 cm rms"
    assert map_facts(overview(1, mapped=False).robots[0], shown.truth) == ""


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6))
def test_what_is_unknown_has_its_colour_and_nothing_else_has(seed: int) -> None:
    rng = np.random.default_rng(seed)
    elevation_m = rng.normal(0, 2, (6, 7)).astype(np.float32)
    unknown = rng.random((6, 7)) < 0.4
    elevation_m[unknown] = np.nan
    picture = relief(elevation_m, 0.1, -3.0, 3.0)
    assert picture.min() >= 0.0
    assert picture.max() <= 1.0
    np.testing.assert_array_equal((picture == UNKNOWN_RGB).all(axis=-1), unknown)


def test_lightness_rises_with_height() -> None:
    luminance = colours(np.linspace(0, 1, 100)) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) > 0).all()


def test_light_comes_from_the_north_west_and_level_ground_is_in_the_middle() -> None:
    north, east = np.mgrid[0:5, 0:5].astype(np.float32)
    assert hillshade(np.full((5, 5), 7, np.float32), 1.0) == pytest.approx(0.5)
    towards, away = (hillshade(sign * 0.2 * (east - north), 1.0)[2, 2] for sign in (1, -1))
    assert towards > 0.55
    assert away < 0.45
    assert hillshade(np.zeros((1, 3), np.float32), 1.0).shape == (1, 3)


def test_bytes_count_when_their_transmission_has_ended() -> None:
    records = Records(["a", "b"])
    for seq, (kind, start_s) in enumerate((("map", 0.0), ("map", 5.0), ("digest", 2.0))):
        records.add(TxRow("a", seq, kind, 500, start_s, start_s, start_s + 2))
    times_s = np.array([0.0, 1.9, 2.0, 6.9, 7.0, 99.0])
    assert sent_kb(records, "map", times_s).tolist() == [0, 0, 0.5, 0.5, 1, 1]
    assert sent_kb(records, "digest", times_s)[-1] == 0.5


def test_robots_and_kinds_have_colours_of_their_own() -> None:
    assert len(set(robot_colours("abcdef").values())) == 6
    assert robot_colours("ba") == robot_colours("ab")
    kinds = ["map", "anchor", "digest", "status", "tether", "fix", "stop"]
    assert len({kind_colour(kind) for kind in kinds}) == len(kinds)
    assert in_kind_order(["zebra", "stop", "map", "map"]) == ["map", "stop", "zebra"]


@pytest.mark.parametrize("robots", [MANY, MANY + 1, 64])
def test_a_picture_of_many_keeps_its_panels_and_names_no_crowd(robots: int, tmp_path: Path) -> None:
    """What has no room is squeezed out by matplotlib with a warning, and warnings are errors."""
    shown = overview(robots, mapped=True)
    draw(tmp_path / "overview.png", shown)
    figure = Figure()
    bars, curves = figure.subplots(1, 2)
    draw_bytes_by_robot(bars, shown.records)
    draw_information(curves, shown.records, 400.0)
    names = [label.get_text() for label in bars.get_yticklabels()]
    assert len(names) == MANY
    assert (f"mean of {robots - MANY + 1} more" in names) == (robots > MANY)
    assert len(curves.get_legend().get_texts()) <= MANY


def test_the_bar_of_the_rest_is_their_mean() -> None:
    shown = overview(MANY + 3, mapped=False)
    for n, name in enumerate(shown.records.robots):
        shown.records.add(TxRow(name, 0, "map", 1000 * (n + 1), 0.0, 0.0, 1.0))
    axes = Figure().subplots()
    draw_bytes_by_robot(axes, shown.records)
    told = [float(text.get_text()) for text in axes.texts]
    assert told[:2] == [MANY + 3, MANY + 2]
    assert told[-1] == np.mean([1, 2, 3, 4])
