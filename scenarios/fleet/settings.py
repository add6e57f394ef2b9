"""What every robot of a fleet has, and how large it is."""

from dataclasses import dataclass

from agents.settings import DriveSettings, MapSettings, SensorSettings
from comms.linksettings import ProfileName

CHEAP_SENSOR = SensorSettings(columns=12, rows=8, fov_deg=110.0, range_m=3.0, look_s=10.0)
SURE_DRIVE = DriveSettings(
    speed_mps=0.1, turn_rate_radps=0.3, footprint_m=0.5, slip_sigma=0.0, slip_bias_sigma=0.0
)
COARSE_MAP = MapSettings(cell_m=0.25, tile_cells=16)


@dataclass(frozen=True)
class FleetSettings:
    """How large a fleet is, and how far it hears and cares."""

    robots: int
    spacing_m: float = 6.0
    """Between neighbours at the start; the ground grows with the fleet."""
    radio_m: float = 9.0
    """Radio range."""
    horizon_m: float | None = 6.0
    """`sharing.horizon_m`; None: everything is for everybody."""
    region_m: float | None = 22.0
    """A robot keeps the ground so far to each side of its start; None: all of it. It has to hold
    what it can hear of: radio range, horizon, and the way that it goes itself."""
    seed: int = 1
    profile: ProfileName = "uhf-9600"
    sensor: SensorSettings = CHEAP_SENSOR
    drive: DriveSettings = SURE_DRIVE
    map: MapSettings = COARSE_MAP
