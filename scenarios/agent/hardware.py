"""The drivers of real (or simulated) bodies: found by name, asked for a `Hardware`.

A driver is a function that takes a `Mount` and returns `agents.ports.Hardware`. A package offers it
as an entry point of the group `ropeteam.hardware`; its name is then the `driver` in a robot's file.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, cast

from agents.ports import Hardware
from scenarios.agent.settings import AgentFile
from scenarios.errors import ScenarioError

GROUP = "ropeteam.hardware"
SIMULATED = "scenarios.agent.simulated:make"


@dataclass(frozen=True)
class Mount:
    """What a driver is told."""

    file: AgentFile
    beside: Path
    """The folder of the robot's file, for paths in its options."""

    def option(self, name: str, default: Any = None) -> Any:
        """Return one of the driver's options."""
        return self.file.hardware.options.get(name, default)


Driver = Callable[[Mount], Hardware]


def driver_of(name: str) -> Driver:
    """Return a driver.

    Raises:
        ScenarioError: there is none of that name, or it can't be imported.

    """
    offered = {point.name: point.value for point in entry_points(group=GROUP)}
    target = name if ":" in name else {"simulated": SIMULATED, **offered}.get(name)
    if target is None:
        known = ", ".join(sorted({"simulated", *offered}))
        raise ScenarioError([f'hardware.driver is "{name}"; there are {known}, or module:function'])
    module, _, function = target.partition(":")
    try:
        return cast("Driver", getattr(importlib.import_module(module), function))
    except (ImportError, AttributeError) as error:
        raise ScenarioError([f'hardware.driver "{name}": {error}']) from error
