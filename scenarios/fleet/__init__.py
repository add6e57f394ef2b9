"""A fleet larger than one run of processes: up to thousands of robots on one virtual loop.

The same robots as everywhere (`agents.robot`, `agents.roles`, `comms.radio`) with a cheap sensor
and planner, on ground whose area grows with their number. A frame reaches whoever stands within
radio range at the end of its transmission, and nobody else: the air looks only at the squares of
the ground around the sender, so that a frame costs its listeners and not the fleet.
"""

from scenarios.fleet.account import Account, account
from scenarios.fleet.fleet import Fleet
from scenarios.fleet.settings import FleetSettings

__all__ = ["Account", "Fleet", "FleetSettings", "account"]
