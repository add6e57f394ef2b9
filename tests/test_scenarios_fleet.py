"""A fleet in one process: who is near hears, who is far costs nothing."""

import pytest

from agents.sharing.value import Value
from agents.store import Origin
from scenarios.fleet import Fleet, FleetSettings, account

UNTIL_S = 50.0


def ran(robots: int, horizon_m: float | None, region_m: float | None = None) -> Fleet:
    fleet = Fleet(FleetSettings(robots, horizon_m=horizon_m, region_m=region_m))
    fleet.run(UNTIL_S)
    return fleet


@pytest.fixture(scope="module")
def near():
    fleet = ran(9, 6.0)
    yield fleet
    fleet.close()


def apart_m(fleet: Fleet, one: int, other: int) -> float:
    poses = [fleet.pose_now(fleet.roster[number]) for number in (one, other)]
    return poses[0].distance_m(poses[1])


def test_only_who_is_within_radio_range_counts(near: Fleet) -> None:
    for number, member in enumerate(near.members.values()):
        policy = member.robot.sharing
        assert isinstance(policy, Value)
        mates = policy.repair.peers
        assert mates, "everybody has neighbours"
        assert set(mates) >= set(member.robot.mates)
        # Both may have walked since they heard each other.
        assert all(apart_m(near, number, mate) < 9.0 + 2 * 0.1 * UNTIL_S for mate in mates)


@pytest.mark.slow
def test_what_is_measured_far_off_is_not_passed_on() -> None:
    tiles: list[int] = []
    sent_bytes: list[int] = []
    for horizon_m in (1.0, None):
        fleet = ran(25, horizon_m)
        tiles.append(sum(len(m.robot.store.keys()) for m in fleet.members.values()))
        sent_bytes.append(sum(m.radio.traffic.sent_bytes for m in fleet.members.values()))
        fleet.close()
    # What neighbours measured is heard either way; what they heard is passed on without a horizon.
    assert tiles[0] < tiles[1]
    assert sent_bytes[0] < 0.7 * sent_bytes[1], "without a horizon everything goes everywhere"


def test_a_fleet_does_the_same_again_and_accounts_for_it(near: Fleet) -> None:
    again = Fleet(FleetSettings(9, region_m=None))
    found = account(again, UNTIL_S / 2, UNTIL_S)
    again.close()
    for name, member in near.members.items():
        assert member.robot.store.digest() == again.members[name].robot.store.digest()
        assert member.radio.traffic.sent_bytes == again.members[name].radio.traffic.sent_bytes
    sent = sum(m.radio.traffic.sent_bytes for m in near.members.values()) / 9
    assert 0 < found.all_bytes_per_min * UNTIL_S / 2 / 60 < sent
    assert set(found.bytes_per_min) <= {"map", "anchor", "digest", "status", "fix"}
    assert found.tiles == sum(len(m.robot.store.keys()) for m in near.members.values()) / 9


@pytest.mark.slow
def test_a_region_keeps_no_tile_beyond_it() -> None:
    fleet = ran(25, 6.0, 8.0)
    try:
        sizes = {m.robot.settings.frame.shape for m in fleet.members.values()}
        assert max(rows * cols for rows, cols in sizes) < fleet.frame.rows * fleet.frame.cols
        for number, member in enumerate(fleet.members.values()):
            robot = member.robot
            assert all(robot.grid.holds(key.tile) for key in robot.store)
            own = {key.tile for key in robot.store if key.origin == Origin(number, 0)}
            shown = set(robot.grid.touched(robot.team.fused().known))
            assert own <= shown
    finally:
        fleet.close()
