"""One simulated robot: its program, its body, its radio, and the thread by which time is paid out.

The same host runs in a process of its own (`scenarios.process`) or beside others in one process
(`scenarios.runner`): it is handed grants and packets and gives reports, and knows neither Zenoh nor
the conductor.
"""

import asyncio
import math
import traceback
from collections.abc import Coroutine
from typing import Any

import numpy as np

from agents.briefing import AgentSettings
from agents.disk import Disk, DiskError
from agents.files import LocalFiles
from agents.geometry import Floats, GridFrame, Pose
from agents.landmarks import Landmark
from agents.layers import Anchor
from agents.messages import pack_anchor
from agents.planar.rays import fan_rad
from agents.ports import Exposure
from agents.robot import Robot
from agents.roles import ROLES
from agents.store import AnchorKey
from agents.voxel.rays import ray_directions
from comms.air import Packet
from comms.timebase import NS, from_s, sleep_until_ns, to_s
from scenarios.diary import MAP_NOTES, Diary, PoseNote
from scenarios.dice import dice
from scenarios.handed import BORN, HANDED, pack_born, pack_handed
from scenarios.hostradio import HostRadio, Outbox, lookahead_ns
from scenarios.ledger import entry
from scenarios.notebook import LogFile, Notebook
from scenarios.record import EventRow, LookRow, MapRow
from scenarios.recordings import drive_of, recorded
from scenarios.schema import Scenario
from scenarios.scorers import scorer_of
from scenarios.view.hand import as_told
from scenarios.view.witness import Witness
from scenarios.wire import Grant, Plan, Report
from sim.clock import ScaledLoop, VirtualLoop
from sim.motion import Motions, Segment
from sim.rig import Rig, make_rig
from sim.troubles import FailingFiles, Troubles, failing

START_SIGMA_M = 0.02
START_SIGMA_RAD = 0.004
"""What the team's first localisation leaves unsure of everybody but the origin."""


