"""One robot's mind: it believes no nonsense, and comes back from death without counting twice."""

import asyncio
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_helpers import START, hear, log_of, measure, robot_on, save, say
from sim_helpers import run
from team_helpers import FRAME, GRID, SURE, chunks_of, layer, look

from agents.briefing import ACTIVITIES
from agents.geometry import Pose
from agents.messages import (
    Fix,
    Status,
    pack_anchor,
    pack_chunks,
    pack_fix,
    pack_status,
)
from agents.ports import Hardware, Odometry
from agents.pose.posefilter import PoseFilter
from agents.robot import Robot
from agents.sharing.reports import Holdings, Report, pack_report
from agents.store import AnchorKey, Chunk, Origin, TileKey
from comms.codec import CodecError, DecodedTile, decode_tile
from comms.frames import Kind

quick = settings(max_examples=20, deadline=None)
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return robot_on(tmp_path)


# --- what it hears --------------------------------------------------------------------------


@given(st.lists(st.tuples(st.sampled_from(list(Kind)), st.binary(max_size=60)), max_size=8))
@settings(max_examples=60, deadline=None)
def test_whatever_is_heard_the_robot_goes_on(
    tmp_path_factory: pytest.TempPathFactory, frames: list[tuple[Kind, bytes]]
) -> None:
    robot = robot_on(tmp_path_factory.mktemp("robot"))
    measure(robot, look(np.random.default_rng(1)))
    for kind, payload in frames:
        before = (robot.store.digest(), len(log_of(robot).told("refused")))
        hear(robot, kind, payload)
        after = (robot.store.digest(), len(log_of(robot).told("refused")))
        assert after[0] == before[0] or after[1] == before[1], "refused, so nothing changed"
    assert say(robot, 12), "its own map goes out as ever"
    robot.team.fused()
    robot.mapper.view()


@given(seeds, st.integers(0, 200), st.integers(1, 255))
@quick
def test_a_map_of_which_a_byte_is_wrong_does_no_harm(
    tmp_path_factory: pytest.TempPathFactory, seed: int, at: int, flip: int
) -> None:
    """Its sender made it so: no check of the frame can find it."""
    robot = robot_on(tmp_path_factory.mktemp("robot"))
    theirs = layer(np.random.default_rng(seed))
    for chunk in chunks_of(theirs, Origin(1, 0)):
        data = bytearray(chunk.data)
        data[at % len(data)] ^= flip
        wrong = Chunk(chunk.key, 1, chunk.total, 0, bytes(data))
        hear(robot, Kind.MAP, pack_chunks([wrong], (1, 0)))
    key, anchor = AnchorKey(1, 0, 0), theirs.submaps[0].anchor
    hear(robot, Kind.ANCHOR, pack_anchor(key, anchor))
    robot.team.fused()
    say(robot, 12)
    mended = [Chunk(c.key, 2, c.total, 0, c.data) for c in chunks_of(theirs, Origin(1, 0))]
    for chunk in mended:
        hear(robot, Kind.MAP, pack_chunks([chunk], (1, 0)))
    known = robot.team.fused().known
    assert np.array_equal(known, theirs.submaps[0].known), "the next version mends it"


