"""One simulated robot: its program, its body, its radio, and the thread by which time is paid out.

The same host runs in a process of its own (`scenarios.process`) or beside others in one process
(`scenarios.runner`): it is handed grants and packets and gives reports, and knows neither Zenoh nor
the conductor.
"""

import asyncio
import traceback
from collections.abc import Coroutine
from typing import Any

import numpy as np

from agents.disk import Disk, DiskError
from agents.files import LocalFiles
from agents.geometry import Pose
from agents.layers import Anchor
from agents.messages import pack_anchor
from agents.ports import Exposure
from agents.robot import Robot
from agents.roles import ROLES
from agents.store import AnchorKey
from comms.air import Packet
from comms.timebase import NS, from_s, sleep_until_ns, to_s
from scenarios.dice import dice
from scenarios.hostradio import HostRadio, Outbox
from scenarios.logs.diary import MAP_NOTES, Diary, PoseNote
from scenarios.logs.handed import BORN, HANDED, pack_born, pack_handed
from scenarios.logs.notebook import LogFile, Notebook
from scenarios.makings import motions_of, points_of, rig_of, told
from scenarios.records.tables import EventRow, LookRow
from scenarios.records.weighing import Scales
from scenarios.scores.ledger import entry
from scenarios.scores.odometer import Odometer, Rms
from scenarios.view.hand import as_told
from scenarios.view.witness import Witness
from scenarios.wire import Grant, Plan, Report
from sim.clock import ScaledLoop, VirtualLoop
from sim.motion import Segment
from sim.troubles import FailingFiles, Troubles, failing


