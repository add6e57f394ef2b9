"""What is known of a rectified pair of cameras: enough to turn disparity into points.

Camera frame: x right, y down, z along the optical axis, origin at the left camera; metres. Pixels:
u to the right, v down, whole numbers at pixel centres. Disparity: u in the left image less u in
the right one.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.errors import AgentError
from agents.geometry import Floats


class CalibrationError(AgentError):
    """Numbers that no pair of cameras can have."""


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A rectified pair: one focal length, rows that match, a baseline along the rows.

    Raises CalibrationError where a size, a length or a sigma is impossible.
    """

    width_px: int
    height_px: int
    focal_px: float
    cx_px: float
    """Principal point of the left image."""
    cy_px: float
    baseline_m: float
    doffs_px: float = 0.0
    """The right image's principal point less the left one's, along the row."""
    focal_sigma: float = 0.001
    """Standard deviation of the focal length, as a share of it."""
    baseline_sigma: float = 0.001
    """The same of the baseline."""
    offset_sigma_px: float = 0.03
    """Standard deviation of what all disparities have in common wrong (the cameras' vergence)."""

    def __post_init__(self) -> None:
        """Refuse what is impossible."""
        for name in ("width_px", "height_px", "focal_px", "baseline_m"):
            value = float(getattr(self, name))
            if not (math.isfinite(value) and value > 0):
                raise CalibrationError(f"{name} is {value:g}, must be a finite number above 0")
        for name in ("focal_sigma", "baseline_sigma", "offset_sigma_px"):
            value = float(getattr(self, name))
            if not (math.isfinite(value) and value >= 0):
                raise CalibrationError(f"{name} is {value:g}, must be a finite number, 0 or above")
        for name in ("cx_px", "cy_px", "doffs_px"):
            if not math.isfinite(float(getattr(self, name))):
                raise CalibrationError(f"{name} is {getattr(self, name)}, must be finite")

    @property
    def matrix(self) -> Floats:
        """(3, 3) of the left camera: pixel = matrix @ point, up to scale."""
        f = self.focal_px
        return np.array([[f, 0.0, self.cx_px], [0.0, f, self.cy_px], [0.0, 0.0, 1.0]])

    def depth_m(self, disparity_px: Floats) -> Floats:
        """Return the depth along the optical axis; inf where there is no parallax left."""
        sum_px = np.asarray(disparity_px, dtype=np.float64) + self.doffs_px
        with np.errstate(divide="ignore"):
            depth = self.focal_px * self.baseline_m / sum_px
        return np.where(sum_px > 0, depth, np.where(np.isnan(sum_px), np.nan, np.inf))

    def disparity_px(self, depth_m: float) -> float:
        """Return the disparity of what lies at a depth."""
        return self.focal_px * self.baseline_m / depth_m - self.doffs_px

    def pixels(self, points_m: Floats, right: bool = False) -> Floats:
        """Return where points (N, 3) of the left camera's frame appear, (N, 2) of (u, v)."""
        x, y, z = points_m[:, 0], points_m[:, 1], points_m[:, 2]
        u = self.cx_px + self.focal_px * x / z
        if right:
            u = self.cx_px + self.doffs_px + self.focal_px * (x - self.baseline_m) / z
        return np.column_stack((u, self.cy_px + self.focal_px * y / z))


def pinhole(width_px: int, height_px: int, fov_deg: float, baseline_m: float) -> Calibration:
    """Return a pair with its principal points in the middle, by its horizontal field of view."""
    return Calibration(
        width_px=width_px,
        height_px=height_px,
        focal_px=width_px / 2 / math.tan(math.radians(fov_deg) / 2),
        cx_px=(width_px - 1) / 2,
        cy_px=(height_px - 1) / 2,
        baseline_m=baseline_m,
    )
