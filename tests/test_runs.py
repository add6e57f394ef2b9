"""Whole runs on small worlds: they repeat to the byte, account for all, survive any loss."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from multiprocessing import active_children, forkserver
from pathlib import Path

import numpy as np
import pytest
from run_helpers import RECORDS, UHF, Ran, children_of, records_of, run_of, session_of, small
from sim_helpers import DEMS, needs

from agents.store import Origin
from scenarios import runner

ROOT = Path(__file__).parents[1]
TEAM = ("recon", "cliffbot", "anchor-left", "anchor-right")
PAIR = ("explorer-1", "explorer-2")
BUSY = "while True: pass"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def cliff(folder: Path) -> Ran:
    return run_of(small("cliff"), folder / "cliff")


@pytest.fixture(scope="module")
def pair(folder: Path) -> Ran:
    return run_of(small("pair"), folder / "pair")


@pytest.fixture
def busy_machine() -> Iterator[None]:
    """Keep every core busy beside the run."""
    hogs = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(os.cpu_count() or 1)]
    yield
    for hog in hogs:
        hog.kill()
        hog.wait()


EVENTFUL = [
    {"at_s": 40.5, "link": "explorer-1", "loss": 0.3},
    {"at_s": 60.0, "stop": "explorer-2"},
    {"at_s": 75.25, "resume": "explorer-2"},
    {"at_s": 90.0, "join": "explorer-3"},
    {"at_s": 100.0, "restart": "explorer-1", "after_s": 30.0},
    {"at_s": 110.0, "link": "all", "profile": "mer-high", "loss": 0.1},
    {"at_s": 170.0, "kill": "explorer-2"},
]


# --- the same again -------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_records_byte_for_byte(cliff: Ran, tmp_path: Path) -> None:
    assert records_of(run_of(small("cliff"), tmp_path / "again")) == records_of(cliff)


def test_another_seed_gives_another_run(cliff: Ran, tmp_path: Path) -> None:
    other = records_of(run_of(small("cliff", "seed=2"), tmp_path / "other"))
    assert all(other[name] != records_of(cliff)[name] for name in RECORDS)


def test_the_scenario_that_a_run_leaves_can_be_run_again_as_it_is(
    pair: Ran, tmp_path: Path
) -> None:
    from scenarios.schema import load  # noqa: PLC0415  (a name that the tests use otherwise)

    again = run_of(load(str(pair.out / "scenario.toml")), tmp_path / "again")
    assert records_of(again) == records_of(pair)


def test_processes_over_zenoh_on_a_busy_machine_do_what_one_process_does(
    cliff: Ran, tmp_path: Path, busy_machine: None
) -> None:
    zenoh = run_of(small("cliff", "air=zenoh"), tmp_path / "zenoh")
    assert records_of(zenoh) == records_of(cliff)


def test_whatever_happens_happens_alike_on_every_air(tmp_path: Path) -> None:
    runs = [
        run_of(small("pair", f"air={air}", "robots.count=3", events=EVENTFUL), tmp_path / air)
        for air in ("memory", "zenoh")
    ]
    one, other = (records_of(ran) for ran in runs)
    assert one == other
    assert [runs[0].robot(f"explorer-{n}")["state"] for n in (1, 2, 3)] == [
        "alive",
        "killed",
        "alive",
    ]


# --- accounts -------------------------------------------------------------------------------


@pytest.fixture(params=["cliff", "pair", "eventful", "sojourner", "lossy"], scope="module")
def any_run(request: pytest.FixtureRequest, folder: Path) -> Ran:
    name: str = request.param
    if name in ("cliff", "pair"):
        return request.getfixturevalue(name)
    scenario = {
        "eventful": lambda: small("pair", "robots.count=3", events=EVENTFUL),
        "sojourner": lambda: small("cliff", "links.profile=sojourner", "limit_s=400"),
        "lossy": lambda: small("pair", "links.loss=0.3", "links.jitter_s=0.5", "limit_s=400"),
    }[name]()
    return run_of(scenario, folder / name)


def test_what_was_sent_is_what_the_frames_add_up_to(any_run: Ran) -> None:
    sent: dict[str, list[int]] = defaultdict(list)
    for frame in any_run.frames():
        sent[frame["from"]].append(frame["bytes"])
    for name, told in any_run.summary["robots"].items():
        assert told["sent_bytes"] == sum(sent[name])
        assert told["sent_frames"] == len(sent[name])
        heard = [f for f in any_run.table("frames") if f["to"] == name]
        delivered = [f for f in heard if f["verdict"] == "delivered"]
        assert told["received_frames"] == len(delivered)
        assert told["received_bytes"] <= sum(f["bytes"] for f in delivered)
        assert 0 <= told["link_busy_fraction"] <= 1


def test_no_frame_comes_before_its_last_bit_has_been_sent_and_has_travelled(any_run: Ran) -> None:
    fixed = {"sojourner": (2400.0, 0.05)}.get(any_run.out.name, (UHF.rate_bps, 0.03))
    arrivals = 0
    for frame in any_run.table("frames"):
        rate_bps, latency_s = fixed
        if any_run.out.name == "eventful" and frame["start_s"] >= 110.0:
            rate_bps, latency_s = 12_000.0, 0.05
        airtime_s = 8 * frame["bytes"] / rate_bps
        assert frame["chosen_s"] <= frame["start_s"]
        assert frame["end_s"] == pytest.approx(frame["start_s"] + airtime_s, abs=2e-9)
        if frame["arrive_s"] is not None:
            arrivals += 1
            assert frame["arrive_s"] >= frame["start_s"] + airtime_s + latency_s - 2e-9
    heard = sum(told["received_frames"] for told in any_run.summary["robots"].values())
    # Robots that were cut short have taken what their records do not tell of any more.
    assert arrivals >= heard > 0


def test_a_transmitter_sends_one_frame_at_a_time(any_run: Ran) -> None:
    frames = sorted(any_run.frames(), key=lambda f: (f["from"], f["start_s"], f["end_s"]))
    assert frames
    for one, other in pairwise(frames):
        if one["from"] == other["from"]:
            assert other["start_s"] >= one["end_s"] - 1e-9


def test_nobody_ever_knows_less_than_before(any_run: Ran) -> None:
    known: dict[str, int] = defaultdict(int)
    restarted_s = {e["robot"]: e["t_s"] for e in any_run.table("events") if e["what"] == "restart"}
    for row in any_run.table("maps"):
        name = row["robot"]
        if row["t_s"] >= restarted_s.get(name, np.inf):
            # A new life begins with what its disk holds, and learns the rest again.
            known[name] = 0
            del restarted_s[name]
        assert row["team_cells"] >= max(known[name], row["own_cells"])
        known[name] = row["team_cells"]
    for name, told in any_run.summary["robots"].items():
        if told["state"] == "alive":
            assert told["team_cells"] == known[name] > 0


def test_looks_are_told_one_by_one(any_run: Ran) -> None:
    looks = any_run.table("looks")
    for name, told in any_run.summary["robots"].items():
        mine = [look for look in looks if look["robot"] == name]
        assert told["looks"] == len(mine)
        assert all(a["t_s"] < b["t_s"] for a, b in pairwise(mine))
        assert all(look["new_cells"] <= look["obtained_cells"] for look in mine)
    assert looks


# --- the mission ----------------------------------------------------------------------------


def test_the_team_ends_with_one_map_of_what_it_saw(cliff: Ran, pair: Ran) -> None:
    for ran in (cliff, pair):
        assert ran.summary["team"]["maps_equal"]
        assert len(ran.digests()) == 1
        assert ran.summary["team"]["coverage"] > 0.4
        assert ran.summary["team"]["elevation_rmse_m"] < 0.1
        assert ran.summary["simulated_s"] < 900
    assert cliff.robot("cliffbot")["own_cells"] == 0
    recon, heard = cliff.robots["recon"], int(cliff.robot("cliffbot")["team_cells"])
    masks = [recon.team.published_mask(recon.me, n) for n in range(len(recon.own.submaps))]
    assert heard == sum(int(mask.sum()) for mask in masks) > 1000
    # A cell or two that the last looks added to a tile are not worth a new version of it.
    unsent = cliff.robot("recon")["own_cells"] - heard
    assert 0 <= unsent < 0.01 * heard


def test_no_robot_is_surer_than_all_measurements_together(pair: Ran) -> None:
    measured = sum(
        np.max([submap.information for submap in robot.own.submaps], axis=0)
        for robot in pair.robots.values()
    )
    for robot in pair.robots.values():
        assert np.all(1.0 / robot.team.fused().variance_m2 <= measured * (1 + 1e-9))


def test_with_the_radios_off_nobody_knows_of_anybody(tmp_path: Path) -> None:
    ran = run_of(small("pair", "links.up=false"), tmp_path / "alone")
    assert ran.summary["simulated_s"] < 900, "what nobody can hear need not be sent"
    assert ran.table("frames") == []
    for name, robot in ran.robots.items():
        told = ran.robot(name)
        assert (told["sent_bytes"], told["received_bytes"]) == (0, 0)
        assert told["team_cells"] == told["own_cells"] > 0
        assert {key.robot for key in robot.store} <= {robot.me.robot}
        assert robot.mates == {}


def test_a_robot_alone_sees_what_it_sees_in_a_team_whose_radios_are_off(tmp_path: Path) -> None:
    """Rates of 0 bps, links that are down, ranges of a centimetre: nothing passes any of them."""
    looks = []
    for i, setting in enumerate(("links.up=false", "links.rate_bps=0", "links.range_m=0.01")):
        ran = run_of(small("pair", setting, "limit_s=200"), tmp_path / str(i))
        assert all(f["verdict"] != "delivered" for f in ran.table("frames"))
        looks.append((ran.out / "looks.csv").read_bytes())
    assert looks[0] == looks[1] == looks[2]


# --- what goes wrong ------------------------------------------------------------------------


def test_survivors_of_a_killed_robot_finish_with_all_they_had(tmp_path: Path) -> None:
    """A real SIGKILL, on its simulated instant."""
    events = [{"at_s": 150.0, "kill": "recon"}]
    ran = run_of(small("cliff", "air=zenoh", events=events), tmp_path / "kill")
    assert ran.robot("recon")["state"] == "killed"
    survivors = TEAM[1:]
    assert {ran.robot(name)["state"] for name in survivors} == {"alive"}
    assert len(ran.digests(*survivors)) == 1
    assert ran.summary["team"]["maps_equal"]
    assert max(look["t_s"] for look in ran.table("looks")) < 150.0
    assert max(f["start_s"] for f in ran.frames() if f["from"] == "recon") < 150.0
    for name in survivors:
        before = [m for m in ran.table("maps") if m["robot"] == name and m["t_s"] <= 150.0]
        assert ran.robot(name)["team_cells"] >= before[-1]["team_cells"] > 0
    assert ran.summary["outcome"] == "partial"
    assert "recon was killed" in ran.summary["outcome_reason"]
    assert [e["t_s"] for e in ran.events("recon", "kill")] == [150.0]


def test_a_robot_that_dies_by_itself_is_named_and_the_run_ends_in_order(tmp_path: Path) -> None:
    """Killed from outside, at whatever moment of the wall's: the run goes on without it."""

    def murder() -> None:
        deadline_s = time.monotonic() + 60
        while time.monotonic() < deadline_s:
            victims = [c for c in active_children() if c.name == "recon"]
            logged = tmp_path / "run" / "recon.mcap"
            if victims and logged.is_file() and logged.stat().st_size > 10_000:
                os.kill(victims[0].pid or 0, signal.SIGKILL)
                return
            time.sleep(0.002)

    murderer = threading.Thread(target=murder)
    murderer.start()
    ran = run_of(small("cliff", "air=zenoh"), tmp_path / "run")
    murderer.join()
    assert ran.robot("recon")["state"] == "killed"
    assert "recon: its process ended (signal SIGKILL)" in ran.summary["outcome_reason"]
    assert len(ran.events("recon", "died")) == 1
    assert {ran.robot(name)["state"] for name in TEAM[1:]} == {"alive"}
    assert len(ran.digests(*TEAM[1:])) == 1
    assert children_of(_fork_server()) == []


