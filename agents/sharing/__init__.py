"""What is worth its bytes: the choice that a robot makes whenever its link falls free.

Nothing is queued. When the link asks, the policy looks at what the robot has and at what it
believes its team-mates to have, and answers with one frame. Policies, by name:

- `value`: the chunk of most worth per byte first.
- `latest-first`: the tile that was published last goes first, whole.
- `raw`: float32 cells (a byte for one of log-odds), the grid in order.
- `paper`: the whole map after each look, in the paper's own codec, first in, first out; elevation
  maps only.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from agents.maps import MapKind, kind_of
from agents.payloads import OccupancyPyramid, Paper, Pyramid, Raw, RawOccupancy
from agents.settings import MapSettings
from agents.sharing.fifo import RawGrid, WholeMap
from agents.sharing.policy import Desk, Free, Heard, Policy
from agents.sharing.repair import Mark
from agents.sharing.value import LatestFirst, Value
from comms.plugins import Plugins

__all__ = ["WAYS", "Desk", "Free", "Heard", "Mark", "Policy", "Way", "way"]


@dataclass(frozen=True)
class Way:
    """A policy, with the form in which it sends tiles."""

    policy: Callable[[Desk], Policy]
    payloads: Mapping[str, Callable[[], Any]]
    """How tiles are written, by the kinds of map that the policy can send."""
    whole_map: bool = False
    """The map is one tile."""

    def kind(self, settings: MapSettings) -> MapKind[Any, Any]:
        """Return the kind of map that is set, written in this way."""
        return kind_of(settings, self.payloads[settings.kind]())


_LEVELS = {"elevation": Pyramid, "planar": OccupancyPyramid, "voxel": OccupancyPyramid}
_CELLS = {"elevation": Raw, "planar": RawOccupancy, "voxel": RawOccupancy}
WAYS: Plugins[Way] = Plugins(
    "ropeteam.sharing",
    {
        "value": Way(Value, _LEVELS),
        "latest-first": Way(LatestFirst, _LEVELS),
        "raw": Way(RawGrid, _CELLS),
        "paper": Way(WholeMap, {"elevation": Paper}, whole_map=True),
    },
)


def way(name: str) -> Way:
    """Return a way of sharing by its name.

    Raises:
        PluginError: there is none of that name.
    """
    return WAYS.find(name)
