"""What can be set about a robot: sensor, motion, map, planner, sharing.

The scenario file is made of these classes; a robot on real hardware reads the same ones.
"""

from typing import Annotated, Literal

from pydantic import Field

from agents.stereo.settings import StereoSettings
from comms.settings import Settings

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class MapSettings(Settings):
    """The map and the tiles in which it travels."""

    kind: Literal["elevation", "planar", "voxel"] = "elevation"
    """Heights of the ground (2.5-D), which places of a floor are occupied (2-D), or which cubes of
    space (3-D)."""
    cell_m: Annotated[float, Field(ge=0.01, le=10)] = 0.1
    """Cell size of every robot's elevation map; a planar or voxel one has `world.cell_m`."""
    tile_cells: Literal[16, 32, 64, 128] = 32
    """Side of the square tiles that are versioned and sent; of voxel maps, of cubes (at most
    64)."""
    max_error_m: Annotated[float, Field(ge=0.001, le=1)] = 0.05
    """Bound on the elevation error of a tile that was sent whole."""
    prior_sigma_m: Positive = 1.0
    """Standard deviation of a cell that nobody measured, for counting information."""
    matching: bool = True
    """Each look is held against the robot's own map, and corrects its pose by what fits."""


class SensorSettings(Settings):
    """A ranging camera on a pan/tilt arm (Eq. 4: sigma = S * T * L^n), or a pair of images."""

    kind: str = "range"
    """`range`: ranges with Eq. 4's noise, quick; `stereo`: pairs of images, matched for real
    (then `columns`, `rows` and the noise keys say nothing of what is measured)."""
    fov_deg: Annotated[float, Field(gt=1, le=170)] = 60.0
    """Horizontal field of view."""
    fov_vertical_deg: Annotated[float, Field(gt=1, le=120)] = 45.0
    near_m: NotNegative = 0.4
    range_m: Annotated[float, Field(gt=0, le=1000)] = 12.0
    """Depth of field: nothing is measured beyond."""
    height_m: Positive = 1.6
    """Height of the camera over the ground contact."""
    columns: Annotated[int, Field(ge=4, le=2000)] = 192
    rows: Annotated[int, Field(ge=4, le=2000)] = 144
    noise_s: NotNegative = 0.0008
    """S of Eq. 4, 1/m for n = 2: sigma along the ray at 1 m."""
    noise_t_lateral: NotNegative = 0.25
    """T of Eq. 4 across the ray, relative to T = 1 along it."""
    noise_n: Annotated[float, Field(ge=0, le=4)] = 2.0
    attitude_sigma_deg: NotNegative = 0.15
    """Error of the arm's levelling, one draw per look."""
    look_s: Positive = 15.0
    """Simulated seconds that one look takes, pointing and stereo included."""
    stereo: StereoSettings = StereoSettings()


class DriveSettings(Settings):
    """A slow four-wheeled rover."""

    speed_mps: Positive = 0.06
    turn_rate_radps: Positive = 0.15
    wheel_m: Positive = 0.2
    """Wheel diameter: the critical length of the paper's cliff edge and quadtree."""
    climb_m: Positive = 0.15
    """Highest rock or step that the wheels climb; whatever is higher is a hazard. Planners keep
    clear of all that they see to be higher than half a wheel."""
    footprint_m: Positive = 0.8
    """Diameter of the circle that the robot covers."""
    max_slope_deg: Annotated[float, Field(gt=0, lt=90)] = 25.0
    """Steepest ground that it drives on without a tether."""
    slip_sigma: NotNegative = 0.03
    """Standard deviation of the share of a drive that slips, per leg."""
    slip_bias_sigma: NotNegative = 0.01
    """The same, drawn once per robot."""
    odometry_sigma: NotNegative = 0.01
    """Odometry error along the way, per metre driven."""
    yaw_sigma_deg_per_m: NotNegative = 0.1
    yaw_sigma_deg_per_turn: NotNegative = 0.1
    """Heading error of one turn on the spot, per radian turned."""


class PlannerSettings(Settings):
    """Rating function of Eq. 23 and the candidate poses that it rates."""

    w_information: NotNegative = 1.0
    """w_NI, on new information as a share of the best candidate's."""
    w_distance: NotNegative = 0.25
    """w_d, on path length as a share of the sensor's range."""
    w_localisation: NotNegative = 0.1
    """w_LE, on the expected localisation error along the path, as a share of a cell."""
    n_max: Annotated[int, Field(ge=1)] = 2
    """n_max of Eq. 3, in looks: a cell measured in that many looks is worth nothing more."""
    beta: NotNegative = 1.0
    """beta of Eq. 9: how fast interest in cells that can't be measured is lost."""
    candidate_step_m: Positive = 0.8
    """Spacing of candidate positions."""
    headings: Annotated[int, Field(ge=1, le=360)] = 12
    """Headings tried at each candidate position."""
    tilts_deg: tuple[Annotated[float, Field(ge=-90, le=45)], ...] = (-15.0, -38.0)
    """Tilts tried at each heading."""
    max_candidates: Annotated[int, Field(ge=1)] = 150
    min_gain_cells: NotNegative = 250.0
    """Exploration is over when no look promises this many bits of Eq. 3 (one fresh cell: 1)."""
    first_looks: Annotated[int, Field(ge=1, le=36)] = 6
    """Looks all round, before the first is planned."""
    first_tilt_deg: Annotated[float, Field(ge=-90, le=45)] = -25.0
    """Their tilt, on elevation maps."""
    max_looks: Annotated[int, Field(ge=1)] = 200


class SharingSettings(Settings):
    """What a robot sends when its link falls free."""

    policy: str = "value"
    """What goes first; `raw` and `paper` are for comparison (`agents.sharing`)."""
    digest_share: Share = 0.04
    """Share of the link that the team's reports of what was heard may take."""
    status_s: Positive = 10.0
    """Least seconds between two statuses of a robot that moves."""
    horizon_m: Positive | None = None
    """What others measured farther off than this a robot does not pass on, and only team-mates
    that it has heard lately count (policies `value` and `latest-first`). For teams that are larger
    than their radios reach; left out, everything is for everybody."""


class TetherSettings(Settings):
    """Tethers between the Anchor-bots and the Cliff-bot."""

    rate_mps: Positive = 0.05
    command_timeout_s: Positive = 6.0
    """An anchor brakes by itself when no command came for so long."""
    max_length_m: Positive = 40.0