def _fork_server() -> int:
    pid = forkserver._forkserver._forkserver_pid
    assert pid is not None
    return pid


def test_a_robot_that_hangs_does_nothing_and_then_goes_on_where_it_was(tmp_path: Path) -> None:
    events = [{"at_s": 60.0, "stop": "explorer-1"}, {"at_s": 130.0, "resume": "explorer-1"}]
    ran = run_of(small("pair", events=events), tmp_path / "hang")
    begun = [f["start_s"] for f in ran.frames() if f["from"] == "explorer-1"]
    assert not [t for t in begun if 60.0 < t < 130.0]
    assert max(begun) > 130.0
    looks = [x["t_s"] for x in ran.table("looks") if x["robot"] == "explorer-1"]
    assert not [t for t in looks if 60.0 < t < 130.0]
    assert max(looks) > 130.0
    assert ran.robot("explorer-1")["state"] == "alive"
    assert len(ran.digests()) == 1


def test_a_robot_that_hangs_for_ever_holds_nobody_up(tmp_path: Path) -> None:
    events = [{"at_s": 60.0, "stop": "explorer-1"}]
    ran = run_of(small("pair", "air=zenoh", "limit_s=500", events=events), tmp_path / "hang")
    assert ran.robot("explorer-1")["state"] == "stopped"
    assert ran.robot("explorer-2")["looks"] > 6
    assert max(x["t_s"] for x in ran.table("looks") if x["robot"] == "explorer-1") <= 60.0
    assert children_of(_fork_server()) == []


