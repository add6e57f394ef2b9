"""One robot: its map, its pose, its radio, and the few verbs of which its roles are made.

A role (`agents.roles`) is a coroutine over these verbs and reads like the paper's Figure 2: look,
localise, fuse, share, plan, move. The robot reaches its body through `agents.ports`, its
team-mates through its radio, and time through asyncio; there is nothing else.
"""

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from agents.disk import Disk, DiskError, Recovered
from agents.errors import AgentError
from agents.fusion import PoseFilter, compose
from agents.geometry import Bools, Floats, GridFrame, Pose, Singles, wrap_angle
from agents.information import Interest
from agents.layers import OwnLayer, bin_look
from agents.messages import (
    Fix,
    Status,
    TetherCommand,
    pack_fix,
    pack_status,
    unpack_anchor,
    unpack_chunks,
    unpack_digest,
    unpack_fix,
    unpack_status,
    unpack_tethers,
)
from agents.ports import Exposure, Hardware, Sighting
from agents.scene import WISHED
from agents.settings import (
    DriveSettings,
    MapSettings,
    PlannerSettings,
    SensorSettings,
    SharingSettings,
    TetherSettings,
)
from agents.sharing import Sharing
from agents.store import AnchorKey, Origin, Store, TileKey
from agents.strategies import LookPlan, View, expected_visibility, strategy
from agents.teammap import TeamMap, TileGrid
from comms.errors import CommsError
from comms.frames import Frame, Kind
from comms.radio import Outgoing

ACTIVITIES = ("starting", "exploring", "waiting", "descending", "holding", "watching", "done")
"""What a robot may be doing, as its status says by number."""
GATE = 25.0
"""Innovations beyond this (chi-squared, 4 degrees of freedom: 5e-5) are not believed."""
KEEP_ALIVE_S = 60.0
"""A robot of which nothing changes says so this often."""
TRAIL_POINTS = 64
"""So many corners of the way that it came a robot remembers."""
LEG_M = 1.0
"""A drive is cut in legs of at most this, each measured by itself."""


@dataclass(frozen=True)
class AgentSettings:
    """All that a robot is told before it starts."""

    name: str
    index: int
    roster: tuple[str, ...]
    roles: tuple[str, ...]
    frame: GridFrame
    """The team's grid."""
    start: Pose
    """Where it believes to stand in the team frame, by the team's first localisation."""
    start_covariance: Floats
    """(4, 4) of (x, y, z, yaw)."""
    goal_m: tuple[float, float] | None
    """Where the Cliff-bot is to go."""
    method: str
    map: MapSettings
    sensor: SensorSettings
    drive: DriveSettings
    planner: PlannerSettings
    sharing: SharingSettings
    tether: TetherSettings


class RobotLog(Protocol):
    """What a robot writes down for people; it never reads it."""

    def look(
        self, exposure: Exposure, *, expected_cells: float, obtained_cells: int, new_cells: int
    ) -> None:
        """Note one exposure."""
        ...

    def event(self, what: str, detail: str = "") -> None:
        """Note something that happened, in words."""
        ...


class RadioPort(Protocol):
    """What a robot asks of its radio."""

    def kick(self) -> None:
        """Say that there may be something to send."""
        ...

    def send_urgent(
        self, kind: Kind, payload: bytes, key: str, until_ns: int | None = None
    ) -> None:
        """Send before all else."""
        ...


@dataclass
class Mate:
    """What was heard of a team-mate."""

    status: Status
    heard_s: float


@dataclass
class Inbox:
    """Commands for this robot that its role has not taken yet."""

    tethers: list[TetherCommand] = field(default_factory=list[TetherCommand])
    arrived: asyncio.Event = field(default_factory=asyncio.Event)


