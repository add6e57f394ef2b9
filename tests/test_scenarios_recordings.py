"""A recording stands in for a robot's body and sensor: files of others, and our own."""

import contextlib
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_helpers import (
    STAMPED,
    at_ns,
    level,
    odometry,
    pitched,
    points,
    position,
    transform,
    write_bag,
)
from run_helpers import Ran, run_of, small
from scipy.spatial.transform import Rotation
from sim_helpers import run as on_virtual_time
from stereo_helpers import HERE, SENSOR, STEREO, shot
from test_scenarios_ros2 import value_of

from agents.geometry import Floats, Pose, wrap_angle
from agents.ports import Hardware, Step
from agents.settings import DriveSettings, SensorSettings
from agents.stereo.eyes import calibration_of, left_eye_m, level_from_camera
from comms.timebase import NS, now_ns, sleep_until_ns
from scenarios import cli
from scenarios.logs import diary
from scenarios.recordings import read
from scenarios.ros2 import bag as bags
from scenarios.ros2.cdr import encode
from scenarios.ros2.cdrreading import CdrError, decode
from scenarios.ros2.messages import header
from scenarios.ros2.types import DEFINITIONS, fields_of
from sim.errors import WorldError
from sim.motion import Motions
from sim.recorded import Led, RecordedGuide, Recording, Take, seen
from sim.settings import RecordingSettings
from sim.troubles import Trouble, Troubles, failing

GROUND = np.array([[4.0, 0.0, 0.0], [5.0, 1.0, 0.5], [3.0, -1.0, 0.0]])
"""Points (3, 3) in the world."""
TILT_RAD = 0.4
MAST_M = 1.2


def recording(file: Path, **keys: Any) -> Recording:
    return read(RecordingSettings(file=str(file), **keys), 1.6)


def in_lidar(world_m: Floats, x_m: float, yaw_rad: float, pitch_rad: float) -> Floats:
    """Return world points as a lidar sees them: 1.2 m up, nose down, on a robot that pitches."""

    def about_y(rad: float) -> Floats:
        c, s = math.cos(rad), math.sin(rad)
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])

    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    base = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ about_y(pitch_rad)
    in_base = (world_m - (x_m, 0.0, 0.0)) @ base
    return (in_base - (0.0, 0.0, MAST_M)) @ about_y(TILT_RAD)


def told_by_transforms() -> list[Any]:
    """Return a drive of 2 m along x in 10 s, turning left by 0.5 rad, nose down by 0.1 rad."""
    told = [
        transform(
            0.0, "base_link", "lidar", position(0, 0, MAST_M), pitched(TILT_RAD), "/tf_static"
        )
    ]
    for step in range(11):
        turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        yaw, pitch = 0.05 * step, 0.1
        cy, sy, cp, sp = (
            math.cos(yaw / 2),
            math.sin(yaw / 2),
            math.cos(pitch / 2),
            math.sin(pitch / 2),
        )
        turn = {"x": -sy * sp, "y": cy * sp, "z": sy * cp, "w": cy * cp}
        told.append(
            transform(float(step), "odom", "base_link", position(0.2 * step, 0, 0), turn, "/tf")
        )
    told.append(transform(0.0, "map", "odom", position(0, 0, 0), level(), "/tf"))
    told.append(transform(10.0, "map", "odom", position(0, 0, 0), level(), "/tf"))
    for t_s in (0.0, 2.5, 10.0):
        told.append(points(t_s, "lidar", in_lidar(GROUND, 0.2 * t_s, 0.05 * t_s, 0.1)))
    return told


# --- files of others ------------------------------------------------------------------------------