def test_a_robot_that_restarts_comes_back_with_what_it_had(tmp_path: Path) -> None:
    events = [{"at_s": 80.0, "restart": "explorer-1", "after_s": 20.0}]
    ran = run_of(small("pair", events=events), tmp_path / "restart")
    robot = ran.robots["explorer-1"]
    assert robot.me == Origin(0, 1)
    assert (ran.out / "explorer-1-1.mcap").is_file()
    assert ran.robot("explorer-1")["state"] == "alive"
    assert len(ran.digests()) == 1
    published = {key.incarnation for key in robot.store if key.robot == 0}
    assert published == {0, 1}
    assert {a.incarnation for a in robot.store.anchors if a.robot == 0} == {0, 1}
    sequence = [f["start_s"] for f in ran.frames() if f["from"] == "explorer-1"]
    assert not [t for t in sequence if 80.0 < t < 100.0]
    assert max(sequence) > 100.0


def test_who_joins_late_is_told_what_it_missed(tmp_path: Path) -> None:
    ran = run_of(small("pair", "robots.explorer-2.join_s=120"), tmp_path / "late")
    assert len(ran.digests()) == 1
    mine = [x for x in ran.table("looks") if x["robot"] == "explorer-2"]
    assert min(x["t_s"] for x in mine) >= 120.0
    assert not [f for f in ran.frames() if f["from"] == "explorer-2" and f["start_s"] < 120.0]
    early = [f for f in ran.table("frames") if f["to"] == "explorer-2" and f["end_s"] < 119.0]
    assert early
    assert {f["verdict"] for f in early} == {"receiver down"}


