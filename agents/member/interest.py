"""Which tiles are worth more to a team, and which nothing, for what its robots are doing."""

import math
from collections.abc import Callable

from agents.briefing import AgentSettings, Mate
from agents.geometry import Pose
from agents.planning.scene import WISHED
from agents.store import Origin, TileKey
from agents.tiles import TileGrid

SILENT_S = 240.0
"""A team-mate that was not heard for so long is taken for lost: what it claimed is free again."""


class Interest:
    """What a robot knows of where its team-mates work, and how far its own concern reaches."""

    def __init__(
        self,
        settings: AgentSettings,
        me: Origin,
        grid: TileGrid,
        mates: dict[int, Mate],
        now_s: Callable[[], float],
    ) -> None:
        """Judge by what `mates` say; tiles of others count within the horizon of where it is."""
        self._settings, self._me, self._grid = settings, me, grid
        self._mates, self._now_s = mates, now_s
        self._weighed_at = settings.start
        """Where it stood when tiles were last weighed by how far off they are."""

    def regions(self, *, wished: bool) -> list[tuple[float, float, float]]:
        """Return what team-mates wait to know, or said that they will look at themselves."""
        now_s = self._now_s()
        return [
            mate.status.claim
            for index, mate in sorted(self._mates.items())
            if mate.status.claim is not None
            and (self._settings.roles[index] == "cliffbot") == wished
            and (wished or now_s - mate.heard_s < SILENT_S)
        ]

    def weight(self, key: TileKey) -> float:
        """Return how much more a tile is worth to the team than any other, for what it is doing."""
        x_m, y_m = self._grid.centre_m(key.tile)
        near_m = 0.7 * self._grid.tile_cells * self._settings.frame.cell_m
        horizon_m = self._settings.sharing.horizon_m
        if horizon_m is not None and key.origin != self._me:
            here = self._weighed_at
            if math.hypot(x_m - here.x_m, y_m - here.y_m) > horizon_m + near_m:
                return 0.0
        wished = any(
            math.hypot(x_m - x, y_m - y) < radius + near_m
            for x, y, radius in self.regions(wished=True)
        )
        return WISHED if wished else 1.0

    def moves_to(self, pose: Pose) -> bool:
        """Say whether it has moved so far of its horizon that tiles must be weighed anew."""
        horizon_m = self._settings.sharing.horizon_m
        if horizon_m is None or pose.distance_m(self._weighed_at) <= horizon_m / 4:
            return False
        self._weighed_at = pose
        return True
