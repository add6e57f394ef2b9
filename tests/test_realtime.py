"""The same program on the wall clock: same kind of result, frames on time."""

import json
from pathlib import Path
from typing import Any

import pytest
from run_helpers import UHF, run_of, small

from scenarios.errors import ScenarioError


@pytest.mark.parametrize("air", ["memory", "zenoh"])
def test_a_minute_on_the_wall_clock_ends_like_one_on_the_virtual(tmp_path: Path, air: str) -> None:
    minute = ["limit_s=60", f"air={air}"]
    real = ["clock.mode=real", "clock.speed=10.0", *minute]
    ran = run_of(small("cliff", *real), tmp_path / "real")
    virtual = run_of(small("cliff", *minute), tmp_path / "virtual")

    assert ran.summary["clock"] == "real"
    assert ran.summary["simulated_s"] == pytest.approx(60.0, abs=3.0)
    assert ran.summary["outcome"] == virtual.summary["outcome"]
    assert ran.summary.keys() == virtual.summary.keys()
    for name, robot in ran.summary["robots"].items():
        assert robot["state"] == "alive"
        assert robot["sent_frames"] > 0, name
    looks = ran.summary["robots"]["recon"]["looks"]
    assert 1 <= looks <= virtual.summary["robots"]["recon"]["looks"]

    for frame in ran.table("frames"):
        airtime_s = 8 * frame["bytes"] / UHF.rate_bps
        assert frame["end_s"] - frame["start_s"] == pytest.approx(airtime_s, abs=1e-6)
        if frame["arrive_s"] is not None:
            assert frame["arrive_s"] >= frame["end_s"] + UHF.latency_ns / 1e9 - 1e-9

    lag = json.loads((ran.out / "host.json").read_text())["delivery_lag_s"]
    assert lag["frames"] > 20
    assert (
        lag["median"] < 0.1
    )  # on a busy machine; `ropeteam link test` and benchmarks say how late


def test_a_killed_robot_on_the_wall_clock_leaves_the_others_at_work(tmp_path: Path) -> None:
    scenario = small(
        "cliff",
        "limit_s=40",
        "air=zenoh",
        "clock.mode=real",
        "clock.speed=10.0",
        events=[{"at_s": 20.0, "kill": "recon"}],
    )
    ran = run_of(scenario, tmp_path / "kill")
    states = {name: robot["state"] for name, robot in ran.summary["robots"].items()}
    assert states.pop("recon") == "killed"
    assert set(states.values()) == {"alive"}
    assert "recon was killed" in ran.summary["outcome_reason"]


def test_a_restarted_robot_comes_back_on_the_wall_clock(tmp_path: Path) -> None:
    scenario = small(
        "cliff",
        "limit_s=60",
        "air=zenoh",
        "clock.mode=real",
        "clock.speed=10.0",
        events=[{"at_s": 25.0, "restart": "recon", "after_s": 10.0}],
    )
    ran = run_of(scenario, tmp_path / "restart")
    assert ran.robot("recon")["state"] == "alive"
    assert ran.events("recon", "restart"), "it says what it took up"


def test_nobody_can_be_hung_alone_in_one_process_on_the_wall_clock() -> None:
    hang: list[dict[str, Any]] = [{"at_s": 5.0, "stop": "recon"}]
    with pytest.raises(ScenarioError, match=r"events\.0\.stop.*zenoh"):
        small("cliff", "clock.mode=real", "clock.speed=10.0", events=hang)