def test_a_link_that_fails_passes_nothing_and_is_made_good_when_it_is_back(tmp_path: Path) -> None:
    events = [
        {"at_s": 50.0, "link": "all", "up": False},
        {"at_s": 140.0, "link": "all", "up": True},
    ]
    ran = run_of(small("pair", events=events), tmp_path / "link")
    for frame in ran.table("frames"):
        if frame["end_s"] + 0.03 <= 50.0:
            assert frame["verdict"] == "delivered", "it came while the link was up"
        if frame["verdict"] == "delivered":
            assert frame["arrive_s"] <= 50.0 or frame["start_s"] >= 140.0
    assert [f for f in ran.frames() if f["start_s"] >= 140.0]
    assert len(ran.digests()) == 1
    assert ran.summary["simulated_s"] > 140.0


def test_a_team_whose_last_robot_dies_ends_there(tmp_path: Path) -> None:
    events = [{"at_s": 30.0 + n, "kill": name} for n, name in enumerate(PAIR)]
    ran = run_of(small("pair", events=events), tmp_path / "all")
    assert ran.summary["simulated_s"] == 31.0
    assert ran.summary["outcome"] == "failed"
    assert "no robot was left" in ran.summary["outcome_reason"]


# --- the program ----------------------------------------------------------------------------