def test_bytes_that_are_no_map_tell_nothing_and_stop_nothing(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    no_map = b"no map" * 5

    def decode(prefix: bytes) -> DecodedTile:
        if prefix.startswith(no_map[:6]):
            raise CodecError("no map")
        return decode_tile(prefix)

    monkeypatch.setattr("agents.payloads.decode_tile", decode)
    measure(robot, look(np.random.default_rng(3)))
    for tile in range(GRID.count):
        chunk = Chunk(TileKey(1, 0, 0, tile), 1, len(no_map), 0, no_map)
        hear(robot, Kind.MAP, pack_chunks([chunk], (1, 0)))
    anchor = layer(np.random.default_rng(1)).submaps[0].anchor
    hear(robot, Kind.ANCHOR, pack_anchor(AnchorKey(1, 0, 0), anchor))
    assert np.array_equal(robot.team.fused().known, robot.own.submaps[0].known)
    hear(robot, Kind.DIGEST, pack_report(Report((), Holdings((), ()))), sender=2)
    relayed = [chunk for chunk in say(robot, 30) if chunk.key.robot == 1]
    assert relayed, "stores are equal everywhere, whatever is in them"


def test_a_tile_beyond_the_map_is_refused(robot: Robot) -> None:
    hear(robot, Kind.MAP, pack_chunks([Chunk(TileKey(1, 0, 0, 99), 1, 1, 0, b"a")], (1, 0)))
    assert "tile 99" in log_of(robot).told("refused")[0]
    assert robot.store.keys() == []


@pytest.mark.parametrize("stranger", [4, 255])
def test_a_map_or_an_anchor_of_nobody_is_refused(robot: Robot, stranger: int) -> None:
    chunk = Chunk(TileKey(stranger, 0, 0, 0), 1, 1, 0, b"a")
    hear(robot, Kind.MAP, pack_chunks([chunk], (1, 0)))
    anchor = layer(np.random.default_rng(1)).submaps[0].anchor
    hear(robot, Kind.ANCHOR, pack_anchor(AnchorKey(stranger, 0, 0), anchor))
    assert len(log_of(robot).told("refused")) == 2
    assert f"robot {stranger}" in log_of(robot).told("refused")[0]
    assert (robot.store.keys(), robot.store.anchors) == ([], {})


def test_nobody_else_writes_this_robots_own_layer(robot: Robot) -> None:
    """Its own tiles come back by relay; what it never published comes from nobody."""
    measure(robot, look(np.random.default_rng(2)))
    assert say(robot, 12)
    digest = robot.store.digest()
    for version in (1, 99):
        chunk = Chunk(TileKey(*robot.me, 0, 0), version, 3, 0, b"lie")
        hear(robot, Kind.MAP, pack_chunks([chunk], (1, 0)))
    anchor = robot.own.submaps[0].anchor.moved_to(Pose(0, 0, 9, 0), (1e-8,) * 4)
    hear(robot, Kind.ANCHOR, pack_anchor(AnchorKey(*robot.me, 0), anchor))
    assert robot.store.digest() == digest


def test_a_status_that_says_what_no_robot_does_is_refused(robot: Robot) -> None:
    variance = robot.own.begin_submap(START, SURE).anchor.variance
    good = Status(START, variance, len(ACTIVITIES) - 1)
    hear(robot, Kind.STATUS, pack_status(good))
    assert robot.mates[1].status.activity == len(ACTIVITIES) - 1
    hear(robot, Kind.STATUS, pack_status(Status(START, variance, len(ACTIVITIES))))
    assert robot.mates[1].status == good
    assert f"activity {len(ACTIVITIES)}" in log_of(robot).told("refused")[0]


def test_a_fix_is_for_whom_it_names_and_only_if_it_can_be(robot: Robot) -> None:
    robot.filter = PoseFilter(START, np.diag([1.0, 1.0, 1.0, 0.1]))
    near = Pose(START.x_m + 0.5, START.y_m, START.z_m, START.yaw_rad)
    variance = (1e-4, 1e-4, 1e-4, 1e-5)
    hear(robot, Kind.FIX, pack_fix(Fix(2, 1.0, near, variance)))
    assert robot.pose == START, "it is another's"
    far = Pose(START.x_m + 90.0, START.y_m, START.z_m, START.yaw_rad)
    hear(robot, Kind.FIX, pack_fix(Fix(0, 1.0, far, variance)))
    assert robot.pose == START, "nobody is thrown so far"
    hear(robot, Kind.FIX, pack_fix(Fix(0, 1.0, near, variance)))
    assert robot.pose.x_m == pytest.approx(near.x_m, abs=0.01)


class Wheels:
    """A body that does what it is told, a metre in ten seconds."""

    async def drive(self, turn_rad: float, forward_m: float) -> Odometry:
        await asyncio.sleep(10.0 * abs(forward_m))
        return Odometry(forward_m, 0.0, 0.0, turn_rad, np.diag([0.02, 0.01, 0.01, 0.01]) ** 2)


def on_wheels(folder: Path) -> Robot:
    robot = robot_on(folder)
    robot.hardware = Hardware(body=Wheels())
    robot.filter = PoseFilter(START, np.diag([0.1, 0.1, 0.1, 0.05]) ** 2)
    return robot


def test_a_fix_that_comes_late_counts_for_where_the_robot_stood_then(tmp_path: Path) -> None:
    stood = pack_fix(Fix(0, 5.0, START, (1e-4,) * 4))

    async def go(fix: bytes, after_s: float) -> Pose:
        robot = on_wheels(tmp_path / str(after_s))
        await asyncio.sleep(10.0)
        driving = asyncio.create_task(robot.drive(0.0, 0.25))
        await asyncio.sleep(after_s)
        hear(robot, Kind.FIX, fix, t_s=robot.now_s)
        await driving
        return robot.pose

    want = START.moved(0.25, 0.0, 0.0, 0.0)
    for after_s in (1.0, 5.0):  # while it drives, and afterwards
        assert run(go(stood, after_s)).distance_m(want) < 0.01
    on_the_way = pack_fix(Fix(0, 11.0, START.moved(0.1, 0.0, 0.0, 0.0), (1e-4,) * 4))
    assert run(go(on_the_way, 6.0)).distance_m(want) < 1e-9


def test_it_remembers_the_way_it_came_however_often_it_turns_on_the_spot(tmp_path: Path) -> None:
    async def go() -> list[tuple[float, float]]:
        robot = on_wheels(tmp_path)
        for _ in range(10):
            await robot.drive(0.0, 0.5)
        for _ in range(300):
            await robot.drive(0.5, 0.0)
        return robot.trail

    trail = run(go())
    assert trail[0] == (START.x_m, START.y_m)
    assert len(trail) == 11


# --- life after death -----------------------------------------------------------------------


def ways_of(robot: Robot) -> dict[tuple[int, int], int]:
    """Count, per cell, by how many of this robot's own origins it is known."""
    masks = [submap.known for submap in robot.own.submaps]
    anchors = [a for a in robot.store.anchors if a.robot == robot.me.robot]
    former = [a for a in anchors if a.incarnation != robot.me.incarnation]
    masks += [robot.team.published_mask(Origin(*a[:2]), a.submap) for a in former]
    total = np.sum(masks, axis=0) if masks else np.zeros(FRAME.shape)
    return {(int(r), int(c)): int(total[r, c]) for r, c in np.argwhere(total)}


@given(seeds, st.lists(st.sampled_from(["look", "say", "die"]), min_size=3, max_size=14))
@settings(max_examples=40, deadline=None)
def test_over_all_its_lives_nothing_is_counted_twice_and_nothing_is_lost(
    tmp_path_factory: pytest.TempPathFactory, seed: int, deeds: list[str]
) -> None:
    folder, rng = tmp_path_factory.mktemp("robot"), np.random.default_rng(seed)
    robot = robot_on(folder)
    measured = np.zeros(FRAME.shape)
    for deed in [*deeds, "die", "say", "die"]:
        match deed:
            case "look":
                cells = look(rng)
                measured[cells.rows, cells.cols] += 1.0 / cells.variance_m2
                measure(robot, cells)
                save(robot)
            case "say":
                say(robot, int(rng.integers(1, 12)))
            case _:
                known = robot.team.fused().known
                published = {(c.key, c.version) for c in _published_by(robot)}
                robot = robot_on(folder)
                assert not (known & ~robot.team.fused().known).any(), "it has all that it had"
                again = {(k, v.number) for k, v in robot.store.all_versions()}
                assert published <= again
        fused = robot.team.fused()
        assert np.all(1.0 / fused.variance_m2 <= measured * (1 + 1e-9))
        assert np.array_equal(fused.known, measured > 0)


def _published_by(robot: Robot) -> list[Chunk]:
    return [
        Chunk(key, version.number, version.total, 0, version.prefix)
        for key, version in robot.store.all_versions()
        if key.robot == robot.me.robot
    ]


def test_what_was_published_is_not_in_the_new_lifes_layer(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    first = robot_on(tmp_path)
    for _ in range(3):
        measure(first, look(rng))
    save(first)
    assert say(first, 20)
    published = first.team.published_mask(Origin(0, 0), 0)
    measure(first, look(rng))
    save(first)
    unpublished = first.own.submaps[0].known & ~published
    assert published.any()
    assert unpublished.any()
    second = robot_on(tmp_path)
    assert second.me == Origin(0, 1)
    assert np.array_equal(second.own.submaps[0].known, unpublished)
    assert set(ways_of(second).values()) == {1}
    assert second.store.anchors[AnchorKey(0, 0, 0)] == first.own.submaps[0].anchor
    assert "incarnation 1" in log_of(second).told("restart")[0]
    # Dies before its first look, having told what it had taken up: that is the second life's now.
    assert say(second, 20)
    third = robot_on(tmp_path)
    assert third.own.known_cells() == 0
    assert set(ways_of(third).values()) == {1}
    assert np.array_equal(third.team.fused().known, published | unpublished)


def test_it_comes_back_less_sure_of_its_place_than_it_went(tmp_path: Path) -> None:
    first = robot_on(tmp_path)
    measure(first, look(np.random.default_rng(6)))
    save(first)
    second = robot_on(tmp_path)
    assert second.pose == first.pose
    assert np.all(np.diag(second.filter.covariance) > np.diag(first.filter.covariance))


def test_a_spoilt_disk_is_told_and_the_robot_begins_anew(tmp_path: Path) -> None:
    first = robot_on(tmp_path)
    measure(first, look(np.random.default_rng(7)))
    save(first)
    (tmp_path / "layer").write_bytes(b"rubbish")
    second = robot_on(tmp_path)
    assert "is no saved layer" in log_of(second).told("disk")[0]
    assert second.own.known_cells() == 0
    assert second.me.incarnation == 1


def test_a_disk_that_fails_stops_the_publishing_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = robot_on(tmp_path / "robot")
    measure(robot, look(np.random.default_rng(8)))
    with monkeypatch.context() as patched:
        patched.setattr(robot.disk, "folder", tmp_path / "robot" / "incarnation" / "no")
        assert say(robot, 6) == []
    assert "cannot be written" in log_of(robot).told("disk")[0]
    assert robot.store.keys() == []
    assert say(robot, 6, t_s=200.0)
