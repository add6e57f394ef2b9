"""Robots of one run on several computers: the same records, though a cable is cut meanwhile."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from host_helpers import HERE, Shop, certificates, shop, two_computers, wait_for
from run_helpers import RECORDS, run_of, small

from agents.geometry import Pose
from comms.zenoh_security import SecurityError, access_control
from scenarios.cli import main
from scenarios.hosts.plans import PlanError, pack_plan, unpack_plan
from scenarios.schema import Scenario, dump
from scenarios.stage import set_stage
from scenarios.wire import Plan
from sim.ground import Terrain

MINUTE = ("limit_s=60", "robots.count=3", "air=zenoh")
TRIALS = [
    {"at_s": 20.0, "stop": "explorer-1"},
    {"at_s": 25.0, "resume": "explorer-1"},
    {"at_s": 30.0, "restart": "explorer-2", "after_s": 5.0},
    {"at_s": 40.0, "kill": "explorer-3"},
]


def plan_of(scenario: Scenario, folder: Path) -> Plan:
    stage = set_stage(scenario)
    name = next(iter(scenario.robots))
    observable = np.ones(stage.terrain.frame.shape, dtype=bool)
    place = {"pose": Pose(1.0, 2.0, 3.0, 0.5), "tether_m": 4.0, "baseline": {"a#0": 3}}
    plan = Plan(
        scenario=scenario,
        name=name,
        terrain=stage.terrain,
        observable=observable,
        starts=stage.starts,
        goal_m=stage.goal_m,
        landmarks={"lander": Pose(5.0, 6.0, 0.5, 0.0)},
        folder=folder,
    )
    return replace(plan, **place, segments=(("x", 1, 2.0),), link_events=(1, 2))


# --- plans ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cliff", "planar"])
def test_a_plan_comes_out_as_it_was_put_in(name: str, tmp_path: Path) -> None:
    scenario = small(name) if name == "cliff" else small(name, "world.window_m=[20.0, 20.0]")
    before = plan_of(scenario, tmp_path / "runner")
    after = unpack_plan(pack_plan(before), tmp_path / "host", "tcp/127.0.0.1:1")
    world = "terrain"
    same = {f: getattr(before, f) for f in vars(before) if f not in (world, "observable")}
    changed = {"folder": tmp_path / "host", "endpoint": "tcp/127.0.0.1:1"}
    assert {f: getattr(after, f) for f in same} == {**same, **changed}
    assert np.array_equal(after.observable, before.observable)
    assert after.terrain.frame == before.terrain.frame
    if isinstance(before.terrain, Terrain):
        assert isinstance(after.terrain, Terrain)
        for grid in ("elevation_m", "texture", "edge_m"):
            one, other = getattr(before.terrain, grid), getattr(after.terrain, grid)
            assert (one is None) == (other is None)
            assert one is None or (one.dtype == other.dtype and np.array_equal(one, other))
    else:
        assert np.array_equal(after.terrain.solid, before.terrain.solid)
        assert after.terrain.start == before.terrain.start


@pytest.mark.parametrize("cut", [0, 1, 100, -1])
def test_what_is_no_plan_is_refused(cut: int, tmp_path: Path) -> None:
    data = pack_plan(plan_of(small("cliff"), tmp_path))
    with pytest.raises(PlanError):
        unpack_plan(data[:cut], tmp_path, "")
    with pytest.raises(PlanError):
        unpack_plan(b"\x81\xa8arrays\xc0\x93", tmp_path, "")


# --- who may what ---------------------------------------------------------------------------


def test_a_machine_may_say_what_any_robot_may_and_a_robot_only_its_own() -> None:
    rules = access_control(["rover"], ["north"])
    keys = {rule["id"]: rule["key_exprs"] for rule in rules["rules"]}
    may = {policy["subjects"][0]: policy["rules"] for policy in rules["policies"]}
    assert [key for rule in may["rover"] for key in keys[rule]] == [
        "team/**", "team/**", "team/rover/**",
    ]  # fmt: skip
    assert {key for rule in may["north"] for key in keys[rule]} == {"team/**", "world/**"}
    with pytest.raises(SecurityError):
        access_control(["north"], ["north"])


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--keys", "keys"], "--hosts"),
        (["--hosts", "a,b"], "needs a router"),
        (["--hosts", "a", "--listen", "tcp/10.0.0.1:0", "--keys", "nowhere"], "ca.pem"),
        (["--hosts", "a", "--listen", "tcp/127.0.0.1:0", "--clock", "real"], "virtual clock"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    options: list[str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small_world = ["--set", "world.window_m=[16, 14]", "--set", "map.cell_m=0.2"]
    assert main(["run", "pair", "--out", str(tmp_path / "out"), *small_world, *options]) == 2
    assert word in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --- runs -----------------------------------------------------------------------------------


def same_records(one: Path, other: Path) -> bool:
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in RECORDS)


def on_hosts(ours: Shop, scenario: Scenario, *where: str, inside: str | None = None):
    (ours.folder / "scenario.toml").write_text(dump(scenario))
    words = ("run", "scenario.toml", "--quiet", "--out", "hosted", "--hosts", "north,south")
    return ours.start("runner.log", *words, *where, inside=inside)


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_two_hosts_and_a_router_leave_the_records_of_one_process(tmp_path: Path) -> None:
    scenario = small("pair", *MINUTE, events=TRIALS)
    with shop(tmp_path) as ours:
        ours.start("router.log", "router", "--listen", "tcp/127.0.0.1:0")
        wait_for(lambda: "router at " in ours.said("router.log"), "no router")
        at = ours.said("router.log").split("router at ")[1].split()[0]
        for name in ("north", "south"):
            ours.start(f"{name}.log", "host", "--connect", at, "--name", name, "--runs", "1")
        assert on_hosts(ours, scenario, "--connect", at).wait(300) == 0, ours.said("runner.log")
    alone = run_of(small("pair", *MINUTE[:2], events=TRIALS), tmp_path / "alone")
    assert same_records(tmp_path / "hosted", alone.out)
    logs = sorted(path.stem for path in (tmp_path / "hosted").glob("*.mcap"))
    assert logs == ["explorer-1", "explorer-2", "explorer-2-1", "explorer-3", "run"]


@pytest.mark.slow
@pytest.mark.timeout(500)
def test_a_host_at_an_address_of_its_own_is_cut_off_and_comes_back(tmp_path: Path) -> None:
    scenario = small("pair", *MINUTE)
    keys = str(certificates(tmp_path, ["north", "south"]))
    at = f"tls/{HERE}:7447"
    with two_computers() as cable, shop(tmp_path) as ours:
        hub = ("--listen", at, "--keys", keys, "--name", "hub")
        runner = on_hosts(ours, scenario, *hub, inside=cable.here)
        for name, where in (("north", cable.here), ("south", cable.there)):
            words = ("host", "--connect", at, "--keys", keys, "--name", name, "--runs", "1")
            ours.start(f"{name}.log", *words, inside=where)
        wait_for(lambda: "starts" in ours.said("south.log"), ours.said("runner.log"), 250)
        cable.cut()
        time.sleep(4.0)
        assert runner.poll() is None, "it waits for the host that is cut off"
        cable.mend()
        assert runner.wait(300) == 0, ours.said("runner.log")
    alone = run_of(small("pair", *MINUTE[:2]), tmp_path / "alone")
    assert same_records(tmp_path / "hosted", alone.out)
