"""What each robot of the team does with its life, told in the verbs of `agents.robot`."""

import asyncio
import math
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

import numpy as np

from agents.briefing import ACTIVITIES
from agents.geometry import Floats, Pose, wrap_angle
from agents.mapper import NextLook
from agents.maps.elevation import relief_sigma_m
from agents.member import SILENT_S
from agents.messages import TetherCommand, pack_tethers
from agents.planning.waydown import (
    CALM_RISK,
    LAST_RISK,
    MOST_RISK,
    Descent,
    Way,
    hopeful,
    least_risky,
)
from agents.robot import Robot
from comms.frames import Kind

STEP_M = 0.25
"""The Cliff-bot descends in steps of this: the tethers never hang slack by more."""
SLACK_M, MOST_SLACK_M = 0.05, 0.25
"""So much more tether than a step needs is asked for, and as much again each time that it was taut
all the same: so far off are the places of robot and anchors, as they are told. On much more it
would slide."""
EASED = 0.25
"""A step that went well needs so much less of that the next time."""
TAUT = "tether taut"
"""What a body says that its tethers held back."""
COMMAND_S = 2.0
"""Tether commands are repeated this often while they hold."""
PATIENCE_S = 5.0
"""How often a robot that waits looks again."""
ASK_AGAIN_S = 120.0
"""A robot for which nothing is left to gain asks again so often, if its map has changed."""
UNSURE_M = 0.035
"""A Cliff-bot that knows its place no better than this stands still until somebody has seen it, and
is looked at, to tell it:"""
SEEN_S, MORE_UNSURE = 240.0, 1.5
"""so long; then it goes on, until it is less sure by this factor."""
SEARCH_S = 60.0
"""A lost robot that saw nothing known looks round again after so long."""
SEARCH_ROUNDS = 20
"""It looks round so often; then it waits to be seen."""
BETTER_S = 1800.0
"""For so long it waits for a better way than one that will do, the less so the longer."""
QUIET_S = 120.0
"""A map that has not changed for so long will not change any more, once nobody explores."""
TRIES = 20
"""Steps that may fail one after another before the Cliff-bot gives up and stays."""


async def explore(robot: Robot) -> None:
    """Map: look, localise, fuse, share, plan, move (Fig. 2), until no look is worth taking."""
    if robot.hardware.guide is not None:
        return await follow(robot)
    await search(robot)
    robot.set_activity("exploring")
    for pan_rad, tilt_rad in robot.mapper.first_looks:
        await robot.look(wrap_angle(pan_rad), tilt_rad)
    most = robot.settings.planner.max_looks
    while robot.looks < most and (plan := await next_look(robot)) is not None:
        await take_look(robot, plan)
        await look_after(robot)
    if robot.looks < most:
        robot.log.event("explored", f"after {robot.looks} looks no other look is worth its way")
    else:
        robot.log.event("looks spent", f"it may take no more than {most}")
    await watch(robot)


async def take_look(robot: Robot, plan: NextLook) -> None:
    """Go where a look is to be taken from, and take it; or from where the way ended."""
    arrived = await robot.travel(plan.path_m)
    if robot.located and robot.is_lost:
        await take_bearing(robot)
    ahead_rad = None if arrived else robot.mapper.halted()
    pan_rad = wrap_angle(plan.heading_rad - robot.pose.yaw_rad)
    await robot.look(pan_rad if ahead_rad is None else ahead_rad, plan.tilt_rad)


async def follow(robot: Robot) -> None:
    """Map what comes by on a way that somebody else chose, until nothing more comes."""
    robot.set_activity("exploring")
    while await robot.be_led():
        pass
    robot.log.event("explored", f"its guide had nothing more to show after {robot.looks} looks")
    robot.set_activity("done")
    robot.finished = True


async def search(robot: Robot) -> None:
    """Look round until a landmark, a team-mate or its own map tells a lost robot where it is.

    What it sees from where it stands may be on nobody's map: so it maps on, in a frame of its own.
    When that shows it nothing more it waits, for a team-mate that sees it may tell it too, or the
    team's map may come to where it is.
    """
    if robot.located:
        return
    robot.set_activity("searching")
    robot.log.event("lost", "it does not know where it starts; nobody takes in its map")
    rounds, most = 0, robot.settings.planner.max_looks
    while not robot.located:
        for pan_rad, tilt_rad in robot.mapper.all_round:
            if rounds < SEARCH_ROUNDS and not robot.located:
                await robot.look(wrap_angle(pan_rad), tilt_rad)
        rounds += 1
        while not robot.located and robot.looks < most:
            plan = await robot.choose_look()
            if plan is None:
                break
            await take_look(robot, plan)
        if not robot.located:
            await asyncio.sleep(SEARCH_S)
            await robot.join()


