"""Whether a map lies where it fits best: only there, on enough of the other, without contradiction.

A wrong place is worse than none: a robot that does not know where it is says so, and looks on.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from agents.geometry import Floats, Pose, wrap_angle
from agents.joining.fitting import Fit
from agents.joining.searching import Strewn


@dataclass(frozen=True)
class Judged:
    """A place, and what speaks for it."""

    fit: Fit
    overlap_m2: float
    evidence: float
    """Nats; above 0 speaks for it."""
    agreement: float
    """Share of what both know of which both say the same, 0 to 1."""
    contradiction: str = ""
    """Why it can't be there, or empty."""


@dataclass(frozen=True)
class Joined:
    """Where a robot's own frame lies in the team's."""

    origin: Pose
    """Of the robot's frame, in the team's."""
    covariance: Floats
    """(4, 4) of (x, y, z) of the `middle_m`, and of the yaw."""
    middle_m: Floats
    """(2,) in the team's frame: the middle of the overlap."""
    told: str
    judged: Judged

    def unsure_by(self, variance: Floats) -> "Joined":
        """Return it less sure, by variances (4,) of (x, y, z, yaw) of the team's map there."""
        return replace(self, covariance=self.covariance + np.diag(variance))

    def stand(self, pose: Pose) -> tuple[Pose, Floats]:
        """Return where a pose of the own frame is in the team's, with covariance (4, 4)."""
        there = self.origin.moved(pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad)
        carry = np.eye(4)
        carry[0, 3], carry[1, 3] = self.middle_m[1] - there.y_m, there.x_m - self.middle_m[0]
        return there, carry @ self.covariance @ carry.T


@dataclass(frozen=True)
class NotFound:
    """Why a map was not found on another."""

    why: str


@dataclass(frozen=True)
class Needs:
    """What a place must have."""

    overlap_m2: float
    evidence: float
    agreement: float
    rival: float
    """The best place elsewhere must have less than this share of the evidence."""
    sigma_m: float
    """Along the axis that is known worst."""
    sigma_rad: float
    apart_m: float
    """Places farther apart than this (or turned by more than `apart_rad`) are two."""
    inflation: float
    """Of the covariance by the residuals' information: what errs alike is not independent."""
    alike: float
    """A place of the own map of which so much agrees is like the one that was matched."""
    apart_rad: float = 0.1


def verdict(places: list[Judged], own: Strewn, needs: Needs) -> Joined | NotFound:
    """Return where the map lies, if that is sure, else why it is not."""
    if not places:
        return NotFound("no place has enough overlap")
    ranked = sorted(places, key=lambda place: (bool(place.contradiction), -place.evidence))
    best = ranked[0]
    rivals = [
        place
        for place in ranked[1:]
        if not place.contradiction and is_elsewhere(best, place, own, needs)
    ]
    # Where residuals are larger than the maps state, so is what they leave unsure.
    covariance = needs.inflation * max(1.0, best.fit.misfit) * best.fit.covariance
    worst_m = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    worst_rad = math.sqrt(float(covariance[3, 3]))
    doubts = (
        (best.overlap_m2 < needs.overlap_m2, f"only {best.overlap_m2:.0f} m2 overlap"),
        (bool(best.contradiction), best.contradiction),
        (best.agreement < needs.agreement, f"only {best.agreement:.0%} agrees where it fits best"),
        (
            best.evidence < needs.evidence,
            f"too little speaks for the best place ({best.evidence:.0f} nats)",
        ),
        (worst_m > needs.sigma_m, f"it could be moved by {worst_m:.2f} m and fit as well"),
        (
            worst_rad > needs.sigma_rad,
            f"it could be turned by {math.degrees(worst_rad):.1f} deg and fit as well",
        ),
    )
    for is_so, why in doubts:
        if is_so:
            return NotFound(why)
    if rivals and rivals[0].evidence > needs.rival * best.evidence:
        share = rivals[0].evidence / best.evidence
        return NotFound(
            f"it may lie elsewhere too: another place has {share:.0%} of what speaks for it"
        )
    found = best.fit
    told = (
        f"{best.overlap_m2:.0f} m2 overlap, {best.agreement:.0%} of it agrees, to {worst_m:.2f} m"
    )
    origin = Pose(found.x_m, found.y_m, found.lift, wrap_angle(found.turn_rad))
    return Joined(origin, covariance, found.middle_m, told, best)


def is_elsewhere(one: Judged, other: Judged, own: Strewn, needs: Needs) -> bool:
    """Say whether two places are not the same one."""
    apart = one.fit.carried(own.middle_m[None]) - other.fit.carried(own.middle_m[None])
    turned = abs(wrap_angle(one.fit.turn_rad - other.fit.turn_rad))
    return bool(np.hypot(*apart[0]) > needs.apart_m or turned > needs.apart_rad)
