"""What the Cliff-bot waits for, how much tether it asks for, and when it is looked after."""

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sim_helpers import run

from agents import roles
from agents.briefing import ACTIVITIES, Mate
from agents.geometry import Floats, Pose
from agents.messages import Status
from agents.planning.waydown import CALM_RISK, LAST_RISK, MOST_RISK, Way
from agents.settings import DriveSettings, PlannerSettings, SensorSettings

GOAL = (0.0, -5.0)
STRAIGHT = np.array([[0.0, 0.0], GOAL])


class Cliffbot:
    """A robot as far as its role asks about it; what it was told to do is kept."""

    def __init__(self, **changes: Any) -> None:
        self.map_changed_s = 0.0
        self.pose = Pose(0.0, 0.0, 0.0, 0.0)
        self.mates: dict[int, Mate] = {}
        self.looks = 0
        self.looked_at: list[float] = []
        self.events: list[str] = []
        self.log = self
        self.mapper = self
        self.filter = SimpleNamespace(covariance=np.diag([1e-4, 1e-4, 1e-4, 1e-4]))
        self.settings = SimpleNamespace(
            roles=("recon", "cliffbot"),
            map=SimpleNamespace(cell_m=0.1),
            frame=SimpleNamespace(cell_m=0.1),
            drive=DriveSettings(),
            planner=PlannerSettings(max_looks=5),
            sensor=SensorSettings(),
        )
        self.__dict__.update(changes)

    @property
    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    def event(self, what: str, detail: str = "") -> None:
        self.events.append(what)

    def set_activity(self, activity: str) -> None:
        assert activity in ACTIVITIES

    def bearing_to(self, pose: Pose) -> tuple[float, float, float]:
        return pose.y_m, 0.3, -0.5

    def tell_status(self) -> None:
        self.events.append("status")

    async def way_to_see(self, mate: Pose) -> Floats | None:
        return None if mate.z_m < -1.0 else np.zeros((1, 2))

    async def travel(self, path_m: Floats) -> bool:
        return True

    async def look(self, pan_rad: float, tilt_rad: float) -> None:
        self.looked_at.append(pan_rad)


def waits(monkeypatch: pytest.MonkeyPatch, risk: float, until_s: float) -> tuple[bool, float]:
    """Return whether it goes a way of this risk, and after how long; others map until then."""

    async def find_way(*_: object) -> Way:
        return Way(STRAIGHT, risk)

    def nothing_more(robot: Cliffbot) -> bool:
        return robot.now_s > until_s

    monkeypatch.setattr(roles, "find_way", find_way)
    monkeypatch.setattr(roles, "_nothing_more_to_come", nothing_more)

    async def go() -> tuple[bool, float]:
        robot: Any = Cliffbot()
        found = await roles.wait_for_path(robot, GOAL)
        return found is not None, robot.now_s

    return run(go())


def test_a_calm_way_is_gone_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    assert waits(monkeypatch, CALM_RISK, 1e4) == (True, 0.0)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_the_riskier_a_way_that_will_do_the_longer_a_better_one_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    went, after_s = waits(monkeypatch, CALM_RISK + share * (MOST_RISK - CALM_RISK), 1e4)
    assert went
    assert after_s == pytest.approx(share * roles.BETTER_S, abs=1.01 * roles.PATIENCE_S)


def test_a_way_that_will_not_do_is_gone_only_when_nobody_maps_any_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert waits(monkeypatch, 0.5 * (MOST_RISK + LAST_RISK), 3000.0) == (True, 3005.0)
    assert waits(monkeypatch, LAST_RISK + 0.1, 3000.0) == (False, 3005.0)