async def next_look(robot: Robot) -> NextLook | None:
    """Return the next look, or None when nothing more can be gained.

    What a team-mate said that it will look at is not worth a look. So as long as others explore,
    it asks again: they show it new ways, or fall silent, and what they claimed is free again.
    """
    while (plan := await robot.choose_look()) is None and others_exploring(robot):
        robot.set_activity("waiting")
        asked_s, before = robot.now_s, others_exploring(robot)
        while others_exploring(robot) == before:
            if robot.now_s - asked_s > ASK_AGAIN_S and robot.map_changed_s > asked_s:
                break
            await asyncio.sleep(PATIENCE_S)
    if plan is not None:
        robot.set_activity("exploring")
    return plan


def others_exploring(robot: Robot) -> list[int]:
    """Return the team-mates that map at present, as far as can be heard."""
    return [
        index
        for index, mate in sorted(robot.mates.items())
        if robot.settings.roles[index] in ("recon", "explorer")
        and robot.now_s - mate.heard_s < SILENT_S
        and ACTIVITIES[mate.status.activity] in ("starting", "exploring")
    ]


async def take_bearing(robot: Robot) -> None:
    """Look at the nearest team-mate that stands still, to know again where this robot is."""
    for pan_rad, tilt_rad in robot.bearings():
        await robot.look(pan_rad, tilt_rad)
        if not robot.is_lost:
            break


async def look_after(robot: Robot) -> None:
    """Go and look at the Cliff-bot where it goes down and is not sure of its place any more."""
    cliffbot = _mate_with_role(robot, "cliffbot")
    if cliffbot is None or robot.looks >= robot.settings.planner.max_looks:
        return
    status = robot.mates[cliffbot].status
    distance_m, _, _ = robot.bearing_to(status.pose)
    unsure = _sigma_m(status.variance) > UNSURE_M
    going_down = ACTIVITIES[status.activity] == "descending"
    if not (going_down and unsure and distance_m < robot.settings.sensor.range_m):
        return
    way_m = await robot.mapper.way_to_see(status.pose)
    if way_m is not None and await robot.travel(way_m):
        _, pan_rad, tilt_rad = robot.bearing_to(robot.mates[cliffbot].status.pose)
        await robot.look(pan_rad, tilt_rad)


async def watch(robot: Robot) -> None:
    """Keep an eye on the Cliff-bot while it goes down, and tell it where it is (section 2.1).

    Where it hangs and waits for a way on, map again, as long as that may show one.
    """
    robot.set_activity("watching")
    most = robot.settings.planner.max_looks
    asked_s = robot.now_s
    while (cliffbot := _mate_with_role(robot, "cliffbot")) is not None:
        mate = robot.mates[cliffbot].status
        doing = ACTIVITIES[mate.activity]
        if doing == "done":
            break
        if doing == "descending":
            await look_after(robot)
        elif doing == "waiting" and robot.map_changed_s > asked_s:
            asked_s = robot.now_s
            while robot.looks < most and (plan := await next_look(robot)) is not None:
                await take_look(robot, plan)
            robot.set_activity("watching")
        await asyncio.sleep(PATIENCE_S)
    robot.set_activity("done")
    robot.finished = True


async def descend(robot: Robot) -> None:
    """Wait for a way down that is known and safe all along, and go down it on two tethers."""
    robot.set_activity("waiting")
    assert robot.settings.goal_m is not None
    goal = robot.settings.goal_m
    robot.wish_to_know(goal)
    path_m = await wait_for_path(robot, goal)
    if path_m is not None:
        robot.log.event("safe path", f"{_length_m(path_m):.1f} m")
        robot.set_activity("descending")
        path_m = await go_down(robot, goal, path_m)
    if path_m is not None:
        robot.log.event("reached")
    else:
        robot.log.event("stuck", f"nobody maps any more; {why_not(robot, goal)}")
    robot.claim = None
    robot.set_activity("done")
    robot.finished = True


