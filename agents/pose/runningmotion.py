"""Mean and covariance of a motion over the points seen so far: Sujan & Meggiolaro, Eq. 13."""

import numpy as np

from agents.geometry import Floats
from agents.pose import rotations
from agents.pose.rigidmotion import checked, closed_form


class RunningMotion:
    """Mean and covariance of R and X over the estimates seen so far (Eq. 13).

    Rotations are averaged on SO(3), each new one a step of 1/(i+1) along the arc from the mean.
    As printed, the covariance takes the new mean twice and comes out too small (by half for two
    estimates); here it is that of the estimates seen, exactly so for X (Welford). It tells how
    far the estimates still wander; it is the error of one of them only where they are independent.
    """

    def __init__(self) -> None:
        """Begin with no estimate."""
        self.count = 0
        self.rotation = np.eye(3)
        """Mean R (3, 3)."""
        self.translation_m = np.zeros(3)
        """Mean X (3,)."""
        self.covariance = np.zeros((6, 6))
        """(6, 6) of (X, R) in metres and radians, as of a `Motion`."""

    def add(self, rotation: Floats, translation_m: Floats) -> None:
        """Take in one more estimate."""
        if self.count == 0:
            self.rotation = rotation
        apart = np.concatenate(
            (
                translation_m - self.translation_m,
                rotations.to_vector(rotation @ self.rotation.T),
            )
        )
        i = self.count
        self.count += 1
        self.translation_m = self.translation_m + apart[:3] / self.count
        self.rotation = rotations.from_vector(apart[3:] / self.count) @ self.rotation
        scatter = i / self.count * np.outer(apart, apart) if i else np.zeros((6, 6))
        self.covariance = (i * self.covariance + scatter) / self.count


def running_motion(
    before_m: Floats, after_m: Floats, weights: Floats | None = None
) -> RunningMotion:
    """Return the mean over the motions by the first 3, 4, ... n points (Eq. 13).

    Raises:
        EgomotionError: fewer than 3 points, or the first three lie on a line.
    """
    running = RunningMotion()
    for count in range(3, checked(before_m, after_m, 3) + 1):
        part = None if weights is None else weights[:count]
        running.add(*closed_form(before_m[:count], after_m[:count], part))
    return running