class Host:
    """One robot in its simulated world, on a loop of its own."""

    def __init__(self, plan: Plan, loop: VirtualLoop | ScaledLoop, outbox: Outbox) -> None:
        """Bring a robot to life; it does nothing before its loop runs."""
        self.plan = plan
        self.loop = loop
        self.name = plan.name
        self.scenario = plan.scenario
        self.roster = list(self.scenario.robots)
        self.motions = motions_of(plan)
        self.segments: list[Any] = []
        self.fault = ""
        self.odometer = Odometer()
        self.status: dict[str, Any] = {}
        self._pose_errors = Rms()
        self._tasks: list[asyncio.Task[None]] = []
        self.measured: list[Any] = []
        self._witness = Witness(plan) if plan.keeps_growth else None
        self.troubles = Troubles()
        for index in plan.trouble_events:
            self.obey(("trouble", index))
        if isinstance(loop, VirtualLoop):
            loop.think_ns = self.troubles.think_ns
        files = FailingFiles(LocalFiles(), self.troubles, self.now_ns)
        disk = Disk(plan.folder / "robots" / self.name, files)
        refusal = _begin(disk)
        life = disk.incarnation
        suffix = f"-{life}" if life else ""
        log = LogFile(plan.folder / f"{self.name}{suffix}.mcap") if plan.keeps_log else None
        self.notebook = Notebook(self.name, log, self.now_ns)
        every_s = max(self.scenario.sample_s, self.scenario.limit_s / MAP_NOTES)
        self.diary = Diary(log, plan.terrain.frame, from_s(every_s))
        if log is not None and isinstance(loop, VirtualLoop):
            log.keep(BORN, pack_born(plan), plan.start_ns)
        if refusal:
            self.event("disk", refusal)
        self.rig = rig_of(
            plan,
            life,
            self.motions,
            self._publish,
            lambda shot, seen: self.diary.image(from_s(seen.exposure.t_s), shot.left),
        )
        hardware = failing(self.rig.hardware, self.troubles)
        luck = dice(self.scenario, self.name, "robot", life)
        self.robot = Robot(told(plan), hardware, disk, self, luck)
        self.scales = Scales(plan, self.robot)
        self.own_radio = HostRadio(
            plan,
            life,
            loop=loop,
            outbox=outbox,
            motions=self.motions,
            choose=self.robot.choose_frame,
            on_frame=self.robot.on_frame,
            log=self.notebook,
        )
        self.radio, self.air = self.own_radio.radio, self.own_radio.air
        self.robot.radio = self.radio
        self.robot.rate_bps = self.own_radio.rate_bps

    # --- putting together -----------------------------------------------------------------

    def now_ns(self) -> int:
        """Return the loop's time."""
        return round(self.loop.time() * NS)

    # --- the robot's log --------------------------------------------------------------------

    def look(
        self, exposure: Exposure, *, expected_cells: float, obtained_cells: int, new_cells: int
    ) -> None:
        """Write down one exposure, with the true position that the robot does not know."""
        if self.plan.keeps_ledger:
            self.measured.append(entry(exposure, self.robot))
        t_ns = round(exposure.t_s * NS)
        pose = self.true_pose(t_ns)
        row = LookRow(
            self.name, exposure.t_s, pose.x_m, pose.y_m, pose.z_m, exposure.pan_rad,
            exposure.tilt_rad, expected_cells, obtained_cells, new_cells,
            self.odometer.distance_m(self.now_ns()), self.scales.coverage(),
        )  # fmt: skip
        self.notebook.add(row, t_ns)
        self.diary.seen(t_ns, exposure, points_of(self.scenario, exposure), self.robot.pose)
        self._note_pose(t_ns)

    def _note_pose(self, t_ns: int) -> None:
        filtered, still = self.robot.filter, not self._is_moving(t_ns)
        note = PoseNote(self.true_pose(t_ns), self.robot.pose, filtered.covariance, still)
        self.diary.pose(t_ns, note)

    def event(self, what: str, detail: str = "") -> None:
        """Write down something that happened."""
        t_ns = self.now_ns()
        self.notebook.add(EventRow(to_s(t_ns), self.name, what, detail), t_ns)

    # --- life -------------------------------------------------------------------------------

    def start(self) -> None:
        """Set the robot's program going; it runs when the loop does."""
        role = ROLES[self.scenario.robots[self.name].role]
        for part in (self.radio.run(), self.robot.heartbeat(), self._sample(), role(self.robot)):
            self._tasks.append(self.loop.create_task(self._guarded(part)))

    async def _guarded(self, part: Coroutine[Any, Any, None]) -> None:
        """Run one part of the robot's program; what goes wrong in it is ours to mend."""
        try:
            await part
        except Exception:
            self.fault = self.fault or traceback.format_exc()

    async def _sample(self) -> None:
        """Weigh the map every few seconds of simulated time, at whole multiples."""
        while True:
            self.weigh(self.now_ns())
            every_ns = from_s(self.scenario.sample_s)
            due_ns = (self.now_ns() // every_ns + 1) * every_ns
            await sleep_until_ns(due_ns)

    def true_pose(self, t_ns: int) -> Pose:
        """Return where the robot truly is."""
        pose = self.motions.pose_at(self.name, t_ns)
        assert pose is not None
        return pose

    def _is_moving(self, t_ns: int) -> bool:
        way = self.motions.current(self.name, t_ns)
        return way is not None and way.end_ns > t_ns and way.start != way.end

    def weigh(self, t_ns: int) -> None:
        """Write down what the robot knows now, and how right it is."""
        row, is_new = self.scales.weigh(t_ns)
        if is_new and self._witness is not None:
            self._witness.weigh(t_ns, self.scales.done(), self.scales.heard, self.robot)
        self.notebook.add(row, t_ns)
        if self.robot.located and not self._is_moving(t_ns):  # a drive is measured when it is done
            self._pose_errors.append(self.true_pose(t_ns).distance_m(self.robot.pose))
        self._note_pose(t_ns)
        if self.diary.is_due(t_ns):
            self.diary.map(t_ns, self.scales.charts())
        self.status = {
            "t_s": to_s(t_ns),
            "activity": self.robot.activity,
            "looks": self.robot.looks,
            "own_cells": row.own_cells,
            "team_cells": row.team_cells,
            "digest": self.robot.store.digest(),
            "payload_bytes": self.robot.store.payload_bytes,
            "settled": self._is_settled(),
            "sent_bytes": self.radio.traffic.sent_bytes,
            "received_bytes": self.radio.traffic.received_bytes,
            "airtime_s": to_s(self.radio.traffic.airtime_ns),
            "distance_m": self.odometer.distance_m(self.now_ns()),
            "pose_error_rms_m": self._pose_errors.value,
            "dropped": dict(sorted(self.radio.dropped.items())),
            "hazards": self.rig.hazards_hit(),
        }

    def _is_settled(self) -> bool:
        """Say whether its work is done, and nothing is left unsent that anybody could hear."""
        nobody_hears = self.radio.payload_bytes == 0
        return self.robot.finished if nobody_hears else self.robot.settled

    # --- time -------------------------------------------------------------------------------

    def run_window(self, grant: Grant, packets: list[Packet]) -> Report:
        """Take what is new, run all events before the grant's end, and report (virtual clock)."""
        assert isinstance(self.loop, VirtualLoop)
        if self.notebook.log is not None:
            self.notebook.log.keep(HANDED, pack_handed(grant, packets), self.loop.now_ns)
        self.take(grant, packets)
        self.loop.run_window(grant.end_ns, grant.floor_ns)
        if any(command[0] == "finish" for command in grant.commands):
            return self.finish(grant.end_ns)
        return self.report()

    def take(self, grant: Grant, packets: list[Packet]) -> None:
        """Take in what happened elsewhere."""
        for wire in grant.segments:
            self.motions.add(Segment.from_wire(wire))
        for packet in packets:
            self.own_radio.deliver(packet)
        for command in grant.commands:
            self.obey(command)

    def obey(self, command: Any) -> None:
        """Carry out one thing that happens to the world, now."""
        match command[0]:
            case "link":
                self.own_radio.change_link(command[1])
            case "events":
                self.scenario = as_told(self.scenario, command[1])
                self.own_radio.links.learn(self.scenario)
            case "freeze":
                self.motions.freeze(command[1], command[2])
            case "trouble":
                event = self.scenario.timeline()[command[1]]
                if event.target == self.name:
                    self.troubles.add(event.trouble())
            case _:
                pass

    def report(self) -> Report:
        """Return what happened since the last report."""
        rows, cuts = self.notebook.take()
        segments, self.segments = self.segments, []
        urgent, self.air.urgent = self.air.urgent, []
        measured, self.measured = self.measured, []
        status, self.status = self.status, {}
        next_ns = self.loop.next_event_ns() if isinstance(self.loop, VirtualLoop) else None
        report = Report(
            self.name,
            self.robot.me.incarnation,
            next_ns,
            self.air.sent,
            urgent,
            segments,
            rows,
            cuts,
            measured,
            status=status,
            fault=self.fault,
        )
        if self._witness is not None:
            report.growth, report.plans = self._witness.take(self.now_ns(), self.robot)
        return report

    def finish(self, end_ns: int) -> Report:
        """End the run here: take the mail that has arrived, weigh the map once more, report."""
        if isinstance(self.loop, VirtualLoop):
            self.loop.advance(end_ns)
        self.weigh(end_ns)
        status = self.status
        report = self.report()
        grids = self.scales.grids()
        self.diary.map(end_ns, self.scales.charts(), whole=True)
        speed = self.scenario.clock.speed
        report.final = {
            **status,
            "lags_s": [lag / speed for lag in self.air.lags_s],
            "maps": {name: values.astype(np.float32).tobytes() for name, values in grids.items()},
            "shape": list(next(iter(grids.values())).shape),
            "moved": [pack_anchor(key, anchor) for key, anchor in self._moved_anchors()],
        }
        self.notebook.close()
        return report

    def _moved_anchors(self) -> list[tuple[AnchorKey, Anchor]]:
        """Return what its map lies by that lies elsewhere than it was drawn."""
        robot = self.robot
        anchors = dict(robot.store.anchors)
        for index, submap in enumerate(robot.own.submaps):
            anchors[AnchorKey(*robot.me, index)] = submap.anchor
        return [(key, anchors[key]) for key in sorted(anchors) if anchors[key].is_moved]

    def cancel(self) -> None:
        """Take all of the robot's program off a loop that others go on using."""
        for task in self._tasks:
            task.cancel()

    def abandon(self) -> None:
        """Leave the robot as it is, as a killed process would: its log ends where it stands.

        Whoever abandons a host keeps it until it can be buried: a coroutine that is collected
        runs its `finally` blocks, and a dead robot's program must not run.
        """
        self.notebook.abandon()

    def bury(self) -> None:
        """Unwind what is left of the program, after the run, when nothing that it does counts."""
        tasks = asyncio.all_tasks(self.loop)
        for task in tasks:
            task.cancel()
        if tasks:
            self.loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self.loop.close()

    def _publish(self, segment: Segment) -> None:
        self.odometer.drive(segment)
        self.motions.add(segment)
        self.segments.append(segment.to_wire())


def _begin(disk: Disk) -> str:
    """Begin the next life on a robot's disk; return what the disk says to that, if it refuses."""
    try:
        disk.begin()
    except DiskError as error:
        return str(error)
    return ""
