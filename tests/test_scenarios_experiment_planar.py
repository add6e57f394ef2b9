"""The planar experiments on tiny floors, what they conclude, and the oracle beside them."""

import importlib
import math
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from agents.planar.sensing import MAPPED
from scenarios.errors import StudyError, UsageError
from scenarios.experiments import planar_one, planar_two
from scenarios.experiments.figure import save_figure
from scenarios.experiments.frame import Options
from scenarios.experiments.planar_claims import conclude, curve
from scenarios.experiments.planar_runs import (
    DRIVE,
    METHODS,
    OURS,
    PAPER,
    VARIANTS,
    Trial,
    measure,
    sensor_of,
    world_of,
)
from scenarios.experiments.tables import Row
from sim.planar_world import lattice


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Write a floor of two rooms with a door between them."""
    folder = tmp_path_factory.mktemp("floor")
    pixels = np.full((30, 50), 254, dtype=np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = 0
    pixels[:, 25] = 0
    pixels[12:16, 25] = 254
    assert cv2.imwrite(str(folder / "rooms.png"), pixels)
    path = folder / "rooms.yaml"
    path.write_text(
        "image: rooms.png\nresolution: 0.4\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return str(path)


@pytest.fixture(scope="module")
def rows(plan: str) -> Sequence[Row]:
    trials = [Trial(plan, 1, method, 1, 90.0, 6.0, 40) for method in METHODS]
    trials += [Trial(plan, 1, OURS, robots, 75.0, 6.0, 40) for robots in (1, 2)][1:]
    return [row for trial in trials for row in measure(trial)]


def runs(rows: Sequence[Row], method: str, robots: int = 1) -> Row:
    chosen = [r for r in rows if (r["row"], r["method"], r["robots"]) == ("run", method, robots)]
    assert len(chosen) == 1
    return chosen[0]


def test_a_trial_tells_of_the_run_and_of_each_look(rows: Sequence[Row]) -> None:
    run = runs(rows, OURS)
    assert run["ended"] in ("done", "goal")
    assert float(run["coverage"]) > 0.9
    assert 1 <= float(run["looks_to_goal"]) <= float(run["looks"])
    assert float(run["driven_to_goal_m"]) <= float(run["driven_m"])
    assert run["bumps"] == 0
    looks = [r for r in rows if (r["row"], r["method"], r["robots"]) == ("look", OURS, 1)]
    assert [r["look"] for r in looks] == list(range(1, int(run["looks"]) + 1))
    assert looks[-1]["coverage"] == run["coverage"]
    driven = [float(r["driven_m"]) for r in looks]
    assert driven == sorted(driven)


def test_a_goal_that_is_not_reached_is_never_reached(plan: str) -> None:
    run = measure(Trial(plan, 1, "information", 1, 90.0, 6.0, 2))[0]
    assert run["ended"] == "looks"
    assert math.isinf(float(run["looks_to_goal"]))


def test_the_same_seed_gives_the_same_rows(plan: str) -> None:
    trial = Trial(plan, 3, OURS, 2, 75.0, 6.0, 8)
    once, again = (
        [{key: value for key, value in row.items() if not key.endswith("_cpu_s")} for row in rows]
        for rows in (measure(trial), measure(trial))
    )
    assert once == again


def test_made_up_squares_of_other_sizes_are_told_apart() -> None:
    small, large = (planar_one.trials(Options(1, {"side": [m]}))[0] for m in ("24", "100"))
    assert (small.place, large.place) == ("made-up-24m", "made-up")
    world, seen = world_of("", 1, 90.0, 6.0, small.side_m)
    assert world.frame.shape == seen.shape == (60, 60)


def test_our_way_needs_less_than_chance(rows: Sequence[Row]) -> None:
    ours, lot = runs(rows, OURS), runs(rows, "random")
    assert float(ours["looks_to_goal"]) < float(lot["looks_to_goal"])
    assert float(ours["driven_to_goal_m"]) < float(lot["driven_to_goal_m"])


def test_every_claim_gets_a_verdict_and_a_number(rows: Sequence[Row]) -> None:
    one = [row for row in rows if row["robots"] == 1]
    findings = conclude(one)
    assert [table.name for table in findings.tables] == ["methods-rooms"]
    assert len(findings.tables[0].rows) == len(METHODS)
    sources = [claim.source for claim in findings.claims]
    assert sources == ["section 3.1"] * 4 + ["ours"] * 2
    assert all("rooms: " in claim.text and claim.found for claim in findings.claims)


def told(method: str, robots: int, looks: float, driven_m: float, time_s: float) -> list[Row]:
    base: Row = {"world": "w", "seed": 1, "method": method, "robots": robots}
    run: Row = {
        **base, "row": "run", "looks_to_goal": looks, "driven_to_goal_m": driven_m,
        "time_to_goal_s": time_s, "looks": 10, "driven_m": driven_m, "coverage": 0.9,
        "area_m2": 90.0, "run_cpu_s": 1.0,
    }  # fmt: skip
    series: list[Row] = [
        {**base, "row": "look", "look": n, "driven_m": n * driven_m / 10, "coverage": 0.09 * n}
        for n in range(1, 11)
    ]
    return [run, *series]


def test_verdicts_by_hand() -> None:
    driven_m = {"random": 900.0, "raster": 500.0, "max-new": 210.0, "min-old": 300.0, OURS: 110.0}
    rows = [
        row
        for method in (*PAPER, *VARIANTS, OURS)
        for row in told(method, 2, 10.0, driven_m.get(method, 200.0), 61.0)
    ]
    rows += told(OURS, 1, 10.0, 110.0, 100.0)
    held = {claim.text.removeprefix("w: "): claim for claim in conclude(rows).claims}
    assert held["(v) maps the most area per distance moved"].number == pytest.approx(210 / 200)
    assert held["(i) maps the least area per distance moved"].held
    ours = next(claim for text, claim in held.items() if "at most 0.6 times as far" in text)
    assert ours.number == pytest.approx(0.55)
    assert ours.held
    two = next(claim for text, claim in held.items() if "two robots" in text)
    assert two.number == pytest.approx(0.61)
    assert not two.held


def test_a_curve_stays_where_its_run_ended() -> None:
    rows = told("random", 1, 10.0, 100.0, 1.0)
    assert curve(rows, "w", "random", "driven_m", 12, 1)[-3:] == pytest.approx([100.0] * 3)


def test_a_figure_is_drawn(rows: Sequence[Row], tmp_path: Path) -> None:
    path = tmp_path / "figure.png"
    one = [row for row in rows if row["robots"] == 1]
    save_figure(path, lambda figure: planar_one.EXPERIMENT.draw(figure, one))
    assert path.stat().st_size > 10_000


def test_two_robots_are_compared_with_one_of_the_same_sensor(plan: str) -> None:
    options = Options(2, {"map": [plan], "method": ["random", OURS]})
    trials = planar_two.trials(options)
    assert [(t.method, t.robots) for t in trials].count((OURS, 1)) == 2
    assert {(t.fov_deg, t.range_m) for t in trials} == {(75.0, 10.0)}
    assert len(trials) == 6


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        ({"method": ["best"]}, "must be one of random"),
        ({"looks": ["0"]}, "at least 1"),
        ({"looks": ["many"]}, "at least 1"),
        ({"side": ["-3"]}, "above 0"),
        ({"side": ["3"]}, "at least 10"),
    ],
)
def test_bad_settings_are_refused(sets: dict[str, list[str]], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        planar_one.trials(Options(1, sets))


def test_a_map_that_is_absent_is_refused() -> None:
    with pytest.raises(StudyError, match=r"nowhere.yaml"):
        planar_one.trials(Options(1, {"map": ["nowhere.yaml"]}))


# --- the oracle -----------------------------------------------------------------------------


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks"))
    return importlib.import_module("planar_oracle")


def test_the_oracle_takes_the_look_that_maps_most_each_time(script: ModuleType, plan: str) -> None:
    sensor = sensor_of(90.0, 6.0)
    world, seen = world_of(plan, 0, 90.0, 6.0)
    looks = script.all_looks(world, sensor, lattice(world, DRIVE.footprint_m))
    taken, share = script.oracle(world, seen, looks, 0.9)
    assert share >= 0.9
    log_odds, gains = np.zeros(world.solid.size), list[int]()
    for look in taken:
        best = 0
        for n in range(len(looks.first) - 1):
            part = slice(looks.first[n], looks.first[n + 1])
            after = log_odds[looks.cells[part]] + looks.added[part]
            fresh = (np.abs(after) > MAPPED) & (np.abs(log_odds[looks.cells[part]]) <= MAPPED)
            best = max(best, int((fresh & seen.ravel()[looks.cells[part]]).sum()))
        before = (np.abs(log_odds) > MAPPED) & seen.ravel()
        part = slice(looks.first[look], looks.first[look + 1])
        log_odds[looks.cells[part]] += looks.added[part]
        gains.append(int((((np.abs(log_odds) > MAPPED) & seen.ravel()) & ~before).sum()))
        assert gains[-1] == best
    assert sum(gains) == round(share * seen.sum())


def test_the_oracles_tour_goes_through_all_its_places(script: ModuleType, plan: str) -> None:
    world, _ = world_of(plan, 0, 90.0, 6.0)
    row, col = world.start
    east = np.array([[row, col + 5], [row, col + 2], [row, col]])
    assert script.tour_m(world, east, DRIVE.footprint_m) == pytest.approx(5 * 0.4)


def test_the_oracles_table_is_markdown(
    script: ModuleType, plan: str, capsys: pytest.CaptureFixture[str]
) -> None:
    ours = ["--map", plan, "--range-m", "6", "--seeds", "1", "--method", OURS]
    assert script.main(ours) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.count("|") for line in lines] == [7] * 4
    assert lines[2].startswith("| rooms | oracle (a tour) | ")


def test_the_oracles_table_ends_in_means(
    script: ModuleType, plan: str, capsys: pytest.CaptureFixture[str]
) -> None:
    two = ["--map", plan, "--range-m", "6", "--seeds", "2", "--first-seed", "5", "--method", OURS]
    assert script.main(two) == 0
    cells = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines()[2:]]
    ours = [float(line[3]) for line in cells if OURS in line[1]]
    assert cells[-1][0].strip() == "mean of 2"
    assert ours[2] == pytest.approx(0.5 * (ours[0] + ours[1]), abs=0.011)
    assert script.main(["--side-m", "1"]) == 2


def test_a_map_that_is_absent_ends_the_oracle(script: ModuleType) -> None:
    assert script.main(["--map", "nowhere.yaml"]) == 2
