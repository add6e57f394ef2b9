"""What can be set about light and lens."""

from typing import Annotated

from pydantic import Field

from comms.settings import Settings

NotNegative = Annotated[float, Field(ge=0)]


class LightSettings(Settings):
    """The sun, the sky, and what they fall on."""

    sun_azimuth_deg: Annotated[float, Field(ge=-360, le=360)] = 120.0
    """Where the sun stands, counter-clockwise from east."""
    sun_elevation_deg: Annotated[float, Field(ge=0, le=90)] = 40.0
    sun: Annotated[float, Field(ge=0, le=10)] = 1.0
    """Strength of the sun; 1 is full daylight, 0 is none."""
    sky: Annotated[float, Field(ge=0, le=10)] = 0.25
    """Strength of the light that comes from the whole sky, shadows included."""
    ground_albedo: Annotated[float, Field(gt=0, le=1)] = 0.3


class LensSettings(Settings):
    """How light becomes grey levels, and what is not quite as calibrated."""

    blur_px: Annotated[float, Field(ge=0, le=5)] = 0.5
    """Standard deviation of the lens's blur."""
    target_dn: Annotated[float, Field(ge=10, le=250)] = 140.0
    """Mean grey level that the exposure is set for."""
    longest_exposure: Annotated[float, Field(gt=0, le=1e6)] = 20.0
    """Longest exposure, in those of full daylight: with less light images get dark."""
    full_well: Annotated[float, Field(ge=100, le=1e6)] = 12_000.0
    """Electrons of a white pixel: the fewer, the more shot noise."""
    read_noise: Annotated[float, Field(ge=0, le=1e4)] = 25.0
    """Electrons of noise of a pixel without light."""
    vergence_sigma_px: Annotated[float, Field(ge=0, le=5)] = 0.03
    """Standard deviation of the right camera's error of aim, both ways; one draw per camera. It is
    what the calibration does not know."""
