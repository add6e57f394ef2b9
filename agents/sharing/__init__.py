"""What is worth its bytes: the choice that a robot makes whenever its link falls free.

Nothing is queued. When the link asks, the policy looks at what the robot has and at what it
believes its team-mates to have, and answers with one frame. Policies, by name:

- `value`: the chunk of most worth per byte first.
- `latest-first`: the tile that was published last goes first, whole.
- `raw`: float32 cells, the grid in order.
- `paper`: the whole map after each look, in the paper's own codec, first in, first out.
"""

from collections.abc import Callable
from dataclasses import dataclass

from agents.payloads import Paper, Payloads, Pyramid, Raw
from agents.sharing.fifo import RawGrid, WholeMap
from agents.sharing.policy import Desk, Free, Heard, Policy
from agents.sharing.repair import Mark
from agents.sharing.value import LatestFirst, Value

__all__ = ["POLICIES", "Desk", "Free", "Heard", "Mark", "Policy", "Way", "way"]


@dataclass(frozen=True)
class Way:
    """A policy, with the form in which it sends tiles."""

    policy: Callable[[Desk], Policy]
    payloads: Callable[[], Payloads]
    whole_map: bool = False
    """The map is one tile."""


POLICIES: dict[str, Way] = {
    "value": Way(Value, Pyramid),
    "latest-first": Way(LatestFirst, Pyramid),
    "raw": Way(RawGrid, Raw),
    "paper": Way(WholeMap, Paper, whole_map=True),
}


def way(name: str) -> Way:
    """Return a way of sharing by its name."""
    return POLICIES[name]
