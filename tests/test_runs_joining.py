"""Whole runs in which a late-comer finds where it is by its own map."""

from pathlib import Path

import pytest
from run_helpers import Ran, records_of, run_of, small

from scenarios.schema import Scenario

FLOOR = (
    "robots.count=2",
    "world.window_m=[40.0, 40.0]",
    "sensor.columns=192",
    "planner.max_looks=40",
    "limit_s=700",
    "robots.explorer-2.start_known=false",
    "robots.explorer-2.join_s=120",
)
GROUND = (
    "world.window_m=[20.0, 20.0]",
    "sensor.range_m=8",
    "limit_s=700",
    "robots.explorer-2.start=[14.0, 8.0, 70.0]",
    "robots.explorer-2.start_known=false",
    "robots.explorer-2.join_s=300",
)


def joined(ran: Ran) -> list[str]:
    return [str(e["detail"]) for e in ran.events("explorer-2", "located")]


@pytest.fixture(scope="module")
def floor() -> Scenario:
    return small("planar", *FLOOR)


@pytest.fixture(scope="module")
def on_floor(floor: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Ran:
    return run_of(floor, tmp_path_factory.mktemp("runs") / "floor")


def test_on_a_floor_a_latecomer_joins_by_its_map_and_all_maps_agree(on_floor: Ran) -> None:
    (how,) = joined(on_floor)
    assert how.startswith("matched its map")
    assert on_floor.events("explorer-2", "lost")
    assert on_floor.summary["team"]["maps_equal"]
    late = on_floor.robots["explorer-2"]
    assert on_floor.robot("explorer-2")["pose_error_rms_m"] < 3 * max(late.filter.sigma_m, 0.1)


def test_what_it_mapped_while_lost_is_not_sent_twice(on_floor: Ran) -> None:
    """Its tiles went out before anybody knew where they lie; only the anchor is told again."""
    (located,) = on_floor.events("explorer-2", "located")
    anchors = [
        f
        for f in on_floor.frames()
        if f["from"] == "explorer-2" and f["kind"] == "anchor" and f["end_s"] >= located["t_s"]
    ]
    assert anchors
    assert all(f["bytes"] < 100 for f in anchors)
    robot = on_floor.robots["explorer-2"]
    journal = robot.disk.recover(robot.settings.frame, robot.team.kind).chunks
    frames = [f for f in on_floor.frames() if f["from"] == "explorer-2" and f["kind"] == "map"]
    published = sum(chunk.total for chunk in journal)
    assert sum(float(f["bytes"]) for f in frames) < published + 60 * len(frames)


def test_the_records_of_such_a_run_are_the_same_again(
    floor: Scenario, on_floor: Ran, tmp_path: Path
) -> None:
    assert records_of(run_of(floor, tmp_path / "again")) == records_of(on_floor)


@pytest.mark.slow
def test_over_zenoh_it_joins_by_the_same_map(on_floor: Ran, tmp_path: Path) -> None:
    ran = run_of(small("planar", *FLOOR, "air=zenoh"), tmp_path / "zenoh")
    assert records_of(ran)["events.csv"] == records_of(on_floor)["events.csv"]
    assert records_of(ran)["frames.csv"] == records_of(on_floor)["frames.csv"]


def test_on_the_ground_a_latecomer_joins_by_its_map_and_is_right(tmp_path: Path) -> None:
    ran = run_of(small("pair", *GROUND), tmp_path / "ground")
    (how,) = joined(ran)
    assert how.startswith("matched its map")
    assert ran.summary["team"]["maps_equal"]
    assert ran.summary["team"]["elevation_rmse_m"] < 0.1
    assert ran.robot("explorer-2")["pose_error_rms_m"] < 0.3


def test_in_an_empty_hall_it_says_why_it_is_not_found_and_maps_on(tmp_path: Path) -> None:
    ran = run_of(
        small("planar", *FLOOR, "world.obstacle_share=0", "limit_s=400"), tmp_path / "hall"
    )
    assert joined(ran) == []
    assert "too few walls" in str(ran.events("explorer-2", "not joined")[0]["detail"])
    late = ran.robots["explorer-2"]
    assert not late.located
    assert late.looks > len(late.mapper.all_round)
    assert late.pose != late.settings.start
    assert ran.robot("explorer-2")["pose_error_rms_m"] is None
