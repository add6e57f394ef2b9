"""What makes a robot a member of its team: its layer, its store, its radio, what it says and hears.

Nothing here moves or looks. A member on a lander, without wheels, would be this and no more.
"""

import asyncio
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from agents.anchoring import UNLOCATED, Tolerance, corrected, submap_name
from agents.briefing import ACTIVITIES, AgentSettings, Inbox, Mate, RadioPort, RobotLog
from agents.disk import Disk, DiskError, Recovered
from agents.errors import AgentError
from agents.geometry import Floats, Pose, wrap_angle
from agents.layers import UNLOCATED_M2, Mask, OwnLayer, variances
from agents.localising import GATE, origin_of
from agents.messages import (
    Fix,
    Status,
    pack_fix,
    pack_status,
    unpack_anchor,
    unpack_chunks,
    unpack_fix,
    unpack_status,
    unpack_tethers,
)
from agents.ports import Hardware
from agents.posefilter import PoseFilter
from agents.scene import WISHED
from agents.sharing import Desk, Free, Heard, Mark, way
from agents.sharing.reports import unpack_report
from agents.store import AnchorKey, Chunk, Origin, Store, TileKey
from agents.teammap import TeamMap
from comms.errors import CommsError
from comms.frames import Frame, Kind
from comms.radio import Outgoing

KEEP_ALIVE_S = 60.0
"""A robot of which nothing changes says so this often."""
SILENT_S = 240.0
"""A team-mate that was not heard for so long is taken for lost: what it claimed is free again."""
TOLD_M = 0.3
TOLD_RAD = 0.2
"""A robot that has moved or turned less than this need not say so."""
LEG_M = 1.0
"""A drive is cut in legs of at most this, each measured by itself."""


