"""What a robot keeps: its own layer, what the team published, its pose, and all of it on disk."""

import asyncio
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from agents.briefing import AgentSettings, Mate, RadioPort, RobotLog
from agents.disk import Disk, Recovered
from agents.geometry import Pose
from agents.layers import UNLOCATED_M2, Mask, OwnLayer, variances
from agents.member.durable import Durable
from agents.member.interest import Interest
from agents.ports import Hardware
from agents.pose.anchoring import UNLOCATED, Tolerance, corrected, submap_name
from agents.pose.posefilter import PoseFilter
from agents.sharing import Desk, way
from agents.store import AnchorKey, Origin, Store
from agents.teammap import TeamMap

LEG_M = 1.0
"""A drive is cut in legs of at most this, each measured by itself."""


class Keeper:
    """A robot's maps and pose in one incarnation, and its disk; what changes wakes the radio."""

    def __init__(
        self, settings: AgentSettings, hardware: Hardware, disk: Disk, log: RobotLog
    ) -> None:
        """Take a robot's place; on a disk that holds a former life (`Disk.begin`), take it up."""
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
        self.durable = Durable(disk, log, self._layer_content)
        self.sharing = sharing.policy(
            Desk(settings.sharing, self.me, len(settings.roster), self.team, self.durable.journal)
        )
        self.mates: dict[int, Mate] = {}
        """What each team-mate said last."""
        self.interest = Interest(settings, self.me, self.grid, self.mates, self._time_or_zero)
        self.sharing.weight = self.interest.weight
        self.filter = PoseFilter(settings.start, settings.start_covariance)
        self.filter.doubt_slip(settings.drive.slip_bias_sigma)
        self.located = settings.start_known
        """Whether its poses are in the team frame; if not, they are in one of its own."""
        self._tolerance = Tolerance.of(settings)
        self.map_changed_s = 0.0
        self.rate_bps: Callable[[], float] = lambda: math.inf
        self.radio: RadioPort | None = None
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

    def kick(self) -> None:
        """Wake the radio: there may be something to send."""
        if self.radio is not None:
            self.radio.kick()

    # --- the disk ------------------------------------------------------------------------

    async def save(self) -> None:
        """Write the own layer to disk; a disk that fails is told, and the robot goes on."""
        await self.durable.save()

    @property
    def may_speak(self) -> bool:
        """Whether this incarnation is on disk: nothing may be said under it before."""
        return self.durable.confirmed()

    def _layer_content(self) -> tuple[object, ...]:
        me = self.me
        former = {
            key: anchor
            for key, anchor in self.store.anchors.items()
            if key.robot == me.robot and key.incarnation != me.incarnation
        }
        covariance = np.diag(self.said_variance) if not self.located else self.filter.covariance
        return self.disk.layer_content(self.own, self.pose, covariance, former)

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
        self.durable.owe_layer()
        self.log.event(
            "restart",
            f"incarnation {self.me.incarnation}: {len(recovered.chunks)} published versions and "
            f"{self.own.known_cells()} unpublished cells from disk",
        )

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