class Robot:
    """One robot in one incarnation."""

    def __init__(
        self,
        settings: AgentSettings,
        hardware: Hardware,
        disk: Disk,
        log: RobotLog,
        rng: np.random.Generator,
    ) -> None:
        """Put a robot together; on a disk that holds a former life (`Disk.begin`), take it up."""
        self.settings = settings
        self.hardware = hardware
        self.disk = disk
        self.log = log
        self.rng = rng
        self.me = Origin(settings.index, disk.incarnation)
        self.grid = TileGrid(settings.frame, settings.map.tile_cells)
        self.own = OwnLayer(settings.frame)
        self.store = Store()
        self.team = TeamMap(self.grid, self.store, self.own, self.me, settings.map.max_error_m)
        self.sharing = Sharing(
            settings.sharing, settings.map, self.me, len(settings.roster), self.team, disk.journal
        )
        self.strategy = strategy(settings.method)
        self.sharing.weight = self.tile_weight
        self.interest = Interest(settings.frame.shape, settings.planner.beta)
        self.filter = PoseFilter(settings.start, settings.start_covariance)
        self.mates: dict[int, Mate] = {}
        self.inbox = Inbox()
        self._lives: dict[int, int] = {}
        """Incarnation last heard, by robot."""
        self.activity = "starting"
        self.claim: tuple[float, float, float] | None = None
        self.finished = False
        self.looks = 0
        self.trail = [(self.pose.x_m, self.pose.y_m)]
        self.map_changed_s = 0.0
        self.rate_bps: Callable[[], float] = lambda: math.inf
        self.radio: RadioPort | None = None
        self._status_due = True
        self._told_status = b""
        self._told_s = 0.0
        self._fixes: dict[int, Fix] = {}
        if self.me.incarnation > 0:
            self._take_up(self._recovered())

    # --- clock and pose -----------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """The time, in seconds."""
        return asyncio.get_running_loop().time()

    @property
    def pose(self) -> Pose:
        """Where it believes to stand."""
        return self.filter.pose

    def set_activity(self, activity: str) -> None:
        """Say what it is doing; team-mates hear of it."""
        assert activity in ACTIVITIES
        if activity != self.activity:
            self.activity = activity
            self.log.event("activity", activity)
            self.tell_status()

    # --- a former life ------------------------------------------------------------------

    def _recovered(self) -> Recovered:
        try:
            return self.disk.recover(self.settings.frame)
        except DiskError as error:
            self.log.event("disk", str(error))
            return Recovered()

    def _take_up(self, recovered: Recovered) -> None:
        """Take up what a former incarnation measured.

        What it published is frozen under its own origin; only cells that it never published
        come into this incarnation's layer, so nothing is counted twice.
        """
        for chunk in recovered.chunks:
            self.store.offer(chunk)
            self.team.tile_changed(chunk.key)
            self.sharing.recovered(chunk.key)
        for key, anchor in recovered.anchors.items():
            self.store.offer_anchor(key, anchor)
        for origin, index, submap in recovered.submaps:
            former = Origin(self.me.robot, origin.incarnation)
            published = self.team.published_mask(former, index)
            kept = submap.known & ~published
            self.store.offer_anchor(AnchorKey(*former, index), submap.anchor)
            if kept.any():
                fresh = self.own.begin_submap(submap.anchor.pose, np.diag(submap.anchor.variance))
                fresh.anchor = submap.anchor  # as drawn, and as corrected since
                fresh.take(submap, kept)
                self._tiles_changed(len(self.own.submaps) - 1, kept)
        if recovered.pose is not None and recovered.covariance is not None:
            # It may have driven on for a leg after the pose was last written down.
            lost = np.diag([LEG_M**2 / 4, LEG_M**2 / 4, 0.01, 0.03])
            self.filter = PoseFilter(recovered.pose, recovered.covariance + lost)
        # On disk before any of it can be published: a life that ends before its first look must
        # not leave these cells behind as the former one's, to be taken up and counted once more.
        try:
            self.disk.save_layer(self._layer_content())
        except DiskError as error:
            self.log.event("disk", str(error))
        self.log.event(
            "restart",
            f"incarnation {self.me.incarnation}: {len(recovered.chunks)} published versions and "
            f"{self.own.known_cells()} unpublished cells from disk",
        )

    async def save(self) -> None:
        """Write the own layer to disk; a disk that fails is told, and the robot goes on."""
        content = self._layer_content()
        try:
            await asyncio.to_thread(self.disk.save_layer, content)
        except DiskError as error:
            self.log.event("disk", str(error))

    def _layer_content(self) -> tuple[object, ...]:
        me = self.me
        former = {
            key: anchor
            for key, anchor in self.store.anchors.items()
            if key.robot == me.robot and key.incarnation != me.incarnation
        }
        return self.disk.layer_content(self.own, self.pose, self.filter.covariance, former)

    # --- look, localise, fuse -------------------------------------------------------------

    async def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Look once at a heading (pan from ahead), and take in all that it shows."""
        camera = self.hardware.camera
        assert camera is not None
        exposure = await camera.look(pan_rad, tilt_rad)
        expected = await asyncio.to_thread(
            expected_visibility, self.view(), self.pose, pan_rad, tilt_rad
        )
        self.localise(exposure)
        await self.fuse(exposure, expected)
        self.looks += 1
        await self.save()

    def localise(self, exposure: Exposure) -> None:
        """Take bearings on team-mates that stand still, and tell moving ones where they are."""
        for sighting in exposure.sightings:
            index = self.settings.roster.index(sighting.name)
            mate = self.mates.get(index)
            role = self.settings.roles[index]
            if role == "anchor" and mate is not None and self._is_surer(mate.status, sighting):
                self.filter.saw(
                    mate.status.pose, np.diag(mate.status.variance), sighting, gate=GATE
                )
            elif role == "cliffbot":
                self._tell_fix(index, sighting, exposure.t_s)

    def _is_surer(self, status: Status, sighting: Sighting) -> bool:
        """Say whether a bearing on a team-mate would tell more than is known already.

        What the team-mate is wrong by, it is wrong by each time: a robot that is as sure as one
        such look makes it learns nothing from a second one, and must not grow surer by it.
        """
        own = np.diag(self.filter.covariance)
        look = np.diag(sighting.covariance) + np.array(status.variance)
        return bool(np.any(own > look))

    @property
    def is_lost(self) -> bool:
        """Whether it is less sure of its pose than its map is fine."""
        variance = np.diag(self.filter.covariance)
        far_m = self.settings.sensor.range_m
        cell_m = self.settings.map.cell_m
        return bool(max(variance[:2]) > cell_m**2 or far_m**2 * variance[3] > cell_m**2)

    def bearings(self) -> list[tuple[float, float]]:
        """Return pan and tilt to the team-mates in range that stand still, the nearest first."""
        found: list[tuple[float, float, float]] = []
        for index, mate in sorted(self.mates.items()):
            if self.settings.roles[index] != "anchor":
                continue
            distance_m, pan_rad, tilt_rad = self.bearing_to(mate.status.pose)
            if distance_m < 0.9 * self.settings.sensor.range_m:
                found.append((distance_m, pan_rad, tilt_rad))
        return [(pan_rad, tilt_rad) for _, pan_rad, tilt_rad in sorted(found)]

    def bearing_to(self, pose: Pose) -> tuple[float, float, float]:
        """Return how far a pose is, and the pan and tilt that point the camera at it."""
        dx, dy = pose.x_m - self.pose.x_m, pose.y_m - self.pose.y_m
        distance_m = math.hypot(dx, dy)
        up_m = pose.z_m - self.pose.z_m - self.settings.sensor.height_m
        pan_rad = wrap_angle(math.atan2(dy, dx) - self.pose.yaw_rad)
        return distance_m, pan_rad, math.atan2(up_m, max(distance_m, 0.1))

    async def fuse(self, exposure: Exposure, expected: Singles) -> None:
        """Fuse one look into the own layer (Eqs. 19-21), and lose interest in what failed."""
        covariance = self.filter.covariance
        cell_m = self.settings.map.cell_m
        if self.own.needs_submap(covariance, shift_m=cell_m, turn_rad=0.02):
            self.own.begin_submap(self.pose, covariance)
        index = len(self.own.submaps) - 1
        submap = self.own.submaps[index]
        known_before = self.team.fused().known
        cells = await asyncio.to_thread(
            bin_look,
            exposure,
            self.pose,
            self.settings.frame,
            attitude_sigma_rad=math.radians(self.settings.sensor.attitude_sigma_deg),
            extra_variance=self.own.beyond_anchor(covariance),
        )
        submap.observe(cells)
        measured = np.zeros(self.settings.frame.shape, dtype=bool)
        measured[cells.rows, cells.cols] = True
        self.interest.update(expected, measured)
        self._tiles_changed(index, measured)
        new = measured & ~known_before
        self.log.look(
            exposure,
            expected_cells=float(np.sum(expected)),
            obtained_cells=int(np.count_nonzero(measured)),
            new_cells=int(np.count_nonzero(new)),
        )

    def _tiles_changed(self, submap: int, cells: Bools) -> None:
        self.team.own_changed()
        self.map_changed_s = self._time_or_zero()
        self.sharing.own_tiles_changed(submap, self.grid.touched(cells))
        self.kick()

    def _time_or_zero(self) -> float:
        try:
            return self.now_s
        except RuntimeError:
            return 0.0  # put together before its loop runs

    # --- plan and move --------------------------------------------------------------------

    def view(self) -> View:
        """Return what the planner sees: the team map and where everybody is."""
        fused = self.team.fused()
        return View(
            frame=self.settings.frame,
            elevation_m=fused.elevation_m,
            sigma_m=self.team.relief_sigma_m(),
            looks=fused.looks.astype(np.int64),
            interest=self.interest.share,
            pose=self.pose,
            pose_sigma_m=self.filter.sigma_m,
            others=[mate.status.pose for _, mate in sorted(self.mates.items())],
            sensor=self.settings.sensor,
            drive=self.settings.drive,
            planner=self.settings.planner,
            claims=self._regions(wished=False),
            wishes=tuple(self._regions(wished=True)),
            trail_m=np.array(self.trail),
        )

    def _regions(self, *, wished: bool) -> list[tuple[float, float, float]]:
        """Return what team-mates wait to know, or said that they will look at themselves."""
        return [
            mate.status.claim
            for index, mate in sorted(self.mates.items())
            if mate.status.claim is not None
            and (self.settings.roles[index] == "cliffbot") == wished
        ]

    def tile_weight(self, key: TileKey) -> float:
        """Return how much more a tile is worth to the team than any other, for what it is doing."""
        rows, cols = self.grid.window(key.tile)
        frame = self.settings.frame
        x_m, y_m = frame.centre_of((rows.start + rows.stop) // 2, (cols.start + cols.stop) // 2)
        near_m = 0.7 * self.grid.tile_cells * frame.cell_m
        wished = any(
            math.hypot(x_m - x, y_m - y) < radius + near_m
            for x, y, radius in self._regions(wished=True)
        )
        return WISHED if wished else 1.0

    async def choose_look(self) -> LookPlan | None:
        """Choose the next look (Eq. 23), and say to the others where it will be.

        On a real clock the radio goes on while the robot thinks; on the virtual one thinking takes
        no time.
        """
        plan = await asyncio.to_thread(self.strategy.choose, self.view(), self.rng)
        if plan is None:
            self.claim = None
            return None
        heading_rad = plan.heading_rad
        reach_m = 0.5 * self.settings.sensor.range_m
        x_m, y_m = plan.path_m[-1]
        self.claim = (
            float(x_m) + reach_m * math.cos(heading_rad),
            float(y_m) + reach_m * math.sin(heading_rad),
            reach_m,
        )
        self.tell_status()
        return plan

    def wish_to_know(self, goal_m: tuple[float, float]) -> None:
        """Tell the team that this robot waits to know the ground between itself and a point."""
        x_m, y_m = (self.pose.x_m + goal_m[0]) / 2, (self.pose.y_m + goal_m[1]) / 2
        half_m = math.dist((self.pose.x_m, self.pose.y_m), goal_m) / 2
        self.claim = (x_m, y_m, half_m + self.settings.drive.footprint_m)
        self.tell_status()

    async def travel(self, path_m: Floats) -> bool:
        """Drive along a path (N, 2) in the team frame; return whether its end was reached."""
        for x_m, y_m in path_m[1:]:
            if not await self.drive_to(float(x_m), float(y_m)):
                return False
        return True

    async def drive_to(self, x_m: float, y_m: float, leg_m: float = LEG_M) -> bool:
        """Drive straight to a point, leg by leg; return False where the body halted."""
        while True:
            dx, dy = x_m - self.pose.x_m, y_m - self.pose.y_m
            distance_m = math.hypot(dx, dy)
            if distance_m < 0.5 * self.settings.map.cell_m:
                return True
            turn_rad = wrap_angle(math.atan2(dy, dx) - self.pose.yaw_rad)
            if not await self.drive(turn_rad, min(distance_m, leg_m)):
                return False

    async def drive(self, turn_rad: float, forward_m: float) -> bool:
        """Turn and drive; the pose follows the odometry. Return False where the body halted."""
        body = self.hardware.body
        assert body is not None
        odometry = await body.drive(turn_rad, forward_m)
        self.filter.predict(odometry)
        self.trail.append((self.pose.x_m, self.pose.y_m))
        del self.trail[:-TRAIL_POINTS]
        if odometry.halted:
            self.log.event("halted", odometry.halted)
        return not odometry.halted

    # --- telling ----------------------------------------------------------------------------

    def kick(self) -> None:
        """Wake the radio: there may be something to send."""
        if self.radio is not None:
            self.radio.kick()

    def tell_status(self) -> None:
        """Have the status sent next."""
        self._status_due = True
        self.kick()

    def _tell_fix(self, index: int, sighting: Sighting, t_s: float) -> None:
        offset = (*sighting.offset_m, sighting.bearing_rad)
        pose, covariance = compose(self.pose, self.filter.covariance, offset, sighting.covariance)
        x, y, z, yaw = (float(v) for v in np.diag(covariance))
        self._fixes[index] = Fix(index, t_s, pose, (x, y, z, yaw))
        self.kick()

    def choose_frame(self, now_ns: int, payload_bytes: int) -> Outgoing | None:
        """Answer the link, which is free: what goes out next?"""
        if self._fixes:
            index = min(self._fixes)
            return Outgoing(Kind.FIX, pack_fix(self._fixes.pop(index)))
        if self._status_due:
            self._status_due = False
            self._told_status, self._told_s = pack_status(self._status()), now_ns / 1e9
            return Outgoing(Kind.STATUS, self._told_status)
        try:
            chosen = self.sharing.choose(now_ns / 1e9, payload_bytes, self.rate_bps())
        except DiskError as error:
            self.log.event("disk", str(error))
            return None
        return None if chosen is None else Outgoing(*chosen)

    def _status(self) -> Status:
        x, y, z, yaw = (float(v) for v in np.diag(self.filter.covariance))
        winch = self.hardware.winch
        return Status(
            self.pose,
            (x, y, z, yaw),
            ACTIVITIES.index(self.activity),
            self.claim,
            winch.length_m if winch is not None else 0.0,
        )

    # --- hearing ----------------------------------------------------------------------------

    def on_frame(self, frame: Frame, arrive_ns: int) -> None:
        """Take in a team-mate's frame; what cannot be understood is told and changes nothing."""
        try:
            self._take(frame, arrive_ns / 1e9)
        except (AgentError, CommsError) as error:
            sender = self.settings.roster[frame.sender]
            self.log.event("refused", f"{frame.kind.name} of {sender}: {error}")

    def _take(self, frame: Frame, now_s: float) -> None:
        if self._lives.get(frame.sender) != frame.incarnation:
            self._lives[frame.sender] = frame.incarnation
            self.sharing.clock.newcomer()
            self.kick()
        match frame.kind:
            case Kind.MAP:
                self._take_map(frame, now_s)
            case Kind.ANCHOR:
                key, anchor = unpack_anchor(frame.payload)
                mine = self.store.anchors.get(key)
                self._check_writer(Origin(*key[:2]), anchor.version, mine and mine.version)
                if self.store.offer_anchor(key, anchor):
                    self.team.own_changed()
                    self.map_changed_s = now_s
                self.sharing.heard_anchor(key, anchor.version)
            case Kind.DIGEST:
                self.sharing.heard_digest(frame.sender, unpack_digest(frame.payload), now_s)
                self.kick()
            case Kind.STATUS:
                status = unpack_status(frame.payload)
                if status.activity >= len(ACTIVITIES):
                    allowed = f"0 to {len(ACTIVITIES) - 1} are known"
                    raise AgentError(f"activity {status.activity}; {allowed}")
                self.mates[frame.sender] = Mate(status, now_s)
            case Kind.FIX:
                fix = unpack_fix(frame.payload)
                if fix.robot == self.settings.index:
                    self.filter.fix(fix.pose, np.diag(fix.variance), gate=GATE)
            case Kind.TETHER:
                self.inbox.tethers.extend(
                    c for c in unpack_tethers(frame.payload) if c.robot == self.settings.index
                )
                self.inbox.arrived.set()
            case Kind.STOP:
                self.inbox.arrived.set()

    def _take_map(self, frame: Frame, now_s: float) -> None:
        for chunk in unpack_chunks(frame.payload, (frame.sender, frame.incarnation)):
            if chunk.key.tile >= self.grid.count:
                raise AgentError(
                    f"tile {chunk.key.tile}: the team's map has tiles 0 to {self.grid.count - 1}"
                )
            mine = self.store.newest(chunk.key)
            self._check_writer(chunk.key.origin, chunk.version, mine and mine.number)
            changed = self.store.offer(chunk)
            if changed:
                self.team.tile_changed(chunk.key)
                self.map_changed_s = now_s
            self.sharing.heard_chunk(frame.sender, chunk, changed=changed)

    def _check_writer(self, origin: Origin, version: int, newest: int | None) -> None:
        """Refuse what is of nobody's, and what claims to be this robot's own and news to it."""
        if origin.robot >= len(self.settings.roster):
            last = len(self.settings.roster) - 1
            raise AgentError(f"a map of robot {origin.robot}; the team has robots 0 to {last}")
        if origin == self.me and (newest is None or version > newest):
            raise AgentError(
                f"version {version} of this robot's own map; it has published up to {newest}"
            )

    # --- life -------------------------------------------------------------------------------

    async def heartbeat(self) -> None:
        """Tell the team now and then where it is; looks whether a digest is due as well."""
        while True:
            status = pack_status(self._status())
            if status != self._told_status or self.now_s >= self._told_s + KEEP_ALIVE_S:
                self.tell_status()
            self.kick()
            await asyncio.sleep(self.settings.sharing.status_s)

    @property
    def settled(self) -> bool:
        """Whether its work is done and nothing that is worth its bytes is left to send."""
        return self.finished and not self._fixes and self.sharing.settled()
