"""The bodies that a simulated robot can have; see `sim.rover` and `sim.tethered`."""

from sim.rover import RoverBody
from sim.tethered import TetheredBody

__all__ = ["RoverBody", "TetheredBody"]
