"""Keys whose value is the name of a part: the house's own, or one of an installed package."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from agents import planar
from agents.planning.strategies import STRATEGIES
from agents.sharing import WAYS
from agents.voxel import choosing
from comms.plugins import Plugins
from sim.sensors import SENSORS
from sim.terrain import TERRAINS

if TYPE_CHECKING:
    from scenarios.schema import Scenario

METHODS: dict[str, Plugins[Any]] = {
    "elevation": STRATEGIES,
    "planar": planar.METHODS,
    "voxel": choosing.METHODS,
}
"""Ways to choose a look, by kind of map."""


@dataclass(frozen=True)
class Choice:
    """One such key of a scenario."""

    key: str
    name: str
    """What is chosen."""
    parts: Plugins[Any]
    fits: Callable[[str], bool] = lambda name: True
    """Whether a part can be used with the rest of the scenario."""
    more: tuple[str, ...] = ()
    """Names that stand for no part."""

    @property
    def is_allowed(self) -> bool:
        """Say whether the chosen name is allowed."""
        there = self.name in self.more or self.name in self.parts
        return there and self.fits(self.name)

    def allowed(self) -> tuple[str, ...]:
        """Return all that may be chosen."""
        return tuple(name for name in (*self.parts.names(), *self.more) if self.fits(name))


def choices(scenario: "Scenario") -> tuple[Choice, ...]:
    """Return the keys of a scenario that name parts."""
    kind = scenario.map.kind
    return (
        Choice("method", scenario.method, METHODS[kind]),
        Choice(
            "sharing.policy",
            scenario.sharing.policy,
            WAYS,
            fits=lambda name: kind in WAYS.find(name).payloads,
        ),
        Choice("sensor.kind", scenario.sensor.kind, SENSORS),
        Choice("world.terrain.kind", scenario.world.terrain.kind, TERRAINS, more=("file",)),
    )
