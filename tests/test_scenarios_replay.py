"""One robot alone, from its own log, decides as it did in its team."""

import builtins
import shutil
import sys
from pathlib import Path

import pytest
from run_helpers import Ran, run_of, small

from agents.robot import Robot
from scenarios import cli
from scenarios.errors import StudyError
from scenarios.host import Host
from scenarios.logs.handed import BORN, HANDED, Life, Message, read_life
from scenarios.replay import Replayed, replay

CLIFF = ("recon", "cliffbot", "anchor-left", "anchor-right")
PAIR = ("explorer-1", "explorer-2", "explorer-3")
EVENTS = [
    {"at_s": 40.5, "link": "explorer-1", "loss": 0.3},
    {"at_s": 60.0, "stop": "explorer-2"},
    {"at_s": 75.25, "resume": "explorer-2"},
    {"at_s": 90.0, "join": "explorer-3"},
    {"at_s": 100.0, "restart": "explorer-1", "after_s": 30.0},
    {"at_s": 170.0, "kill": "explorer-2"},
]


@pytest.fixture(scope="module")
def cliff(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    return run_of(small("cliff"), tmp_path_factory.mktemp("runs") / "cliff")


@pytest.fixture(scope="module")
def eventful(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    scenario = small("pair", "robots.count=3", events=EVENTS)
    return run_of(scenario, tmp_path_factory.mktemp("runs") / "eventful")


def messages(path: Path, *topics: str) -> list[Message]:
    return [message for message in read_life(path).messages if message.topic in topics]


def assert_same(ran: Ran, told: Replayed, out: Path) -> None:
    assert told.difference == ""
    assert told.same
    for path in sorted(ran.out.glob(f"{told.robot}*.mcap")):
        rows = ("looks", "frames_sent", "frames_heard", "map", "events")
        assert messages(out / path.name, *rows) == messages(path, *rows) != []


@pytest.mark.parametrize("robot", CLIFF)
def test_a_robot_alone_looks_sends_and_ends_as_in_its_team(
    cliff: Ran, tmp_path: Path, robot: str
) -> None:
    told = replay(cliff.out, robot, tmp_path / "out")
    assert_same(cliff, told, tmp_path / "out")
    assert told.digest == cliff.robot(robot)["team_map_digest"]
    assert told.records.get("looks", 0) == cliff.robot(robot)["looks"]


@pytest.mark.parametrize("robot", PAIR)
def test_a_robot_that_was_stopped_restarted_killed_or_late_decides_the_same_again(
    eventful: Ran, tmp_path: Path, robot: str
) -> None:
    told = replay(eventful.out, robot, tmp_path / "out")
    assert_same(eventful, told, tmp_path / "out")
    assert told.lives == (2 if robot == "explorer-1" else 1)
    # A killed robot's last sample in the summary is older than its death.
    ended = eventful.robot(robot)["state"] == "alive"
    assert told.digest_then == (eventful.robot(robot)["team_map_digest"] if ended else "")


def test_a_robot_that_was_a_process_is_replayed_like_any_other(tmp_path: Path) -> None:
    ran = run_of(small("pair", "air=zenoh", "limit_s=200"), tmp_path / "run")
    assert_same(ran, replay(ran.out, "explorer-1", tmp_path / "out"), tmp_path / "out")


def test_a_program_that_was_changed_is_found_out(
    eventful: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def bored(robot: Robot) -> None:
        """Find nothing worth a look."""
        del robot

    monkeypatch.setattr(Robot, "choose_look", bored)
    told = replay(eventful.out, "explorer-1", tmp_path / "out")
    assert not told.same
    assert told.difference.startswith("record ")


def test_a_packet_less_is_found_out(
    eventful: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def robbed(path: Path) -> Life:
        life = read_life(path)
        full = next((w for w in life.windows if w.packets), None)
        if path.parent == eventful.out and full is not None:
            full.packets.clear()
        return life

    monkeypatch.setattr("scenarios.replay.read_life", robbed)
    told = replay(eventful.out, "explorer-3", tmp_path / "out")
    assert "record " in told.difference


def test_the_log_holds_all_that_a_replay_needs_and_stays_small(cliff: Ran) -> None:
    for robot in CLIFF:
        life = read_life(cliff.out / f"{robot}.mcap")
        assert life.messages[0].topic == BORN
        assert life.ended_in_order
        handed = sum(len(m.data) for m in life.messages if m.topic == HANDED)
        heard = cliff.robot(robot)["received_bytes"]
        assert handed < 6 * heard + 200 * len(life.windows)


def test_a_log_cut_anywhere_is_replayed_up_to_there(eventful: Ran, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(eventful.out, run)
    whole = (run / "explorer-3.mcap").read_bytes()
    for number, share in enumerate((0.5, 0.77)):
        (run / "explorer-3.mcap").write_bytes(whole[: int(share * len(whole))])
        told = replay(run, "explorer-3", tmp_path / f"out{number}")
        assert told.same
        assert 10 < told.windows < len(read_life(eventful.out / "explorer-3.mcap").windows)


# --- the command --------------------------------------------------------------------------------


def ropeteam(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    code = cli.main(argv)
    told = capsys.readouterr()
    return code, told.out, told.err


def test_the_command_says_that_all_is_the_same(
    cliff: Ran, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out")
    argv = ["replay", str(cliff.out), "--robot", "cliffbot", "--out", out]
    code, said, _ = ropeteam(capsys, *argv)
    assert code == 0
    assert "decides as it did then" in said
    assert cliff.robot("cliffbot")["team_map_digest"] in said
    assert ropeteam(capsys, *argv)[0] == 2, "a folder that holds a former replay is not replaced"


def test_a_break_stops_once_with_the_robot_at_hand(
    cliff: Ran, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stops: list[Host] = []
    monkeypatch.setattr(
        builtins, "breakpoint", lambda: stops.append(sys._getframe(1).f_locals["host"])
    )
    code, said, _ = ropeteam(
        capsys, "replay", str(cliff.out), "--robot", "recon", "--break-at", "60"
    )
    assert code == 0
    assert [host.name for host in stops] == ["recon"]
    assert "decides as it did then" in said


@pytest.fixture
def bad_runs(cliff: Ran, tmp_path: Path) -> dict[str, Path]:
    runs: dict[str, Path] = {"empty": tmp_path / "empty"}
    runs["empty"].mkdir()
    for name in ("real", "unborn", "garbled", "gone"):
        runs[name] = tmp_path / name
        runs[name].mkdir()
        text = (cliff.out / "scenario.toml").read_text()
        if name == "real":
            text = text.replace('mode = "virtual"', 'mode = "real"')
        (runs[name] / "scenario.toml").write_text(text)
    (runs["garbled"] / "recon.mcap").write_bytes(b"no log at all, but long enough to look")
    whole = (cliff.out / "recon.mcap").read_bytes()
    (runs["unborn"] / "recon.mcap").write_bytes(whole.replace(b"born", b"bore"))
    return runs


@pytest.mark.parametrize(
    ("run", "robot", "words"),
    [
        ("empty", "recon", "is no run"),
        ("real", "recon", "virtual clock can be replayed"),
        ("gone", "recon", "never lived"),
        ("gone", "rover", "must be one of recon, cliffbot, anchor-left, anchor-right"),
        ("garbled", "recon", "is no log of a robot"),
        ("unborn", "recon", "does not tell what the robot was handed"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_a_sentence(
    bad_runs: dict[str, Path], tmp_path: Path, run: str, robot: str, words: str
) -> None:
    with pytest.raises(StudyError, match=words):
        replay(bad_runs[run], robot, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_log_cut_at_any_byte_is_read_or_refused(cliff: Ran, tmp_path: Path) -> None:
    whole = (cliff.out / "recon.mcap").read_bytes()
    path = tmp_path / "recon.mcap"
    windows = 0
    for size in (*range(0, 1200, 7), len(whole) - 3, len(whole)):
        path.write_bytes(whole[:size])
        try:
            read = len(read_life(path).windows)
        except StudyError:
            read = 0
        assert read >= windows, "a longer log tells less"
        windows = read
    assert windows > 100
