"""What can be set about a pair of cameras that really see."""

from typing import Annotated

from pydantic import Field

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
