"""A robot by itself: on the real clock, with hardware of a driver's, over a network that fails."""

import json
from pathlib import Path
from typing import Any

import pytest
from host_helpers import HERE, certificates, shop, two_computers, wait_for

from agents.geometry import Pose
from comms.air import Packet
from scenarios.agent.air import LATEST_NS, on_time
from scenarios.agent.hardware import Mount, driver_of
from scenarios.agent.settings import read_agent_file
from scenarios.cli import main
from scenarios.errors import ScenarioError

FILE = """
name = "{name}"
folder = "{name}"
method = "wander"

[router]
endpoint = "{endpoint}"
keys = "{keys}"

[team]
key_file = "team.key"
grid = {{ rows = 16, cols = 48 }}

[team.roles]
north = "explorer"
south = "explorer"

[start]
x_m = {x_m}
y_m = 2.0

[hardware]
driver = "simulated"
options = {{ scenario = "pair", seed = 3 }}

[map]
cell_m = 0.25
tile_cells = 16
max_error_m = 0.02

[sensor]
columns = 12
rows = 8
fov_deg = 110
range_m = 3
look_s = 2

[planner]
first_looks = 1
max_looks = {looks}
candidate_step_m = 1

[drive]
speed_mps = 0.3
turn_rate_radps = 0.6
footprint_m = 0.5

[sharing]
status_s = 2
"""


def write_file(folder: Path, name: str, **facts: Any) -> Path:
    known = {"endpoint": "tcp/127.0.0.1:7447", "keys": "", "x_m": 4.0, "looks": 6}
    path = folder / f"{name}.toml"
    path.write_text(FILE.format(name=name, **{**known, **facts}))
    (folder / "team.key").write_bytes(b"0123456789abcdef")
    return path


def status(folder: Path, name: str) -> dict[str, Any]:
    path = folder / name / "status.json"
    return json.loads(path.read_text()) if path.exists() else {}


# --- its file -------------------------------------------------------------------------------


def test_a_file_is_read_and_its_driver_gives_a_body(tmp_path: Path) -> None:
    file, key = read_agent_file(write_file(tmp_path, "north"))
    assert (file.role, file.frame.shape, len(key)) == ("explorer", (16, 48), 16)
    hardware = driver_of(file.hardware.driver)(Mount(file, tmp_path))
    assert hardware.camera is not None
    assert hardware.body is not None
    assert hardware.winch is None


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (('name = "north"', 'name = "nobody"'), "team.roles"),
        (('driver = "simulated"', 'driver = "none"'), "simulated"),
        (('driver = "simulated"', 'driver = "no.module:make"'), "no.module"),
        (("look_s = 2", "look_s = -2"), "look_s"),
        (('key_file = "team.key"', 'key_file = "lost.key"'), "lost.key"),
        (("tcp/127.0.0.1:7447", "tcp/10.0.0.1:7447"), "without credentials"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_in_a_sentence(
    change: tuple[str, str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_file(tmp_path, "north")
    path.write_text(path.read_text().replace(*change))
    assert main(["agent", "--settings", str(path)]) == 2
    said = capsys.readouterr().err
    assert word in said
    assert "Traceback" not in said
    assert not (tmp_path / "north").exists()


def test_a_short_key_is_refused(tmp_path: Path) -> None:
    path = write_file(tmp_path, "north")
    (tmp_path / "team.key").write_bytes(b"short")
    with pytest.raises(ScenarioError, match="5 bytes"):
        read_agent_file(path)


# --- its air --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ahead_ns", "due_ns"), [(5, 5), (0, 0), (LATEST_NS, LATEST_NS), (LATEST_NS + 1, 0), (-1, 0)]
)
def test_a_packet_is_played_when_it_says_or_now(ahead_ns: int, due_ns: int) -> None:
    here_ns = 10**15
    at_ns = here_ns + ahead_ns
    packet = Packet("south", 3, at_ns - 30, at_ns - 10, (("north", at_ns),), False, b"sealed")
    moved, due = on_time(packet, "north", here_ns)
    assert due - here_ns == due_ns
    assert (due - moved.end_ns, moved.end_ns - moved.start_ns) == (10, 20)
    assert moved.data == packet.data


# --- its life -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.timeout(500)
def test_two_robots_map_alone_while_cut_off_and_agree_once_they_meet(tmp_path: Path) -> None:
    keys = certificates(tmp_path, ["north", "south"])
    at = f"tls/{HERE}:7447"
    for name, x_m in (("north", 4.0), ("south", 8.0)):
        write_file(tmp_path, name, endpoint=at, keys=keys, x_m=x_m, looks=15)
    with two_computers() as cable, shop(tmp_path) as ours:
        hub = ("--keys", str(keys), "--robots", "north,south", "--lease", "3")
        ours.start("router.log", "router", "--listen", at, *hub, inside=cable.here)
        for name, where in (("north", cable.here), ("south", cable.there)):
            ours.start(f"{name}.log", "agent", "--settings", f"{name}.toml", inside=where)

        def both(what: str) -> list[Any]:
            return [status(tmp_path, name).get(what, 0) for name in ("north", "south")]

        wait_for(lambda: min(both("received_bytes")) > 0, ours.said("south.log"), 200)
        cable.cut()
        looks, heard = both("looks"), both("received_bytes")
        wait_for(
            lambda: all(now > then for now, then in zip(both("looks"), looks, strict=True)),
            "whoever is cut off goes on alone",
        )
        alone = [status(tmp_path, name)["digest"] for name in ("north", "south")]
        assert all(
            now <= then + 600 for now, then in zip(both("received_bytes"), heard, strict=True)
        )
        cable.mend()
        wait_for(
            lambda: (
                min(both("settled")) and len(set(both("digest"))) == 1 and both("digest") != alone
            ),
            "they agree in the end: " + ours.said("south.log"),
            250,
        )
        assert both("activity") == ["done", "done"]
    poses = [Pose(*status(tmp_path, name)["pose"]) for name in ("north", "south")]
    assert poses[0].distance_m(poses[1]) > 0.1
