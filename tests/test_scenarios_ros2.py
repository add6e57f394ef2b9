"""Runs as ROS 2 messages: independent decoders read them, viewers draw them, live and from file."""

import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diary_helpers import FRAME, pose_at, written_run
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from run_helpers import RECORDS, small

from comms import ros2_zenoh, zenoh_air
from comms.timebase import NS
from scenarios import cli, runner
from scenarios.logs.diary import Chart, NoteError
from scenarios.logs.notebook import LogFile
from scenarios.records.linkwindows import FramesError, windows_of
from scenarios.ros2 import bag, bridge, messages
from scenarios.ros2.bag import BagError, Stamped, write_bag
from scenarios.ros2.cdr import encode
from scenarios.ros2.types import DEFINITIONS, HASHES, fields_of, full_name, parts_of, schema_text

OURS = "ropeteam_msgs/msg/LinkStatistics"
GRID_MAP = "grid_map_msgs/msg/GridMap"
FOXGLOVE = Path(__file__).parent / "foxglove"


@pytest.fixture(scope="module")
def typestore() -> Any:
    """Return the types of rosbags, which knows nothing of our encoder."""
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is an extra of the tests")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    missing = {
        name: fields
        for kind in DEFINITIONS
        if kind not in store.fielddefs
        for name, fields in typesys.get_types_from_msg(DEFINITIONS[kind], kind).items()
    }
    store.register(missing)
    return store


def decoded(path: Path) -> list[tuple[str, str, int, Any]]:
    """Return (topic, type, time in ns, message) of a file, by mcap-ros2-support."""
    support = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is an extra")
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[support.DecoderFactory()])
        return [
            (channel.topic, schema.name, message.log_time, told)
            for schema, channel, message, told in reader.iter_decoded_messages()
        ]


# --- types and CDR --------------------------------------------------------------------------------


def test_types_are_those_of_ros(typestore: Any) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    true = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    for kind in DEFINITIONS:
        if kind in true.fielddefs:
            names = [name for name, _ in true.fielddefs[kind][1]]
            assert [field for _, field in fields_of(kind)] == names, kind
    for kind, told in HASHES.items():
        assert typestore.hash_rihs01(kind) == f"RIHS01_{told}", kind


def value_of(kind: str, draw: Any) -> Any:
    """Draw a value of a type as our encoder takes it."""
    base, _, length = kind.partition("[")
    if length and base not in ("string",) and "/" not in base:
        dtype = {"float32": "f4", "float64": "f8", "bool": "?"}.get(base, "")
        count = int(length[:-1]) if length != "]" else draw(st.integers(0, 5))
        dtype = dtype or f"{'u' if base[0] == 'u' else 'i'}{int(base.strip('uint')) // 8}"
        numbers = draw(st.lists(st.integers(0, 100), min_size=count, max_size=count))
        return np.array(numbers, dtype)
    if length:
        return [value_of(base, draw) for _ in range(draw(st.integers(0, 3)))]
    if "/" in base:
        return {name: value_of(part, draw) for part, name in fields_of(full_name(base))}
    if base == "string":
        return draw(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9))
    if base == "bool":
        return draw(st.booleans())
    whole = draw(st.integers(0, 100))
    return whole / 4 if base.startswith("float") else whole


def same(told: Any, want: Any) -> bool:
    if isinstance(want, dict):
        return all(same(getattr(told, name), value) for name, value in want.items())
    if isinstance(want, list):
        return len(told) == len(want) and all(map(same, told, want))
    if isinstance(want, np.ndarray):
        return list(told) == want.tolist()
    return bool(told == want)


@given(data=st.data(), kind=st.sampled_from(sorted(DEFINITIONS)))
@settings(max_examples=80, deadline=None)
def test_two_other_decoders_read_what_we_encode(typestore: Any, data: Any, kind: str) -> None:
    message = {name: value_of(part, data.draw) for part, name in fields_of(kind)}
    wire = encode(kind, message)
    assert same(typestore.deserialize_cdr(wire, kind), message)
    dynamic = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is an extra")
    records = pytest.importorskip("mcap.records")
    schema = records.Schema(1, schema_text(kind).encode(), "ros2msg", kind)
    decoder = dynamic.DecoderFactory().decoder_for("cdr", schema)
    assert same(decoder(wire), message)


def test_what_is_left_out_is_zero_and_what_is_unknown_is_refused(typestore: Any) -> None:
    told = typestore.deserialize_cdr(encode(OURS, {"sender": "a"}), OURS)
    assert (told.sender, told.receiver, told.bytes, len(told.drop_counts)) == ("a", "", 0, 0)
    with pytest.raises(KeyError, match="colour"):
        encode(OURS, {"colour": 1})
    with pytest.raises(ValueError, match="must be 36"):
        encode("geometry_msgs/msg/PoseWithCovariance", {"covariance": [1.0]})