def ropeteam(*arguments: str, **options) -> subprocess.Popen[str]:
    command = [sys.executable, "-W", "error", "-m", "scenarios.cli", *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, cwd=ROOT, start_new_session=True, **pipes, **options)


def all_gone(session: int) -> bool:
    """Say whether a program's processes are gone; the fork server sees its end a moment later."""
    deadline_s = time.monotonic() + 5.0
    while session_of(session) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    return session_of(session) == []


def small_file(folder: Path, *overrides: str) -> str:
    path = folder / "small.toml"
    path.write_text(runner.dump(small("pair", *overrides)))
    return str(path)


@pytest.mark.parametrize("air", ["memory", "zenoh"])
def test_a_run_says_nothing_on_stderr_and_leaves_nobody_behind(tmp_path: Path, air: str) -> None:
    out = tmp_path / "out"
    process = ropeteam(
        "run", small_file(tmp_path, f"air={air}", "limit_s=120"), "--out", str(out), "--quiet"
    )
    stdout, stderr = process.communicate(timeout=60)
    assert (process.returncode, stdout, stderr) == (0, "", "")
    assert all_gone(process.pid)
    assert json.loads((out / "summary.json").read_text())["schema"] == 1
    assert (out / "overview.png").stat().st_size > 10_000


@pytest.mark.parametrize("air", ["memory", "zenoh"])
def test_ctrl_c_ends_the_run_in_order_and_keeps_its_records(tmp_path: Path, air: str) -> None:
    out = tmp_path / "out"
    longer = ("planner.max_looks=200", "planner.max_candidates=150", "limit_s=7000")
    arguments = ("run", small_file(tmp_path, f"air={air}", *longer), "--out", str(out))
    process = ropeteam(*arguments)
    log = out / "explorer-1.mcap"
    deadline_s = time.monotonic() + 60
    while not (log.is_file() and log.stat().st_size > 5_000) and time.monotonic() < deadline_s:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of them
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert stderr == "interrupted\n"
    assert all_gone(process.pid)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["outcome_reason"].startswith("interrupted by the user")
    assert 0 < summary["simulated_s"] < 7000
    for name in ("looks.csv", "frames.csv", "maps.csv", "events.csv", "host.json"):
        assert (out / name).stat().st_size > 0


def test_a_runner_that_is_killed_takes_its_robots_along(tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = ropeteam("run", small_file(tmp_path, "air=zenoh"), "--out", str(out))
    log = out / "explorer-1.mcap"
    deadline_s = time.monotonic() + 60
    while not log.is_file() and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert len(session_of(process.pid)) > 2
    process.kill()
    process.wait()
    assert all_gone(process.pid)
    process.communicate()


# --- real ground ----------------------------------------------------------------------------


@needs("mars_gale_hirise_1m.npz")
@needs("marsyard_erc2021_0p09m.npz")
@pytest.mark.parametrize(
    ("file", "cell_m"), [("mars_gale_hirise_1m.npz", 0.1), ("marsyard_erc2021_0p09m.npz", None)]
)
@pytest.mark.parametrize("name", ["cliff", "pair"])
def test_teams_map_real_ground(tmp_path: Path, file: str, cell_m: float | None, name: str) -> None:
    overrides = [f"world.terrain.file={DEMS / file}"]
    if cell_m is not None:
        overrides.append(f"world.terrain.cell_m={cell_m}")
    ran = run_of(small(name, *overrides), tmp_path / "real")
    assert ran.summary["team"]["maps_equal"]
    assert ran.summary["team"]["coverage"] > 0.2
    assert ran.summary["team"]["elevation_rmse_m"] < 0.15