class Host:
    """One robot in its simulated world, on a loop of its own."""

    def __init__(self, plan: Plan, loop: VirtualLoop | ScaledLoop, outbox: Outbox) -> None:
        """Bring a robot to life; it does nothing before its loop runs."""
        self.plan = plan
        self.loop = loop
        self.name = plan.name
        self.scenario = plan.scenario
        self.roster = list(self.scenario.robots)
        self.motions = self._motions()
        self.segments: list[Any] = []
        self.fault = ""
        self._driven_m = 0.0
        self._way: Segment | None = None
        self.status: dict[str, Any] = {}
        self._pose_errors = Rms()
        self._map_score: tuple[float, float | None, int, float, float] = (0.0, None, 0, 0.0, 0.0)
        self._scored: object = None
        self._scorer = scorer_of(plan.terrain)
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
        self.rig = self._rig(disk)
        hardware = failing(self.rig.hardware, self.troubles)
        self.robot = Robot(self._agent_settings(), hardware, disk, self, self._dice("robot", disk))
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

    def _dice(self, purpose: str, disk: Disk) -> np.random.Generator:
        return dice(self.scenario, self.name, purpose, disk.incarnation)

    def _motions(self) -> Motions:
        motions = Motions()
        for name, pose in self.plan.starts.items():
            motions.add(Segment(name, 0, 0, pose, pose))
        for wire in self.plan.segments:
            motions.add(Segment.from_wire(wire))
        return motions

    def _rig(self, disk: Disk) -> Rig:
        scenario = self.scenario
        return make_rig(
            self.name,
            {name: robot.role for name, robot in scenario.robots.items()},
            terrain=self.plan.terrain,
            landmarks=self.plan.landmarks,
            meshes={n: m.mesh for n, m in scenario.world.landmarks.items() if m.mesh},
            motions=self.motions,
            publish=self._publish,
            delay_ns=lookahead_ns(scenario),
            start=self.plan.pose or self.plan.starts[self.name],
            start_ns=self.plan.start_ns,
            tether_m=self.plan.tether_m,
            sensor=scenario.sensor,
            drive=scenario.drive,
            tether=scenario.tether,
            body_rng=dice(scenario, self.name, "body", disk.incarnation),
            camera_rng=dice(scenario, self.name, "camera", disk.incarnation),
            light=scenario.world.light,
            ground_salt=scenario.seed,
            led=recorded(scenario, self.name, self.plan.starts[self.name]),
            kept=lambda shot, seen: self.diary.image(from_s(seen.exposure.t_s), shot.left),
        )

    def _agent_settings(self) -> AgentSettings:
        scenario = self.scenario
        roles = tuple(robot.role for robot in scenario.robots.values())
        start, covariance = believed_start(
            scenario, self.plan.starts, self.name, self.plan.terrain.frame
        )
        return AgentSettings(
            name=self.name,
            index=self.roster.index(self.name),
            roster=tuple(self.roster),
            roles=roles,
            frame=self.plan.terrain.frame,
            start=start,
            start_covariance=covariance,
            goal_m=self.plan.goal_m,
            method=scenario.method,
            map=scenario.map.model_copy(update={"cell_m": self.plan.terrain.frame.cell_m}),
            sensor=scenario.sensor,
            drive=drive_of(scenario, self.name),
            planner=scenario.planner,
            sharing=scenario.sharing,
            tether=scenario.tether,
            landmarks=tuple(Landmark(n, pose) for n, pose in sorted(self.plan.landmarks.items())),
            start_known=scenario.robots[self.name].start_known,
        )

    # --- the way driven -----------------------------------------------------------------------

    @property
    def distance_m(self) -> float:
        """Return the length of the way that the robot truly went so far, over the ground."""
        return self._driven_m + self._part_of_way_m(self.now_ns())

    def _part_of_way_m(self, t_ns: int) -> float:
        if self._way is None:
            return 0.0
        share = self._way.share_at(t_ns) if t_ns > self._way.start_ns else 0.0
        return share * _length_m(self._way.start, self._way.end)

    def _close_way(self, t_ns: int) -> None:
        self._driven_m += self._part_of_way_m(t_ns)
        self._way = None

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
            exposure.tilt_rad, expected_cells, obtained_cells, new_cells, self.distance_m,
            self._coverage(),
        )  # fmt: skip
        self.notebook.add(row, t_ns)
        self.diary.seen(t_ns, exposure, self._points_m(exposure), self.robot.pose)
        self._note_pose(t_ns)

    def _points_m(self, exposure: Exposure) -> Floats:
        """Return the points (N, 3) of a look, of ranges too, in the levelled robot frame."""
        if not exposure.ranges_m.size:
            return exposure.points_m
        ranges_m, sensor = exposure.ranges_m, self.scenario.sensor
        if self.scenario.map.kind == "voxel":
            rays = ray_directions(sensor, exposure.pan_rad, exposure.tilt_rad)
            points_m = ranges_m.reshape(-1, 1) * rays + (0.0, 0.0, sensor.height_m)
            return points_m[np.isfinite(ranges_m.ravel())]
        angles = exposure.pan_rad + fan_rad(sensor)
        flat = (ranges_m * np.cos(angles), ranges_m * np.sin(angles), np.zeros_like(ranges_m))
        return np.column_stack(flat)[np.isfinite(ranges_m)]

    def _note_pose(self, t_ns: int) -> None:
        filtered, still = self.robot.filter, not self._is_moving(t_ns)
        note = PoseNote(self.true_pose(t_ns), self.robot.pose, filtered.covariance, still)
        self.diary.pose(t_ns, note)

    def _coverage(self) -> float:
        """Return the share of the observable cells that its team map has."""
        observable = self.plan.observable
        done = self._scorer.done(self.robot.team.fused())
        every = int(np.count_nonzero(observable))
        return int(np.count_nonzero(done & observable)) / every if every else 0.0

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
        team = self.robot.team
        heard = team.as_heard()
        if heard is not self._scored:
            self._scored = heard
            bits, error_m = team.kind.bits(heard), self._scorer.error_m(heard)
            self._map_score = (bits, error_m, int(heard.known.sum()), *self._layers())
            if self._witness is not None:
                self._witness.weigh(t_ns, self._scorer.done(heard), heard, self.robot)
        bits, error_m, cells, own_bits, heard_bits = self._map_score
        own, known = self.robot.own.known_cells(), team.known_entries()
        row = MapRow(to_s(t_ns), self.name, own, known, bits, error_m, cells, own_bits, heard_bits)
        self.notebook.add(row, t_ns)
        if self.robot.located and not self._is_moving(t_ns):  # a drive is measured when it is done
            self._pose_errors.append(self.true_pose(t_ns).distance_m(self.robot.pose))
        self._note_pose(t_ns)
        if self.diary.is_due(t_ns):
            self.diary.map(t_ns, self._scorer.charts(heard))
        self.status = {
            "t_s": to_s(t_ns),
            "activity": self.robot.activity,
            "looks": self.robot.looks,
            "own_cells": own,
            "team_cells": known,
            "digest": self.robot.store.digest(),
            "payload_bytes": self.robot.store.payload_bytes,
            "settled": self._is_settled(),
            "sent_bytes": self.radio.traffic.sent_bytes,
            "received_bytes": self.radio.traffic.received_bytes,
            "airtime_s": to_s(self.radio.traffic.airtime_ns),
            "distance_m": self.distance_m,
            "pose_error_rms_m": self._pose_errors.value,
            "dropped": dict(sorted(self.radio.dropped.items())),
            "hazards": self.rig.hazards_hit(),
        }

    def _layers(self) -> tuple[float, float]:
        """Return the information of the own layer, and what is here of all others'."""
        bits = self.robot.team.layer_bits()
        me = self.robot.me.robot
        own = sum(value for origin, value in bits.items() if origin.robot == me)
        return own, sum(bits.values()) - own

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
        heard = self.robot.team.as_heard()
        grids = self._scorer.grids(heard)
        self.diary.map(end_ns, self._scorer.charts(heard), whole=True)
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
        self._close_way(segment.start_ns)
        self._way = segment
        self.motions.add(segment)
        self.segments.append(segment.to_wire())