def test_a_schema_has_all_its_parts_once() -> None:
    text = schema_text(GRID_MAP)
    for part in parts_of(GRID_MAP)[1:]:
        assert text.count(f"MSG: {part.replace('/msg/', '/')}\n") == 1


# --- messages -------------------------------------------------------------------------------------


def test_a_grid_map_has_its_first_cell_in_the_north_east() -> None:
    z = np.arange(FRAME.rows * FRAME.cols, dtype=np.float32).reshape(FRAME.shape)
    told = messages.grid_map(NS, Chart(FRAME, {"elevation": z, "sigma": z}))
    layer = told["data"][0]
    columns, rows = (dim["size"] for dim in layer["layout"]["dim"])
    matrix = np.ravel(layer["data"]).reshape(columns, rows).T  # written column by column
    info = told["info"]
    middle = info["pose"]["position"]
    for i, j in ((0, 0), (3, 5), (rows - 1, columns - 1)):  # grid_map: falls with x and with y
        x = middle["x"] + info["length_x"] / 2 - (i + 0.5) * info["resolution"]
        y = middle["y"] + info["length_y"] / 2 - (j + 0.5) * info["resolution"]
        assert matrix[i, j] == z[FRAME.cell_of(x, y)]


def test_an_occupancy_grid_says_where_it_lies() -> None:
    odds = np.full(FRAME.shape, np.nan, np.float32)
    odds[0, 1], odds[8, 12] = 20.0, -20.0
    told = messages.occupancy_grid(3 * NS // 2, Chart(FRAME, {"log_odds": odds}))
    assert told["header"]["stamp"] == {"sec": 1, "nanosec": 500_000_000}
    assert (told["info"]["width"], told["info"]["height"]) == (13, 9)
    assert (told["info"]["origin"]["position"]["x"], FRAME.x_m) == (-1.0, -1.0)
    data = np.ravel(told["data"])
    assert (data[1], data[-1], data[0]) == (100, 0, -1)


def test_link_windows_add_up_to_the_frames(tmp_path: Path) -> None:
    written_run(tmp_path)
    found = windows_of(tmp_path, 60.0)
    assert [(w.end_ns // NS, w.receiver) for w in found] == [
        (end, mate) for end in (10, 20, 30) for mate in ("anchor-left", "cliffbot")
    ]
    first = found[0]
    assert (first.frames, first.bytes, first.delivered_bytes) == (10, 1000, 800)
    assert first.drops == {"lost": 2}
    told = messages.link_statistics(first)
    assert told["busy_fraction"] == pytest.approx(0.25)
    assert (told["queue_delay_mean_s"], told["latency_max_s"]) == (0.5, 1.0)
    assert (told["dropped_frames"], told["drop_counts"]) == (2, [2])


# --- run.mcap -------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["elevation", "planar"])
def merged(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return kind, file and last map of a run that was merged."""
    folder = tmp_path_factory.mktemp("run")
    last = written_run(folder, request.param)
    return request.param, write_bag(folder), last


def test_a_merged_run_holds_each_kind_of_message(merged: Any) -> None:
    kind, path, _ = merged
    told = decoded(path)
    me = "/recon" if kind == "elevation" else "/explorer_1"
    grid = f"{me}/relief" if kind == "elevation" else f"{me}/map"
    counts = Counter((topic, name) for topic, name, _, _ in told)
    assert counts == {
        (grid, "nav_msgs/msg/OccupancyGrid"): 14,
        (f"{me}/map_points", "sensor_msgs/msg/PointCloud2"): 8,
        (f"{me}/grid_map", GRID_MAP): 8,
        (f"{me}/path_true", "nav_msgs/msg/Path"): 8,
        (f"{me}/path_believed", "nav_msgs/msg/Path"): 8,
        (f"{me}/look", "sensor_msgs/msg/PointCloud2"): 3,
        (f"{me}/image", "sensor_msgs/msg/CompressedImage"): 3,
        (f"{me}/odom_true", "nav_msgs/msg/Odometry"): 61,
        (f"{me}/odom", "nav_msgs/msg/Odometry"): 31,
        ("/tf", "tf2_msgs/msg/TFMessage"): 61,
        (f"/links{me}/anchor_left", OURS): 3,
        (f"/links{me}/cliffbot", OURS): 3,
    }
    times = [t_ns for _, _, t_ns, _ in told]
    assert times == sorted(times)
    assert times[-1] == 60 * NS


def test_the_last_map_of_a_merged_run_is_the_robots(merged: Any) -> None:
    kind, path, last = merged
    newest = {topic.split("/")[-1]: message for topic, _, _, message in decoded(path)}
    points = np.frombuffer(newest["map_points"].data, "<f4").reshape(-1, 4)
    first = next(iter(last.values()))
    shown = np.isfinite(first) if kind == "elevation" else np.nan_to_num(first) > 0
    assert len(points) == np.count_nonzero(shown)
    if kind == "elevation":
        assert np.array_equal(points[:, 2], last["elevation"][shown].astype("f4"))
        assert [field.name for field in newest["map_points"].fields] == ["x", "y", "z", "sigma"]
    else:
        grey = np.array(newest["map"].data).reshape(FRAME.shape)
        assert ((grey == -1) == np.isnan(first)).all()
        np.testing.assert_allclose(
            grey[grey >= 0], 100 / (1 + np.exp(-first[grey >= 0])), atol=0.51
        )
    assert len(newest["path_true"].poses) == 61
    assert newest["odom"].pose.covariance[35] == pytest.approx(0.01)
    assert newest["odom_true"].pose.pose.position.x == pytest.approx(pose_at(60).x_m)
    frames = {t.child_frame_id.split("/")[-1]: t.transform for t in newest["tf"].transforms}
    assert frames["base"].translation.x == pytest.approx(pose_at(60, 0.1).x_m)
    assert frames["true"].rotation.w == pytest.approx(math.cos(3.0))


@pytest.mark.slow
def test_rerun_draws_a_merged_run(merged: Any) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is an extra (pip install ropeteam[peers])")
    kind, path, _ = merged
    rerun = [sys.executable, "-m", "rerun"]
    checked = subprocess.run([*rerun, "mcap", "check", path], check=True, capture_output=True)
    assert b"error" not in checked.stdout.lower()
    out = path.with_suffix(".rrd")
    subprocess.run([*rerun, "mcap", "convert", path, "-o", out], check=True, capture_output=True)
    printed = subprocess.run([*rerun, "rrd", "print", out], check=True, capture_output=True).stdout
    chunks = [line for line in printed.decode().splitlines() if line.startswith("Chunk(")]
    grid = "/recon/relief" if kind == "elevation" else "/explorer_1/map"
    me = grid.rpartition("/")[0]
    for entity, component in (
        (f"{me}/map_points", "Points3D:positions"),
        (f"{me}/look", "Points3D:positions"),
        (f"{me}/image", "EncodedImage:blob"),
        (grid, "GridMap:data"),
        ("/tf", "Transform3D:translation"),
    ):
        assert any(f" {entity} " in line and component in line for line in chunks), entity
    assert not any("McapMessage:data" in line for line in chunks), "raw bytes"


@pytest.fixture(scope="module")
def foxglove(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a program that reads logs with Foxglove's own libraries, fetched from npm."""
    if shutil.which("npm") is None:
        pytest.skip("no npm is installed")
    folder = tmp_path_factory.mktemp("foxglove")
    for file in FOXGLOVE.iterdir():
        shutil.copy(file, folder)
    fetch = ["npm", "install", "--silent", "--no-audit", "--no-fund", "--no-package-lock"]
    if subprocess.run(fetch, check=False, cwd=folder, capture_output=True).returncode:
        pytest.skip("npm could not fetch Foxglove's libraries")
    return folder / "read.mjs"


@pytest.mark.slow
def test_foxglove_reads_a_merged_run(merged: Any, foxglove: Path) -> None:
    _, path, _ = merged
    read = subprocess.run(["node", foxglove, path], check=True, capture_output=True)
    told = json.loads(read.stdout)
    assert told["profile"] == "ros2"
    counts = Counter((topic, name) for topic, name, _, _ in decoded(path))
    assert counts == {(t, one["type"]): one["messages"] for t, one in told["topics"].items()}


def test_names_are_such_as_ros_allows() -> None:
    told = ["recon", "anchor-left", "a--b", "c-_d", "e-"]
    assert [bag.ros_name(name) for name in told] == ["recon", "anchor_left", "a_b", "c_d", "e"]
    bag.check_names(told)
    with pytest.raises(BagError, match="'a--b' and 'a_b' would both be 'a_b'"):
        bag.check_names([*told, "a_b"])


def test_maps_are_written_sparsely() -> None:
    assert bag.spread(list(range(7)), 8) == list(range(7))
    chosen = bag.spread(list(range(1000)), 8)
    assert len(chosen) == len(set(chosen)) == 8
    assert (chosen[-1], chosen == sorted(chosen)) == (999, True)
    way = [(t, pose_at(t)) for t in range(2501)]
    assert bag.thinned(way)[-1] == way[-1]
    assert len(bag.thinned(way)) <= bag.PATH_POSES


def test_the_same_logs_give_the_same_file(tmp_path: Path) -> None:
    written_run(tmp_path)
    assert write_bag(tmp_path).read_bytes() == write_bag(tmp_path, tmp_path / "b").read_bytes()


def test_what_cannot_be_merged_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="is no run"):
        write_bag(tmp_path)
    written_run(tmp_path)
    with pytest.raises(BagError, match="is the log of a robot"):
        write_bag(tmp_path, tmp_path / "recon.mcap")
    with pytest.raises(BagError, match="can't be written"):
        write_bag(tmp_path, tmp_path / "nowhere" / "run.mcap")
    (tmp_path / "recon.mcap").write_bytes(b"no log at all, but long enough to look like one")
    with pytest.raises(BagError, match="neither maps nor poses"):
        write_bag(tmp_path)
    assert list(tmp_path.glob(".*.part")) == []
    log = LogFile(tmp_path / "recon.mcap")
    log.keep("team_map", b"no map", 0)
    log.close()
    with pytest.raises(NoteError, match="damaged"):
        write_bag(tmp_path)
    written_run(tmp_path)
    (tmp_path / "frames.csv").write_text("from,to\na,b\n")
    with pytest.raises(FramesError, match=r"frames\.csv"):
        write_bag(tmp_path)
    assert list(tmp_path.glob(".*.part")) == []


def test_view_makes_the_file_and_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    written_run(tmp_path)
    viewer, told = tmp_path / "rerun", tmp_path / "told"
    viewer.write_text(f'#!/bin/sh\necho "$@" > {told}\ntest -s "$3"\n')
    viewer.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("DISPLAY", ":0")
    bag = tmp_path / "run.mcap"
    assert cli.main(["view", str(tmp_path), "--rerun"]) == 0
    assert told.read_text() == f"--bind 127.0.0.1 {bag}\n"
    bag.write_bytes(b"")
    assert cli.main(["view", str(tmp_path), "--rerun"]) == 1, "the viewer's own failure"
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert cli.main(["view", str(tmp_path), "--rerun"]) == 0
    assert f"{viewer} --bind 127.0.0.1 --serve-web {bag}\n" in capsys.readouterr().out
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert cli.main(["view", str(tmp_path), "--rerun"]) == 2
    assert "pip install rerun-sdk" in capsys.readouterr().err


# --- live -----------------------------------------------------------------------------------------


def test_keys_and_tokens_are_those_of_rmw_zenoh() -> None:
    # The examples of ros2/rmw_zenoh's docs/design.md.
    kind, told = (
        "std_msgs/msg/String",
        "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    )
    named = f"std_msgs::msg::dds_::String_/RIHS01_{told}"
    assert ros2_zenoh.topic_key(0, "/chatter", kind, told) == f"0/chatter/{named}"
    assert ros2_zenoh.topic_key(7, "/robot1/chatter", kind, told) == f"7/robot1/chatter/{named}"
    assert (
        ros2_zenoh.node_token(0, "aac3178e146ba6f1fc6e6a4085e77f21", "listener")
        == "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
    )
    token = ros2_zenoh.publisher_token(
        0, "8b20917502ee955ac4476e0266340d5c", "talker", 10, "/chatter", kind, told
    )
    start = "@ros2_lv/0/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
    assert token.startswith(start + named + "/::,")
    wire = ros2_zenoh.attachment(2, 3, bytes(range(16)))
    assert wire == b"\2" + bytes(7) + b"\3" + bytes(7) + b"\x10" + bytes(range(16))


def newest_of(told: list[tuple[str, bytes, bytes]], topic: str) -> tuple[str, bytes, bytes]:
    return [one for one in told if one[0].startswith(f"5/{topic}/")][-1]


def test_a_run_is_published_as_ros_sends_it(tmp_path: Path, typestore: Any) -> None:
    zenoh = pytest.importorskip("zenoh")
    last = written_run(tmp_path, "planar")
    hub = zenoh_air.open_hub()
    ear = zenoh.open(zenoh.Config.from_json5(json.dumps({
        "mode": "client",
        "connect": {"endpoints": [hub.endpoint], "timeout_ms": 5000},
        "scouting": {"multicast": {"enabled": False}},
    })))  # fmt: skip
    told: list[tuple[str, bytes, bytes]] = []
    ear.declare_subscriber(
        "5/**",
        lambda x: told.append((str(x.key_expr), x.payload.to_bytes(), x.attachment.to_bytes())),
    )
    try:
        with bridge.beside(tmp_path, hub.endpoint, 5):
            wait_for(lambda: any("path_believed" in key for key, _, _ in told))
            tokens = [str(r.ok.key_expr) for r in ear.liveliness().get("@ros2_lv/5/**")]
    finally:
        ear.close()
        hub.close()
    assert sum("/NN/" in token for token in tokens) == 1
    keys = {"/".join(token.split("/")[-3:-1]) for token in tokens if "/MP/" in token}
    assert keys == {"/".join(key.split("/")[-2:]) for key, _, _ in told}
    key, data, attachment = newest_of(told, "explorer_1/map")
    kind = "nav_msgs/msg/OccupancyGrid"
    assert key.endswith(f"/nav_msgs::msg::dds_::OccupancyGrid_/RIHS01_{HASHES[kind]}")
    grid = typestore.deserialize_cdr(data, kind)
    grey = grid.data.reshape(FRAME.shape)
    assert ((grey == -1) == np.isnan(last["log_odds"])).all()
    assert grid.header.frame_id == "map"
    assert (len(attachment), attachment[0], attachment[16]) == (33, 1, 16)
    clock = typestore.deserialize_cdr(newest_of(told, "clock")[1], "rosgraph_msgs/msg/Clock")
    assert clock.clock.sec == 60


def test_a_run_with_ros_beside_it_leaves_the_same_records(tmp_path: Path) -> None:
    hub = zenoh_air.open_hub()
    told: list[bytes] = []
    hub.listen("5/**", lambda _, data: told.append(data), lambda drain: drain())
    brief = small("pair", "limit_s=60", "planner.max_looks=2")
    quiet: dict[str, Any] = {"quiet": True, "picture": False, "merge": False}
    try:
        runner.run(brief, tmp_path / "alone", **quiet)
        beside = partial(bridge.beside, endpoint=hub.endpoint, domain=5)
        runner.run(brief, tmp_path / "followed", **quiet, beside=beside)
    finally:
        hub.close()
    assert told
    assert not (tmp_path / "alone" / "run.mcap").exists(), "none was asked for"
    names = [path.name for path in (tmp_path / "alone").glob("*.mcap")]
    for name in [*RECORDS, *names]:
        assert (tmp_path / "alone" / name).read_bytes() == (
            tmp_path / "followed" / name
        ).read_bytes()


def wait_for(done: Any, limit_s: float = 60.0) -> None:
    end_s = time.monotonic() + limit_s
    while not done():
        assert time.monotonic() < end_s, "waited in vain"
        time.sleep(0.05)


def test_who_listens_late_still_gets_the_map(tmp_path: Path) -> None:
    written_run(tmp_path)
    sent: list[Stamped] = []
    live = bridge.Bridge(tmp_path, ["recon", "cliffbot"], sent.append)
    live.round(0.0)
    first = [one.topic for one in sent]
    assert first.count("/recon/relief") == 1, "of 14 maps that came at once the newest counts"
    sent.clear()
    live.round(1.0)
    assert sent == []
    live.round(bridge.AGAIN_S + 0.1)
    assert "/recon/relief" in [one.topic for one in sent]
    assert "/tf" not in [one.topic for one in sent]


def test_a_robot_that_comes_back_is_followed_into_its_next_life(tmp_path: Path) -> None:
    written_run(tmp_path)
    (tmp_path / "recon-1.mcap").write_bytes((tmp_path / "recon.mcap").read_bytes())
    follower = bridge.Follower(tmp_path, "recon")
    assert follower.news()
    assert follower.news(), "its second log"
    assert not follower.news()


def test_without_a_router_nothing_is_started(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    written_run(tmp_path)
    nowhere = "tcp/127.0.0.1:1"
    assert cli.main(["ros2", str(tmp_path), "--router", nowhere]) == 2
    assert "rmw_zenohd" in capsys.readouterr().err
    assert cli.main(["ros2", str(tmp_path), "--router", "tcp/192.0.2.1:7447"]) == 2
    assert capsys.readouterr().err
    assert cli.main(["ros2", str(tmp_path), "--domain", "500"]) == 2
    assert "0 to 232" in capsys.readouterr().err
    assert cli.main(["ros2", str(tmp_path / "none")]) == 2
    assert "is no run" in capsys.readouterr().err
    monkeypatch.setattr("scenarios.commands.ros2.ROUTER", nowhere)
    assert cli.main(["run", "pair", "--ros2", "--out", str(tmp_path / "new")]) == 2
    assert not (tmp_path / "new").exists()
