"""The robots of a scenario: their roles, and a team written as a count."""

from typing import Annotated, Any, Literal, cast

from pydantic import Field

from comms.settings import Settings
from sim.settings import RecordingSettings

MAX_ROBOTS = 64
"""The largest team that the runner was tried with."""

Role = Literal["recon", "cliffbot", "anchor", "explorer"]
MAPPERS: tuple[Role, ...] = ("recon", "explorer")
"""Roles that map: they have a camera."""


class RobotSettings(Settings):
    """One robot of the team."""

    role: Role
    start: tuple[float, float, float] | None = None
    """x, y (m, world frame) and yaw (degrees, counter-clockwise from east); left out: placed."""
    start_known: bool = True
    """Whether it knows where it starts. One that does not looks for a landmark, a team-mate, or its
    own map on the team's, and nobody takes in its map before."""
    join_s: Annotated[float, Field(ge=0)] | None = None
    """When it starts; left out: with the others."""
    recording: RecordingSettings | None = None
    """Left out: it drives itself."""


def expand_team(robots: Any) -> Any:
    """Write `count` (and `role`) out as one table per robot: explorer-1, explorer-2 ...

    Tables of single robots beside them add to the robots so named. What has no `count` is returned
    as it is.

    Raises:
        ValueError: the count or the role is none, or a table names a robot beyond them.

    """
    if not isinstance(robots, dict) or "count" not in robots:
        return cast("Any", robots)
    robots = cast("dict[str, Any]", robots)
    tables = {key: value for key, value in robots.items() if key not in ("count", "role")}
    count, role = robots["count"], robots.get("role", "explorer")
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MAX_ROBOTS:
        raise ValueError(f"count is {count!r}; must be a whole number from 1 to {MAX_ROBOTS}")
    if role not in MAPPERS:
        raise ValueError(f"role is {role!r}; beside count it must be one of {', '.join(MAPPERS)}")
    team: dict[str, Any] = {f"{role}-{number}": {"role": role} for number in range(1, count + 1)}
    strangers = sorted(tables.keys() - team.keys())
    if strangers:
        raise ValueError(f"count is {count}, which makes no robot {strangers[0]}")
    return {name: {**own, **tables.get(name, {})} for name, own in team.items()}
