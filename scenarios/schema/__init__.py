"""What a scenario is, how it is read, and what is said where it is wrong."""

from scenarios.schema.loading import dump, load, parse
from scenarios.schema.scenario import ClockSettings, Name, Scenario
from scenarios.schema.team import MAPPERS, MAX_ROBOTS, RobotSettings, Role, expand_team

__all__ = [
    "MAPPERS",
    "MAX_ROBOTS",
    "ClockSettings",
    "Name",
    "RobotSettings",
    "Role",
    "Scenario",
    "dump",
    "expand_team",
    "load",
    "parse",
]
