"""The fiducials that robots carry: which tags there are, and where they sit on a robot.

One definition, so that who paints a robot and who looks at it mean the same. AprilTag 36h11: ten
cells a side with its white border, the outer edge of the black square eight. Tag frame: x right and
y down on the panel as it is looked at, its centre the origin. Robot frame: x forward, y left, z up,
the ground contact below the mast the origin.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.errors import AgentError
from agents.geometry import Floats

FAMILY_TAGS = 587
"""Tags in the family 36h11."""
PANEL_CELLS, TAG_CELLS = 10, 8
SIDES, PANELS = 4, 5
"""Panels of a robot: ahead, left, behind, right, and on its lid, which is all that shows of one
that hangs in a face below."""
PANEL_M = 0.56
"""Side of a panel with its white border: the largest square box inside a body of 0.4 m radius."""
TAG_M = PANEL_M * TAG_CELLS / PANEL_CELLS
"""Side of the black square."""
CENTRE_M = 0.3
"""Height of a panel's centre over the ground contact."""


class TagError(AgentError):
    """A robot that has no tags of its own."""


@dataclass(frozen=True)
class Panel:
    """One tag on a robot, in the robot's frame."""

    tag: int
    centre_m: Floats
    """(3,)."""
    right: Floats
    """(3,) unit vector to the right as the panel is looked at."""
    down: Floats

    def corners_m(self, side_m: float = TAG_M) -> Floats:
        """Return the corners (4, 3) of a square on the panel: clockwise from the upper left."""
        half = side_m / 2
        signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=np.float64)
        return self.centre_m + half * (signs[:, :1] * self.right + signs[:, 1:] * self.down)


def panels(robot: int) -> tuple[Panel, ...]:
    """Return the five panels of the team's robot with this number (by name order, from 0).

    Who carries a mast carries no lid.

    Raises TagError beyond the family's last tag.
    """
    if not 0 <= robot < FAMILY_TAGS // PANELS:
        raise TagError(f"robot {robot}: there are tags for robots 0 to {FAMILY_TAGS // PANELS - 1}")
    return (*(_panel(robot, side) for side in range(SIDES)), _lid(robot))


def _panel(robot: int, side: int) -> Panel:
    outward = side * math.pi / 2
    out = np.array([math.cos(outward), math.sin(outward), 0.0])
    # Who looks at a panel looks along -out with z up: his right is out turned by +90 deg.
    right = np.array([-out[1], out[0], 0.0])
    return Panel(
        robot * PANELS + side,
        out * PANEL_M / 2 + np.array([0.0, 0.0, CENTRE_M]),
        right,
        np.array([0.0, 0.0, -1.0]),
    )


def _lid(robot: int) -> Panel:
    # Its upper edge is ahead.
    ahead, left = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    return Panel(robot * PANELS + SIDES, np.array([0.0, 0.0, 2 * CENTRE_M]), -left, -ahead)


def robot_of(tag: int) -> int:
    """Return the number of the robot that carries a tag."""
    return tag // PANELS


def is_lid(tag: int) -> bool:
    """Say whether a tag is on its robot's lid."""
    return tag % PANELS == SIDES