def test_it_asks_for_more_tether_where_it_was_taut_and_for_none_after_it_slid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slack_m: list[float] = []
    ends = iter([roles.TAUT, roles.TAUT, "", "", "slid", *[roles.TAUT] * 8, ""])

    async def hold(robot: object, x_m: float, y_m: float, slack: float) -> None:
        slack_m.append(round(slack, 9))

    async def find_way(robot: Cliffbot, goal: object, former_m: Floats) -> Way:
        return Way(former_m, 0.1)

    class Driven(Cliffbot):
        async def drive_to(self, x_m: float, y_m: float, leg_m: float) -> str:
            await asyncio.sleep(5.0)
            end = next(ends)
            if len(slack_m) == 14:
                self.pose = Pose(*GOAL, 0.0, 0.0)
            return end

    monkeypatch.setattr(roles, "_hold_tethers", hold)
    monkeypatch.setattr(roles, "find_way", find_way)
    robot: Any = Driven()
    assert run(roles.go_down(robot, GOAL, STRAIGHT)) is not None
    least, most, eased = roles.SLACK_M, roles.MOST_SLACK_M, roles.SLACK_M * roles.EASED
    begun = [least, 2 * least, 3 * least, 3 * least - eased, 3 * least - 2 * eased]
    after = [min(least * (1 + k), most) for k in range(9)]
    assert slack_m == pytest.approx([*begun, *after])


@pytest.mark.parametrize(
    ("activity", "sigma_m", "away_m", "looks", "looked"),
    [
        ("descending", 0.2, 5.0, 0, True),
        ("descending", 0.01, 5.0, 0, False),
        ("waiting", 0.2, 5.0, 0, False),
        ("descending", 0.2, 50.0, 0, False),
        ("descending", 0.2, 5.0, 5, False),
    ],
)
def test_who_goes_down_and_is_unsure_of_its_place_is_looked_at(
    activity: str, sigma_m: float, away_m: float, looks: int, looked: bool
) -> None:
    variance = (sigma_m**2, 1e-4, 1e-4, 1e-4)
    pose = Pose(0.0, away_m, 0.0, 0.0)
    status = Status(pose, variance, ACTIVITIES.index(activity), None, 0.0, 0, True)

    async def go() -> list[float]:
        robot: Any = Cliffbot(mates={1: Mate(status, 0.0)}, looks=looks)
        await roles.look_after(robot)
        return robot.looked_at

    assert run(go()) == ([0.3] if looked else [])


def test_nobody_looks_where_nothing_can_be_seen() -> None:
    hidden = Pose(0.0, 5.0, -2.0, 0.0)
    status = Status(hidden, (0.04,) * 4, ACTIVITIES.index("descending"), None, 0.0, 0, True)

    async def go() -> list[float]:
        robot: Any = Cliffbot(mates={1: Mate(status, 0.0)})
        await roles.look_after(robot)
        return robot.looked_at

    assert run(go()) == []


@pytest.mark.parametrize(
    ("sigma_m", "seen_after_s", "watched", "waited_s", "may_m"),
    [
        (0.02, 1e9, True, 0.0, roles.UNSURE_M),
        (0.1, 30.0, True, 30.0, roles.UNSURE_M),
        (0.1, 1e9, True, roles.SEEN_S, 0.1 * roles.MORE_UNSURE),
        (0.1, 1e9, False, 0.0, 0.1 * roles.MORE_UNSURE),
    ],
)
def test_who_is_unsure_of_its_place_stands_until_it_was_seen(
    sigma_m: float, seen_after_s: float, watched: bool, waited_s: float, may_m: float
) -> None:
    status = Status(Pose(0.0, 0.0, 0.0, 0.0), (1e-4,) * 4, 1, None, 0.0, 0, True)

    async def go() -> tuple[float, float]:
        robot: Any = Cliffbot(mates={0: Mate(status, 1e6)} if watched else {})
        robot.filter.covariance *= (sigma_m / 0.01) ** 2
        sure = 1e-4 * np.eye(4)
        loop = asyncio.get_running_loop()
        loop.call_later(seen_after_s, lambda: setattr(robot.filter, "covariance", sure))
        return await roles.be_seen(robot, roles.UNSURE_M), robot.now_s

    may, waited = run(go())
    assert may == pytest.approx(may_m)
    assert waited == pytest.approx(waited_s, abs=1.5)
