"""What robots note of themselves comes back: exact at the end, rounded on the way, cut or whole."""

from pathlib import Path

import numpy as np
import pytest
from diary_helpers import FRAME, grids, pose_at, written_run
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import Floats
from comms.timebase import NS
from scenarios.logs import diary
from scenarios.logs.diary import STEPS, Chart, Diary, LogTail, Note, draw
from scenarios.logs.notebook import LogFile

ALL = diary.TOPICS
MAPS = frozenset((diary.TEAM_MAP,))


def known(values: Floats) -> Floats:
    return np.where(np.isfinite(values), values, np.nan)


def drawn(notes: list[Note]) -> list[Chart]:
    charts: list[Chart] = []
    for note in notes:
        charts.append(draw(charts[-1] if charts else None, note.data))
    return charts


@given(seed=st.integers(0, 2**32), kind=st.sampled_from(["elevation", "planar"]))
@settings(max_examples=15, deadline=None)
def test_maps_come_back_within_their_steps_and_at_the_end_exactly(
    tmp_path_factory: pytest.TempPathFactory, seed: int, kind: str
) -> None:
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    log = LogFile(path)
    book = Diary(log, FRAME, NS)
    told = [grids(kind, rng) for _ in range(4)]
    for second, one in enumerate(told):
        changed = rng.random(FRAME.shape) < 0.3
        if second:
            for name, values in one.items():
                one[name] = np.where(changed, values, told[second - 1][name])
        book.map(second * NS, one)
    book.map(9 * NS, told[-1], whole=True)
    log.close()
    charts = drawn(LogTail(path, "a").read(MAPS))
    assert len(charts) == 5
    for chart, one in zip(charts, told, strict=False):
        assert chart.frame == FRAME
        for name, values in one.items():
            np.testing.assert_allclose(chart.layers[name], known(values), atol=0.51 * STEPS[name])
    for name, values in told[-1].items():
        assert np.array_equal(charts[-1].layers[name], known(values).astype("f4"), equal_nan=True)


def test_what_has_not_changed_costs_next_to_nothing(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "a.mcap")
    book = Diary(log, FRAME, NS)
    one = grids("elevation", np.random.default_rng(0))
    book.map(0, one)
    book.map(NS, {name: values + 0.1 * STEPS["sigma"] for name, values in one.items()})
    log.close()
    first, second = LogTail(tmp_path / "a.mcap", "a").read(MAPS)
    assert len(second.data) < 0.5 * len(first.data)
    assert np.isfinite(draw(draw(None, first.data), second.data).layers["elevation"]).any()


def test_a_new_life_begins_with_its_own_map(tmp_path: Path) -> None:
    charts: list[Chart] = []
    for life in (0, 1):
        one = grids("elevation", np.random.default_rng(life))
        log = LogFile(tmp_path / "a.mcap")
        Diary(log, FRAME, NS).map(0, one)
        log.close()
        (note,) = LogTail(tmp_path / "a.mcap", "a").read(MAPS)
        charts.append(draw(charts[-1] if charts else None, note.data))
        unknown = np.isnan(charts[-1].layers["elevation"])
        assert np.array_equal(unknown, np.isnan(one["elevation"]))


def test_maps_are_due_at_whole_multiples(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "a.mcap")
    book = Diary(log, FRAME, 5 * NS)
    assert book.is_due(0)
    book.map(2 * NS, grids("planar", np.random.default_rng(0)))
    assert [book.is_due(second * NS) for second in (4, 5)] == [False, True]
    log.close()
    assert not Diary(None, FRAME, NS).is_due(0)


def test_poses_and_looks_come_back(tmp_path: Path) -> None:
    written_run(tmp_path)
    notes = LogTail(tmp_path / "recon.mcap", "recon").read(ALL)
    poses = [diary.read_pose(note.data) for note in notes if note.topic == diary.POSE]
    assert [pose.true for pose in poses] == [pose_at(second) for second in range(61)]
    assert poses[7].believed == pose_at(7, 0.1)
    assert not poses[7].still
    looks = [diary.read_seen(note.data) for note in notes if note.topic == diary.SEEN]
    assert [look.points_m.shape for look in looks] == [(40, 3)] * 3
    assert looks[0].tilt_rad == -0.2
    middles = [look.points_m.mean(axis=0) for look in looks]
    wants = [pose_at(second, 0.1) for second in (10, 30, 50)]
    for middle, want in zip(middles, wants, strict=True):
        np.testing.assert_allclose(middle, (want.x_m, want.y_m, want.z_m), atol=0.6)


@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_a_growing_log_tells_all_once_and_nothing_of_what_is_torn(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("run")
    written_run(folder, "planar", seconds=12)
    whole = (folder / "explorer-1.mcap").read_bytes()
    want = LogTail(folder / "explorer-1.mcap", "x").read(ALL)
    growing = folder / "growing.mcap"
    cuts = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=6)))
    tail, got = LogTail(growing, "x"), list[Note]()
    for cut in [*cuts, len(whole)]:
        growing.write_bytes(whole[:cut])
        got += tail.read(ALL)
    assert got == want