@given(data=st.data(), kind=st.sampled_from(sorted(DEFINITIONS)))
@settings(max_examples=25, deadline=None)
def test_what_is_encoded_is_decoded_and_cut_short_refused(data: Any, kind: str) -> None:
    message = {name: value_of(part, data.draw) for part, name in fields_of(kind)}
    packed = encode(kind, message)
    assert same(decode(kind, packed), message)
    for cut in {0, 3, len(packed) // 2, len(packed) - 1}:
        with pytest.raises(CdrError):
            decode(kind, packed[:cut])


def same(told: Any, want: Any) -> bool:
    if isinstance(want, dict):
        return told.keys() == want.keys() and all(same(told[k], want[k]) for k in want)
    if isinstance(want, list):
        return len(told) == len(want) and all(map(same, told, want))
    if isinstance(want, np.ndarray):
        return list(told) == want.tolist()
    return bool(told == want)


@pytest.mark.parametrize(("storage", "big"), [("SQLITE3", False), ("MCAP", False), ("MCAP", True)])
def test_clouds_of_a_tilted_lidar_are_levelled_by_the_transforms(
    tmp_path: Path, storage: str, big: bool
) -> None:
    folder = write_bag(tmp_path / "bag", told_by_transforms(), storage, big)
    read_back = recording(folder)
    assert [take.t_ns for take in read_back.takes] == [0, int(2.5 * NS), 10 * NS]
    for take, t_s in zip(read_back.takes, (0.0, 2.5, 10.0), strict=True):
        assert take.pose.x_m == pytest.approx(0.2 * t_s, abs=1e-9)
        assert take.pose.yaw_rad == pytest.approx(0.05 * t_s, abs=2e-3), "between two poses: slerp"
        world_m = take.pose.team_from_robot(take.points_m.astype(float))
        assert np.abs(world_m - GROUND).max() < 1e-3
        assert take.eye_m[2] == pytest.approx(MAST_M * math.cos(0.1), abs=1e-6)
    assert recording(next(folder.glob("*.[dm]*[b3p]"))).takes[0].pose == read_back.takes[0].pose


def test_poses_of_a_topic_go_before_transforms(tmp_path: Path) -> None:
    told = told_by_transforms()
    told += [odometry(t_s, position(1.0 + t_s, 0, 0.5), level()) for t_s in (0.0, 10.0)]
    poses = recording(write_bag(tmp_path / "bag", told), poses="/odom").takes
    assert [take.pose.x_m for take in poses] == [1.0, 3.5, 11.0]
    assert {take.pose.z_m for take in poses} == {0.5}


def test_poses_that_name_no_frame_are_those_of_the_base(tmp_path: Path) -> None:
    told: list[Any] = [
        ("/pose", STAMPED, t_s, {
            "header": header(at_ns(t_s), "world"),
            "pose": {"position": position(t_s, 0, 0), "orientation": level(0.3)},
        })
        for t_s in (0.0, 4.0)
    ]  # fmt: skip
    told += [points(2.0, "velodyne", np.array([[3.0, 0.0, -1.0]]))]
    folder = write_bag(tmp_path / "bag", told)
    (take,) = recording(folder, poses="/pose", base="velodyne").takes
    assert (take.pose.x_m, take.pose.yaw_rad) == pytest.approx((2.0, 0.3))
    assert take.points_m == pytest.approx(np.array([[3.0, 0.0, -1.0]]))
    with pytest.raises(WorldError, match="nothing tells where frame 'velodyne'"):
        recording(folder, poses="/pose")


def test_looks_come_no_faster_than_asked_and_only_where_poses_tell(tmp_path: Path) -> None:
    told = told_by_transforms()
    told += [points(1.0 + 0.1 * k, "lidar", GROUND) for k in range(1, 10)]
    told += [points(12.0, "lidar", GROUND)]
    folder = write_bag(tmp_path / "bag", told)
    times = [take.t_ns / NS for take in recording(folder).takes]
    assert times == [0.0, 1.1, 2.5, 10.0], "12 s is two seconds after the last pose"
    assert len(recording(folder, every_s=0.0).takes) == 12
    assert len(recording(folder, every_s=5.0).takes) == 2


def test_a_stereo_pair_becomes_points_on_the_ground(tmp_path: Path) -> None:
    taken = shot()
    calibration = calibration_of(SENSOR, STEREO)
    f, b = calibration.focal_px, calibration.baseline_m
    tilt_rad = math.radians(-20)
    eye = left_eye_m(SENSOR, STEREO, 0.0)
    turn = level_from_camera(0.0, tilt_rad)
    x, y, z, w = (float(v) for v in Rotation.from_matrix(turn).as_quat())
    quaternion = {"x": x, "y": y, "z": z, "w": w}
    told = [
        transform(
            0.0, "base_link", "left_eye", position(*map(float, eye)), quaternion, "/tf_static"
        ),
        odometry(0.0, position(HERE.x_m, HERE.y_m, 0), level(HERE.yaw_rad)),
    ]
    for name, image, shift in (("left", taken.left, 0.0), ("right", taken.right, -f * b)):
        height, width = image.shape
        p = [f, 0, calibration.cx_px, shift, 0, f, calibration.cy_px, 0, 0, 0, 1, 0]
        info = {"header": header(at_ns(0), "left_eye"), "height": height, "width": width}
        info["p"] = np.array(p, dtype=float)
        told.append((f"/{name}/camera_info", "sensor_msgs/msg/CameraInfo", 0.0, info))
        pixels = {
            "header": header(at_ns(0), "left_eye"),
            "height": height,
            "width": width,
            "encoding": "mono8",
            "step": width,
            "data": image.ravel(),
        }
        told.append((f"/{name}/image_rect", "sensor_msgs/msg/Image", 0.0, pixels))
    folder = write_bag(tmp_path / "bag", told)
    images = ("/left/image_rect", "/right/image_rect")
    (take,) = recording(folder, images=images, poses="/odom").takes
    exposure = seen(take, SENSOR, 0.0)
    near = np.hypot(exposure.points_m[:, 0], exposure.points_m[:, 1]) < 5.0
    assert near.sum() > 300
    assert np.median(np.abs(exposure.points_m[near, 2])) < 0.03
    assert exposure.tilt_rad == pytest.approx(tilt_rad, abs=1e-6)


# --- bad ones: one sentence -----------------------------------------------------------------------


def scenario_with(folder: Path, file: Path | str, **keys: Any) -> Path:
    robots = {"recon": {"role": "recon", "recording": {"file": str(file), **keys}}}
    told = {
        "name": "field",
        "limit_s": 100.0,
        "robots": robots,
        "world": {"terrain": {"kind": "plain"}},
    }
    (folder / "field.toml").write_text(tomli_w.dumps(told))
    return folder / "field.toml"


def refused(scenario: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one sentence with which a scenario is refused."""
    assert cli.main(["check", str(scenario)]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "Traceback" not in told
    return told


def test_what_is_wrong_with_a_recording_is_told_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = write_bag(tmp_path / "bag", told_by_transforms())
    (tmp_path / "one.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "noise.mcap").write_bytes(bytes(range(256)) * 9)
    (tmp_path / "noise.db3").write_bytes(bytes(range(256)) * 9)
    (tmp_path / "empty").mkdir()
    cases: list[tuple[str, Any, dict[str, Any]]] = [
        ("no such file", "nowhere.mcap", {}),
        ("is a bag of ROS 1", tmp_path / "one.bag", {}),
        ("is no recording", tmp_path / "noise.mcap", {}),
        ("is no recording", tmp_path / "noise.db3", {}),
        ("is no recording", tmp_path / "empty", {}),
        ("has no topic /lidar", good, {"clouds": "/lidar"}),
        ("has tf2_msgs/msg/TFMessage on topic /tf", good, {"clouds": "/tf"}),
        ("has no topic /odom", good, {"poses": "/odom"}),
        ("don't tell where frame 'base' goes", good, {"base": "base"}),
        ("only one may be given", good, {"clouds": "/points", "images": ["/a", "/b"]}),
    ]
    for sentence, file, keys in cases:
        told = refused(scenario_with(tmp_path, file, **keys), capsys)
        assert sentence in told, told
    assert cli.main(["check", str(scenario_with(tmp_path, good))]) == 0


def test_a_recording_outside_the_window_is_refused_and_a_start_brings_it_in(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = [points(0.0, "base_link", GROUND), odometry(0.0, position(-900, 50, 3), level(1.0))]
    good = write_bag(tmp_path / "bag", told)
    file = scenario_with(tmp_path, good, poses="/odom")
    assert "robots.recon.start" in refused(file, capsys)
    moved = file.read_text().replace("[robots.recon]", "[robots.recon]\nstart = [16.0, 16.0, 90.0]")
    file.write_text(moved)
    assert cli.main(["check", str(file)]) == 0


@given(st.integers(0, 10**9), st.integers(1, 255))
@settings(max_examples=15, deadline=None)
def test_a_damaged_file_is_read_or_refused_in_a_sentence(
    whole: tuple[bytes, bytes], tmp_path_factory: pytest.TempPathFactory, at: int, flip: int
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    for data, name in zip(whole, ("a.mcap", "a.db3"), strict=True):
        broken = bytearray(data)
        broken[at % len(broken)] ^= flip
        for damaged in (bytes(broken), data[: at % len(data)]):
            (folder / name).write_bytes(damaged)
            with contextlib.suppress(WorldError):  # nothing else may come of it
                recording(folder / name)
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes]:
    """Return a sound recording as MCAP and as .db3."""
    folder = tmp_path_factory.mktemp("whole")
    told = told_by_transforms()
    mcap = write_bag(folder / "mcap", told, "MCAP")
    db3 = write_bag(folder / "db3", told)
    return next(mcap.glob("*.mcap")).read_bytes(), next(db3.glob("*.db3")).read_bytes()


# --- who is led -----------------------------------------------------------------------------------


def walk(*stands: tuple[float, float, float], look_s: tuple[float, ...]) -> Recording:
    """Return a recording of (t_s, x_m, yaw_rad) with looks at its times."""
    times = np.array([round(t_s * NS) for t_s, _, _ in stands], dtype=np.int64)
    poses = np.array([[x_m, 0.0, 0.0, yaw_rad] for _, x_m, yaw_rad in stands])
    bare = Recording(times, poses, ())
    takes = [
        Take(t, bare.pose_at(t), np.array([0, 0, 1.6]), GROUND.astype(np.float32))
        for t in (round(t_s * NS) for t_s in look_s)
    ]
    return Recording(times, poses, tuple(takes))


def led(
    what: Recording, *, start_ns: int = 0, begin_ns: int = 0, troubles: Sequence[Trouble] = ()
) -> tuple[list[Any], Motions]:
    """Return (time, step) of all steps of a robot that is led, and its motion."""
    failures = Troubles()
    for trouble in troubles:
        failures.add(trouble)
    motions, steps = Motions(), []

    async def live() -> None:
        await sleep_until_ns(start_ns)
        start = what.pose_at(start_ns - begin_ns)
        guide = RecordedGuide(
            "r", Led(what, begin_ns), SensorSettings(), DriveSettings(), motions.add,
            start=start, start_ns=start_ns,
        )  # fmt: skip
        hardware = failing(Hardware(guide=guide), failures)
        assert hardware.guide is not None
        while (step := await hardware.guide.step()) is not None:
            steps.append((now_ns(), step))

    on_virtual_time(live())
    return steps, motions


def summed(steps: list[tuple[int, Step]]) -> Pose:
    pose = Pose(0.0, 0.0, 0.0, 0.0)
    for _, step in steps:
        if step.odometry is not None:
            o = step.odometry
            pose = pose.moved(o.forward_m, o.left_m, o.up_m, o.turn_rad)
    return pose


@given(
    st.lists(
        st.tuples(st.floats(0.5, 20), st.floats(-3, 3), st.floats(-1, 1)), min_size=1, max_size=9
    ),
    st.lists(st.floats(0.1, 30), min_size=1, max_size=5, unique=True),
)
@settings(max_examples=40, deadline=None)
def test_odometry_adds_up_to_the_recorded_way_and_looks_come_in_time(
    legs: list[tuple[float, float, float]], look_s: list[float]
) -> None:
    stands, t_s, x_m, yaw_rad = [(0.0, 0.0, 0.0)], 0.0, 0.0, 0.0
    for span_s, forth_m, turn_rad in legs:
        t_s, x_m, yaw_rad = t_s + span_s, x_m + forth_m, yaw_rad + turn_rad
        stands.append((t_s, x_m, wrap_angle(yaw_rad)))
    what = walk(*stands, look_s=tuple(sorted(look_s)))
    steps, motions = led(what)
    looked = [t_ns for t_ns, step in steps if step.exposure is not None]
    assert looked == [take.t_ns for take in what.takes]
    there, last = summed(steps), what.takes[-1].pose
    assert there.distance_m(last) < 1e-3 + 1e-3 * len(steps)
    for take in what.takes:
        at = motions.pose_at("r", take.t_ns)
        assert at is not None
        assert at.distance_m(take.pose) < 1e-9
    for _, step in steps:
        if step.odometry is not None:
            assert np.linalg.eigvalsh(step.odometry.covariance).min() >= 0


def test_who_comes_in_the_middle_missed_what_was_before() -> None:
    what = walk((0, 0, 0), (100, 10, 0), look_s=(10, 50, 90))
    steps, motions = led(what, start_ns=60 * NS, begin_ns=5 * NS)
    assert [t_ns // NS for t_ns, step in steps if step.exposure] == [95]
    at = motions.pose_at("r", 80 * NS)
    assert at is not None
    assert at.x_m == pytest.approx(7.5)


def test_a_blind_sensor_sees_nothing_of_a_recording() -> None:
    what = walk((0, 0, 0), (30, 0, 0), look_s=(10, 20, 30))
    steps, _ = led(what, troubles=[Trouble("blind", 15 * NS, 25 * NS)])
    exposures = [step.exposure for _, step in steps]
    assert [e is not None and len(e.points_m) for e in exposures] == [3, 0, 3]


def test_a_long_way_without_looks_is_told_in_legs() -> None:
    stands = [(10.0 * k, 1.0 * k, 0.0) for k in range(11)]
    steps, _ = led(walk(*stands, look_s=(100,)))
    assert [t_ns // NS for t_ns, _ in steps] == [20, 40, 60, 80, 100]


def test_a_recording_begun_elsewhere_is_moved_as_one() -> None:
    what = walk((0, 2, 0.5), (10, 4, 1.0), look_s=(10,))
    start = Pose(10.0, 20.0, 3.0, 0.5 + math.pi / 2)
    moved = what.begun_at(start)
    assert moved.pose_at(0).distance_m(start) < 1e-9
    there = moved.takes[0].pose
    assert (there.x_m, there.y_m, there.z_m) == pytest.approx((10.0, 22.0, 3.0))
    assert there.yaw_rad == pytest.approx(1.0 + math.pi / 2)
    assert what.begun_at(what.pose_at(0)) is what


# --- runs -----------------------------------------------------------------------------------------


def map_of(run: Path, robot: str) -> dict[str, Any]:
    chart = None
    for note in bags.notes_of(run)[robot]:
        if note.topic == diary.TEAM_MAP:
            chart = diary.draw(chart, note.data)
    assert chart is not None
    return dict(chart.layers)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """Return a finished run of two, with its run.mcap."""
    out = tmp_path_factory.mktemp("first") / "run"
    ran = run_of(small("pair", "robots.count=1", "planner.max_looks=9"), out)
    bags.write_bag(ran.out)
    return ran


def again(first: Ran, out: Path, *changes: str, **how: Any) -> Ran:
    keys = (
        ("file", str(first.out / "run.mcap")),
        ("clouds", "/explorer_1/look"),
        ("poses", "/explorer_1/odom"),
    )
    sets = [f'robots.explorer-1.recording.{key}="{value}"' for key, value in keys]
    more = ("robots.count=2", "robots.explorer-1.recording.drift=0", "limit_s=900", *changes)
    return run_of(small("pair", *more[:1], *sets, *more[1:], **how), out)


def test_a_runs_own_recording_makes_the_same_map_again(first: Ran, tmp_path: Path) -> None:
    second = again(first, tmp_path / "second")
    before, after = map_of(first.out, "explorer-1"), map_of(second.out, "explorer-2")
    known = np.isfinite(before["elevation"])
    both = known & np.isfinite(after["elevation"])
    assert both.sum() > 0.9 * known.sum(), "the team-mate has them over the link"
    gap_m = np.abs(before["elevation"] - after["elevation"])[both]
    assert np.median(gap_m) < 0.03
    assert np.percentile(gap_m, 95) < 0.15
    looks = [
        [row["t_s"] for row in ran.table("looks") if row["robot"] == "explorer-1"]
        for ran in (first, second)
    ]
    assert looks[0] == looks[1]
    assert second.robot("explorer-1")["pose_error_rms_m"] < 1e-3
    assert second.digests("explorer-1") == second.digests("explorer-2")


def test_a_recorded_robot_that_dies_comes_back_further_on(first: Ran, tmp_path: Path) -> None:
    when_s = sorted(row["t_s"] for row in first.table("looks"))
    middle_s = (when_s[3] + when_s[5]) / 2
    dies_s = when_s[2] + 0.5
    gone_s = middle_s - dies_s
    events = [{"at_s": dies_s, "restart": "explorer-1", "after_s": gone_s}]
    second = again(first, tmp_path / "second", events=events)
    taken = [row["t_s"] for row in second.table("looks") if row["robot"] == "explorer-1"]
    kept = [t for t in when_s if t < when_s[2] + 0.5 or t >= middle_s]
    assert taken == pytest.approx(kept)
    assert second.events("explorer-1", "explored")