def _begin(disk: Disk) -> str:
    """Begin the next life on a robot's disk; return what the disk says to that, if it refuses."""
    try:
        disk.begin()
    except DiskError as error:
        return str(error)
    return ""


def believed_start(
    scenario: Scenario, starts: dict[str, Pose], name: str, frame: GridFrame
) -> tuple[Pose, Floats]:
    """Return what a robot believes of its start: the first mapping robot is the team's origin.

    The others were localised against it (section 2.1): a little unsure, and a little wrong. Who
    does not know its start takes the middle of the grid for its own frame's.
    """
    if not scenario.robots[name].start_known:
        west, east, south, north = frame.extent_m
        middle = Pose((west + east) / 2, (south + north) / 2, 0.0, 0.0)
        return middle, np.diag([1e-6, 1e-6, 1e-6, 1e-8])
    origin = next((n for n, r in scenario.robots.items() if r.role == "recon"), next(iter(starts)))
    true = starts[name]
    if name == origin:
        return true, np.diag([1e-6, 1e-6, 1e-6, 1e-8])
    error = dice(scenario, name, "start").normal(size=4)
    sigma = (START_SIGMA_M, START_SIGMA_M, START_SIGMA_M, START_SIGMA_RAD)
    x, y, z, yaw = (float(e) * s for e, s in zip(error, sigma, strict=True))
    believed = Pose(true.x_m + x, true.y_m + y, true.z_m + z, true.yaw_rad + yaw)
    return believed, np.diag([s * s for s in sigma])


def _length_m(start: Pose, end: Pose) -> float:
    return math.hypot(end.x_m - start.x_m, end.y_m - start.y_m, end.z_m - start.z_m)


class Rms:
    """A root mean square that keeps no values."""

    def __init__(self) -> None:
        """Begin with none."""
        self._sum, self._count = 0.0, 0

    def append(self, value: float) -> None:
        """Take one more."""
        self._sum += value * value
        self._count += 1

    @property
    def value(self) -> float | None:
        """The root mean square so far; None of nothing."""
        return math.sqrt(self._sum / self._count) if self._count else None