class Member:
    """A robot as a member of its team, in one incarnation: what it keeps, tells and hears.

    It knows nothing of wheels and cameras; `agents.robot.Robot` adds these.
    """

    def __init__(
        self, settings: AgentSettings, hardware: Hardware, disk: Disk, log: RobotLog
    ) -> None:
        """Put a member together; on a disk that holds a former life (`Disk.begin`), take it up."""
        self.settings = settings
        self.hardware = hardware
        self.disk = disk
        self.log = log
        self.me = Origin(settings.index, disk.incarnation)
        sharing = way(settings.sharing.policy)
        side = max(settings.frame.shape) if sharing.whole_map else settings.map.tile_cells
        kind = sharing.kind(settings.map)
        self.grid = kind.tiles(settings.frame, side, settings.whole)
        self.own: OwnLayer[Any] = OwnLayer(settings.frame, kind.submap)
        self.store = Store()
        self.team: TeamMap[Any, Any] = TeamMap(self.grid, self.store, self.own, self.me, kind)
        self.sharing = sharing.policy(
            Desk(settings.sharing, self.me, len(settings.roster), self.team, self._journal)
        )
        self.sharing.weight = self.tile_weight
        self.filter = PoseFilter(settings.start, settings.start_covariance)
        self.filter.doubt_slip(settings.drive.slip_bias_sigma)
        self.located = settings.start_known
        """Whether its poses are in the team frame; if not, they are in one of its own."""
        self.origin: int | None = None
        """Whose pose the team's frame hangs on, as far as this robot can hear."""
        self._tolerance = Tolerance.of(settings)
        self.mates: dict[int, Mate] = {}
        self.inbox = Inbox()
        self.activity = "starting"
        self.claim: tuple[float, float, float] | None = None
        self.finished = False
        self.map_changed_s = 0.0
        self.rate_bps: Callable[[], float] = lambda: math.inf
        self.radio: RadioPort | None = None
        self._lives: dict[int, int] = {}
        """Incarnation last heard, by robot."""
        self._status_due = True
        self._told: Status | None = None
        self._told_s = 0.0
        self._fixes: dict[int, Fix] = {}
        self._owes_layer = False
        """Cells of a former life are in the own layer, and not yet on disk under this one."""
        self._disk_told = ""
        self._weighed_at = settings.start
        """Where it stood when tiles were last weighed by how far off they are."""
        if self.me.incarnation > 0:
            self._take_up(disk.recover(settings.frame, kind))

    # --- clock and pose -----------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """The time, in seconds."""
        return asyncio.get_running_loop().time()

    @property
    def pose(self) -> Pose:
        """Where it believes to stand."""
        return self.filter.pose

    @property
    def said_variance(self) -> tuple[float, float, float, float]:
        """How sure its pose is in the team frame, (x, y, z, yaw), as it tells others."""
        return variances(self.filter.covariance) if self.located else UNLOCATED

    def begin_submap(self) -> int:
        """Begin a submap of its own where it stands; return its index."""
        index = len(self.own.submaps)
        self.own.begin_submap(self.pose, np.diag(self.said_variance))
        self.filter.remember(submap_name(index))
        return index

    def correct_anchors(self) -> None:
        """Move the submaps that the robot knows better where they lie; the anchors are told."""
        if not self.located:
            return
        found = corrected(self.own, self.filter, self._tolerance)
        most_m = 0.0
        for index, anchor in found.items():
            submap = self.own.submaps[index]
            most_m = max(most_m, submap.anchor.corrected.distance_m(anchor.corrected))
            submap.anchor = anchor
            key = AnchorKey(*self.me, index)
            if key in self.store.anchors:
                self.store.offer_anchor(key, anchor)
        if found:
            self.team.own_changed()
            self.map_changed_s = self._time_or_zero()
            self.log.event("corrected", f"{len(found)} submaps by up to {most_m:.3f} m")
            self.kick()

    def settle(self, pose: Pose, covariance: Floats, by: str) -> None:
        """Learn for the first time where it is in the team frame, and all that it mapped so far."""
        self.filter.settle(pose, covariance)
        self.located = True
        self.log.event("located", by)
        self.correct_anchors()
        self.tell_status()

    def set_activity(self, activity: str) -> None:
        """Say what it is doing; team-mates hear of it."""
        assert activity in ACTIVITIES
        if activity != self.activity:
            self.activity = activity
            self.log.event("activity", activity)
            self.tell_status()

    # --- a former life ------------------------------------------------------------------

    def _take_up(self, recovered: Recovered) -> None:
        """Take up what a former incarnation measured.

        What it published is frozen under its own origin; only cells that it never published
        come into this incarnation's layer, so nothing is counted twice.
        """
        for problem in recovered.problems:
            self.log.event("disk", problem)
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
                self.tiles_changed(len(self.own.submaps) - 1, kept)
        if recovered.pose is not None and recovered.covariance is not None:
            # It may have driven on for a leg after the pose was last written down.
            lost = np.diag([LEG_M**2 / 4, LEG_M**2 / 4, 0.01, 0.03])
            self.located = bool(recovered.covariance[0, 0] < UNLOCATED_M2)
            before = recovered.covariance if self.located else np.zeros((4, 4))
            self.filter = PoseFilter(recovered.pose, before + lost)
            self.filter.doubt_slip(self.settings.drive.slip_bias_sigma)
        # On disk before any of it can be published: a life that ends before its first look must
        # not leave these cells behind as the former one's, to be taken up and counted once more.
        self._owes_layer = True
        try:
            self._save(self._layer_content())
        except DiskError as error:
            self._tell_disk(error)
        self.log.event(
            "restart",
            f"incarnation {self.me.incarnation}: {len(recovered.chunks)} published versions and "
            f"{self.own.known_cells()} unpublished cells from disk",
        )

    async def save(self) -> None:
        """Write the own layer to disk; a disk that fails is told, and the robot goes on."""
        content = self._layer_content()
        try:
            await asyncio.to_thread(self._save, content)
        except DiskError as error:
            self._tell_disk(error)

    def _save(self, content: tuple[object, ...]) -> None:
        self.disk.save_layer(content)
        self._owes_layer = False
        self._disk_told = ""

    def _journal(self, chunk: Chunk) -> None:
        """Make a version durable that is about to be published.

        Raises:
            DiskError: it is not, and must not be sent.

        """
        if self._owes_layer:
            self._save(self._layer_content())
        self.disk.journal(chunk)

    def _tell_disk(self, error: DiskError) -> None:
        """Say that the disk refuses; once, for as long as it does."""
        if str(error) != self._disk_told:
            self._disk_told = str(error)
            self.log.event("disk", str(error))

    @property
    def may_speak(self) -> bool:
        """Whether this incarnation is on disk: nothing may be said under it before."""
        try:
            self.disk.confirm()
        except DiskError as error:
            self._tell_disk(error)
            return False
        return True

    def _layer_content(self) -> tuple[object, ...]:
        me = self.me
        former = {
            key: anchor
            for key, anchor in self.store.anchors.items()
            if key.robot == me.robot and key.incarnation != me.incarnation
        }
        covariance = np.diag(self.said_variance) if not self.located else self.filter.covariance
        return self.disk.layer_content(self.own, self.pose, covariance, former)

    def tiles_changed(self, submap: int, cells: Mask) -> None:
        """Note that some cells of an own submap were measured."""
        tiles = self.grid.touched(cells)
        self.team.own_tiles_changed(submap, tiles)
        self.map_changed_s = self._time_or_zero()
        self.sharing.own_tiles_changed(submap, tiles)
        self.kick()

    def _time_or_zero(self) -> float:
        try:
            return self.now_s
        except RuntimeError:
            return 0.0  # put together before its loop runs

    def regions(self, *, wished: bool) -> list[tuple[float, float, float]]:
        """Return what team-mates wait to know, or said that they will look at themselves."""
        now_s = self._time_or_zero()
        return [
            mate.status.claim
            for index, mate in sorted(self.mates.items())
            if mate.status.claim is not None
            and (self.settings.roles[index] == "cliffbot") == wished
            and (wished or now_s - mate.heard_s < SILENT_S)
        ]

    def tile_weight(self, key: TileKey) -> float:
        """Return how much more a tile is worth to the team than any other, for what it is doing."""
        x_m, y_m = self.grid.centre_m(key.tile)
        near_m = 0.7 * self.grid.tile_cells * self.settings.frame.cell_m
        horizon_m = self.settings.sharing.horizon_m
        if horizon_m is not None and key.origin != self.me:
            here = self._weighed_at
            if math.hypot(x_m - here.x_m, y_m - here.y_m) > horizon_m + near_m:
                return 0.0
        wished = any(
            math.hypot(x_m - x, y_m - y) < radius + near_m
            for x, y, radius in self.regions(wished=True)
        )
        return WISHED if wished else 1.0

    # --- telling ----------------------------------------------------------------------------

    def kick(self) -> None:
        """Wake the radio: there may be something to send."""
        if self.radio is not None:
            self.radio.kick()

    def tell_status(self) -> None:
        """Have the status sent next."""
        self._status_due = True
        self.kick()

    def tell_fix(self, fix: Fix) -> None:
        """Have a team-mate told where it was seen."""
        self._fixes[fix.robot] = fix
        self.kick()

    def choose_frame(self, now_ns: int, payload_bytes: int) -> Outgoing | None:
        """Answer the link, which is free: what goes out next?"""
        if not self.may_speak:
            return None
        if self._fixes:
            index = min(self._fixes)
            return Outgoing(Kind.FIX, pack_fix(self._fixes.pop(index)))
        if self._status_due:
            self._status_due = False
            self._told, self._told_s = self._status(), now_ns / 1e9
            return Outgoing(Kind.STATUS, pack_status(self._told))
        try:
            seq = 0 if self.radio is None else self.radio.next_seq
            free = Free(now_ns / 1e9, payload_bytes, self.rate_bps(), seq)
            chosen = self.sharing.choose(free)
        except DiskError as error:
            self._tell_disk(error)
            return None
        return None if chosen is None else Outgoing(*chosen)

    def _status(self) -> Status:
        winch = self.hardware.winch
        return Status(
            self.pose,
            self.said_variance,
            ACTIVITIES.index(self.activity),
            self.claim,
            winch.length_m if winch is not None else 0.0,
            self.store.mark,
            self.sharing.settled(),
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
        heard = Heard(Origin(frame.sender, frame.incarnation), frame.seq, now_s)
        if self._lives.get(frame.sender) != frame.incarnation:
            self._lives[frame.sender] = frame.incarnation
            self.sharing.newcomer(frame.sender)
            self.kick()
        self.sharing.heard_frame(heard)
        match frame.kind:
            case Kind.MAP:
                self._take_map(frame.payload, heard)
            case Kind.ANCHOR:
                key, anchor = unpack_anchor(frame.payload)
                mine = self.store.anchors.get(key)
                self._check_writer(Origin(*key[:2]), anchor.version, mine and mine.version)
                if self.store.offer_anchor(key, anchor):
                    self.team.anchor_changed(key)
                    self.map_changed_s = now_s
                self.sharing.heard_anchor(heard, key, anchor.version)
            case Kind.DIGEST:
                self.sharing.heard_report(heard, unpack_report(frame.payload))
                self.kick()
            case Kind.STATUS:
                status = unpack_status(frame.payload)
                if status.activity >= len(ACTIVITIES):
                    allowed = f"0 to {len(ACTIVITIES) - 1} are known"
                    raise AgentError(f"activity {status.activity}; {allowed}")
                self.mates[frame.sender] = Mate(status, now_s)
                self.look_for_origin(now_s)
                self.sharing.heard_mark(heard, Mark(status.store_mark, status.settled))
            case Kind.FIX:
                fix = unpack_fix(frame.payload)
                if fix.robot == self.settings.index:
                    self._take_fix(fix, self.settings.roster[frame.sender])
            case Kind.TETHER:
                self.inbox.tethers.extend(
                    c for c in unpack_tethers(frame.payload) if c.robot == self.settings.index
                )
                self.inbox.arrived.set()
            case Kind.STOP:
                self.inbox.arrived.set()

    def _take_fix(self, fix: Fix, sender: str) -> None:
        covariance = np.diag(fix.variance)
        if self.located:
            self.filter.fix(fix.pose, covariance, gate=GATE)
            self.correct_anchors()
        elif max(fix.variance[:2]) < UNLOCATED_M2:
            self.settle(fix.pose, covariance, f"seen by {sender}")

    def _take_map(self, payload: bytes, heard: Heard) -> None:
        taken: list[tuple[Chunk, bool]] = []
        try:
            self._take_chunks(unpack_chunks(payload, heard.sender), heard, taken)
        finally:
            self.sharing.heard_chunks(heard, taken)

    def _take_chunks(
        self, chunks: list[Chunk], heard: Heard, taken: list[tuple[Chunk, bool]]
    ) -> None:
        for chunk in chunks:
            self._check(chunk)
        for chunk in chunks:
            if not self.grid.holds(chunk.key.tile):
                continue  # of ground that this robot does not keep
            changed = self.store.offer(chunk)
            if changed:
                self.team.tile_changed(chunk.key)
                self.map_changed_s = heard.now_s
            taken.append((chunk, changed))

    def _check(self, chunk: Chunk) -> None:
        if chunk.key.tile >= self.grid.count:
            raise AgentError(
                f"tile {chunk.key.tile}: the team's map has tiles 0 to {self.grid.count - 1}"
            )
        mine = self.store.newest(chunk.key)
        self._check_writer(chunk.key.origin, chunk.version, mine and mine.number)

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

    def look_for_origin(self, now_s: float) -> None:
        """Find out whose pose the team's frame hangs on now; say so where it is this robot's."""
        before, me = self.origin, self.settings.index
        self.origin = origin_of(
            self.settings, self.mates, heard_since_s=now_s - SILENT_S, located=self.located
        )
        if self.origin == me and before not in (me, None):
            self.log.event("origin", f"in place of {self.settings.roster[before]}")

    async def heartbeat(self) -> None:
        """Tell the team now and then where it is; looks whether a digest is due as well."""
        while True:
            self.look_for_origin(self.now_s)
            told, overdue = self._told, self.now_s >= self._told_s + KEEP_ALIVE_S
            if told is None or overdue or _differs(self._status(), told):
                self.tell_status()
            self._mind_horizon()
            self.kick()
            await asyncio.sleep(self.settings.sharing.status_s)

    def _mind_horizon(self) -> None:
        """Weigh tiles anew once it has moved a good part of its horizon."""
        horizon_m = self.settings.sharing.horizon_m
        if horizon_m is not None and self.pose.distance_m(self._weighed_at) > horizon_m / 4:
            self._weighed_at = self.pose
            self.sharing.look_again()

    @property
    def settled(self) -> bool:
        """Whether its work is done and nothing that is worth its bytes is left to send."""
        return self.finished and not self._fixes and self.sharing.settled()


def _differs(status: Status, told: Status) -> bool:
    """Say whether a status tells team-mates something that they would act on."""
    moved_m = status.pose.distance_m(told.pose)
    turned_rad = abs(wrap_angle(status.pose.yaw_rad - told.pose.yaw_rad))
    return (
        moved_m > TOLD_M
        or turned_rad > TOLD_RAD
        or abs(status.tether_m - told.tether_m) > TOLD_M
        or (status.activity, status.claim) != (told.activity, told.claim)
    )