async def wait_for_path(robot: Robot, goal: tuple[float, float]) -> Floats | None:
    """Return the first safe way to the goal that the map shows, or None if none will come.

    The longer a way is known that will do, the less it waits for a better one.
    """
    planned_s, known_s = -math.inf, math.inf
    way: Way | None = None
    while True:
        is_last = _nothing_more_to_come(robot)
        if is_last or planned_s < robot.map_changed_s:
            planned_s = robot.now_s
            way = await find_way(robot, goal)
            if way is not None and way.risk <= MOST_RISK:
                known_s = min(known_s, planned_s)
        if way is not None and way.risk <= (LAST_RISK if is_last else _may_risk(robot, known_s)):
            return way.path_m
        if is_last:
            return None
        await asyncio.sleep(PATIENCE_S)


def _may_risk(robot: Robot, known_s: float) -> float:
    """Return how risky a way may be that is taken, where one that will do is known since then."""
    waited = min(max(robot.now_s - known_s, 0.0) / BETTER_S, 1.0)
    return CALM_RISK + waited * (MOST_RISK - CALM_RISK)


async def go_down(robot: Robot, goal: tuple[float, float], path_m: Floats) -> Floats | None:
    """Go down step by step, each by the newest map; return None if the goal can't be reached.

    Where the newest map bars the way, it hangs on its tethers until the map shows another.
    """
    failures, held, unsure_m = 0, 0.0, UNSURE_M
    while math.dist((robot.pose.x_m, robot.pose.y_m), path_m[-1]) > robot.settings.map.cell_m:
        x_m, y_m = _step_along(path_m, robot.pose, 0.5 * robot.settings.frame.cell_m)
        slack_m = min(SLACK_M * (1 + held), MOST_SLACK_M)
        holder = asyncio.create_task(_hold_tethers(robot, x_m, y_m, slack_m))
        try:
            halted = await robot.drive_to(x_m, y_m, STEP_M)
        finally:
            holder.cancel()
        failures = failures + 1 if halted else 0
        held = held + 1.0 if halted == TAUT else 0.0 if halted else max(held - EASED, 0.0)
        if failures > TRIES:
            return None
        onward = await find_way(robot, goal, path_m)
        if onward is None or onward.risk > LAST_RISK:
            robot.log.event("barred", "the newest map shows no safe way on from here")
            robot.set_activity("waiting")
            other_m = await wait_for_path(robot, goal)
            if other_m is None:
                return None
            path_m = other_m
        else:
            path_m = onward.path_m
        robot.set_activity("descending")
        unsure_m = await be_seen(robot, unsure_m)
    return path_m


async def be_seen(robot: Robot, unsure_m: float) -> float:
    """Stand still where its place is less sure than so, until somebody has told it.

    Return how unsure it may be until the next time: nobody sees it everywhere.
    """
    if _sigma_m(np.diag(robot.filter.covariance)) <= unsure_m:
        return unsure_m
    robot.tell_status()
    until_s = robot.now_s + SEEN_S
    while (sigma_m := _sigma_m(np.diag(robot.filter.covariance))) > UNSURE_M:
        if robot.now_s > until_s or not _watched(robot):
            break
        await asyncio.sleep(1.0)
    return UNSURE_M if sigma_m <= UNSURE_M else MORE_UNSURE * sigma_m


def _sigma_m(variance: Sequence[float] | Floats) -> float:
    """Return how unsure a place is, by its variances along the axes (x, y, ...)."""
    return math.sqrt(max(float(variance[0]), float(variance[1])))


async def hold(robot: Robot) -> None:
    """Pay out tether on command, and brake when commands stop (the Anchor-bot's whole life)."""
    robot.set_activity("holding")
    robot.finished = True
    winch = robot.hardware.winch
    assert winch is not None
    while True:
        if not robot.inbox.tethers:
            robot.inbox.arrived.clear()
            try:
                async with asyncio.timeout(robot.settings.tether.command_timeout_s):
                    await robot.inbox.arrived.wait()
            except TimeoutError:
                winch.brake()
                await robot.inbox.arrived.wait()
        if robot.inbox.tethers:
            command = robot.inbox.tethers[-1]
            robot.inbox.tethers.clear()
            target_m = min(command.target_m, robot.settings.tether.max_length_m)
            winch.pay_out(target_m, min(command.rate_mps, robot.settings.tether.rate_mps))
        else:
            winch.brake()  # a stop
            await asyncio.sleep(0)


