"""What can be set about a pair of cameras that really see."""

from typing import Annotated

from pydantic import Field

from agents.stereo.calibration import Calibration, pinhole
from comms.settings import Settings


class StereoSettings(Settings):
    """A rectified pair of grey cameras, for `sensor.kind = "stereo"`.

    `sensor.fov_deg` is its horizontal field of view, `near_m` and `range_m` bound the depth; what
    the range camera's noise keys say does not count, noise comes out of the images.
    """

    width_px: Annotated[int, Field(ge=64, le=4096)] = 640
    height_px: Annotated[int, Field(ge=64, le=4096)] = 480
    baseline_m: Annotated[float, Field(ge=0.01, le=2)] = 0.3
    stride_px: Annotated[int, Field(ge=1, le=32)] = 4
    """Every so many pixels of every so many rows a point is taken."""
    odometry: bool = True
    """Takes each leg's motion from the ground seen before and after it, where that works."""
    glance_s: Annotated[float, Field(gt=0, le=600)] = 3.0
    """Simulated seconds that a pair for this takes."""
    glance_tilt_deg: Annotated[float, Field(ge=-80, le=0)] = -25.0
    """Tilt at which it is taken."""
    glance_binning: Annotated[int, Field(ge=1, le=4)] = 2
    """So many pixels a side are read as one for it."""
    fiducials: Annotated[int, Field(ge=8, le=500)] = 60
    """So many spots of the ground are followed."""

    def glanced(self) -> "StereoSettings":
        """Return the pair as a glance reads it."""
        small = {
            side: getattr(self, side) // self.glance_binning for side in ("width_px", "height_px")
        }
        return self.model_copy(update=small)


def glance_calibration(fov_deg: float, stereo: StereoSettings) -> Calibration:
    """Return the calibration of a pair as a glance reads it; `fov_deg` is its horizontal view."""
    small = stereo.glanced()
    return pinhole(small.width_px, small.height_px, fov_deg, stereo.baseline_m)
