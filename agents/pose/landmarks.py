"""Landmarks: things of known shape at known places, by which a robot knows where it is."""

from dataclasses import dataclass

from agents.geometry import Pose


@dataclass(frozen=True)
class Landmark:
    """A thing that bears a robot's fiducials, and whose place was surveyed."""

    name: str
    pose: Pose
    """Its foot in the team frame, and which way it faces."""