ROLES: dict[str, Callable[[Robot], Coroutine[Any, Any, None]]] = {
    "recon": explore,
    "explorer": explore,
    "cliffbot": descend,
    "anchor": hold,
}


async def find_way(
    robot: Robot, goal: tuple[float, float], former_m: Floats | None = None
) -> Way | None:
    """Return the way to the goal that is best by the newest map, or None where there is none.

    `former_m` (N, 2) is the way that it is on.
    """
    settings, ground = robot.settings, _ground(robot)
    place = (settings.frame, settings.drive, *ground, robot.pose, goal)
    return await asyncio.to_thread(least_risky, *place, former_m=former_m)


def why_not(robot: Robot, goal: tuple[float, float]) -> str:
    """Say what keeps the most hopeful way to the goal from being safe."""
    settings = robot.settings
    down = Descent(robot.pose, goal, np.zeros(settings.frame.shape))
    hope = hopeful(settings.frame, settings.drive, *_ground(robot), down)
    why = "" if hope is None else f": {hope.told()}"
    return f"no safe way down is known{why}"


def _ground(robot: Robot) -> tuple[Floats, Floats]:
    """Return elevation of the team map, and sigma against the ground next to each cell."""
    return robot.team.fused().elevation_m, relief_sigma_m(robot.team)


def _step_along(path_m: Floats, pose: Pose, near_m: float) -> tuple[float, float]:
    """Return the point one step along a path from its start.

    A path starts at the middle of a cell: where that point is where the robot stands (a drive to
    it would be none, and the same step be chosen again for ever), it is a step or more farther on.
    """
    way_m = np.cumsum(np.concatenate([[0.0], np.hypot(*np.diff(path_m, axis=0).T)]))
    along_m = 0.0
    while True:
        along_m += STEP_M
        x_m = float(np.interp(along_m, way_m, path_m[:, 0]))
        y_m = float(np.interp(along_m, way_m, path_m[:, 1]))
        far = math.dist((x_m, y_m), (pose.x_m, pose.y_m)) >= near_m
        if far or along_m >= way_m[-1]:
            return x_m, y_m


async def _hold_tethers(robot: Robot, x_m: float, y_m: float, slack_m: float) -> None:
    """Ask both Anchor-bots for the tether that a point needs, until cancelled."""
    row, col = robot.settings.frame.cell_of(x_m, y_m)
    ground_m = robot.team.fused().elevation_m[row, col]
    z_m = float(ground_m) if math.isfinite(ground_m) else robot.pose.z_m
    rate = robot.settings.tether.rate_mps
    while True:
        commands: list[TetherCommand] = []
        for index, mate in sorted(robot.mates.items()):
            if robot.settings.roles[index] == "anchor":
                at = mate.status.pose
                length_m = math.dist((at.x_m, at.y_m, at.z_m), (x_m, y_m, z_m)) + slack_m
                commands.append(TetherCommand(index, length_m, rate))
        if commands and robot.radio is not None and robot.may_speak:
            robot.radio.send_urgent(Kind.TETHER, pack_tethers(commands), "tethers")
        await asyncio.sleep(COMMAND_S)


def _watched(robot: Robot) -> bool:
    """Say whether anybody with eyes is heard."""
    return any(
        robot.settings.roles[index] in ("recon", "explorer")
        and robot.now_s - mate.heard_s < SILENT_S
        for index, mate in robot.mates.items()
    )


def _mate_with_role(robot: Robot, role: str) -> int | None:
    """Return a team-mate of a role that was heard not long ago, or None."""
    for index, mate in sorted(robot.mates.items()):
        fresh = robot.now_s - mate.heard_s < SILENT_S
        if robot.settings.roles[index] == role and fresh:
            return index
    return None


def _nothing_more_to_come(robot: Robot) -> bool:
    """Say whether nobody maps any more, as far as can be heard, and the map stands still."""
    if robot.now_s - robot.map_changed_s < QUIET_S or robot.now_s < SILENT_S:
        return False
    return not others_exploring(robot)


def _length_m(path_m: Floats) -> float:
    return float(np.sum(np.hypot(*np.diff(path_m, axis=0).T)))
