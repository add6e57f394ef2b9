"""What can be set about the world: the ground and the window that is taken of it."""

from typing import Annotated, Any, Self, cast

from pydantic import Field, model_validator

from comms.settings import Settings
from sim.stereo.settings import LightSettings
from sim.voxel.settings import CaveSettings

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")]
Metres = Annotated[float, Field(ge=4, le=5000)]


KINDS: dict[str, dict[str, float]] = {
    "sandpit": {
        "drop_m": 1.2, "slope_deg": 88.0, "lip_m": 0.05, "edge_meander_m": 1.2,
        "edge_wavelength_m": 9.0, "roughness_m": 0.04, "rock_fraction": 0.01, "rock_max_m": 0.6,
        "jumble_m": 1.6, "jumble_fraction": 0.35, "jumbles": 5, "texture_poor": 0.15,
    },
    "field": {
        "drop_m": 6.0, "slope_deg": 75.0, "edge_meander_m": 2.0, "rock_fraction": 0.05,
        "jumble_m": 3.5, "jumble_fraction": 0.35, "texture_poor": 0.08,
    },
}  # fmt: skip
"""What keys are that are left out, where that is not their default: the paper's two sites."""


class TerrainSettings(Settings):
    """Ground made from the seed (a cliff, a plain), or read from an elevation file."""

    kind: str = "cliff"
    """Made-up ground, used while `file` is empty. Two are a cliff with keys of their own: `sandpit`
    (a drop of 1.2 m, upright, rock piles in the pit, its west without texture) and `field` (75
    degrees with a rock jumble); whatever is given beside them counts."""
    file: str = ""
    """Elevation file: .npz (`elevation` in m, NaN unknown, `cell_size` in m, row 0 north), GeoTIFF,
    .asc (Esri's ASCII grid) or .png (with `grey_m` and `cell_m`). Where it is given, `kind` and the
    keys of made-up ground but `texture_poor` say nothing."""
    cell_m: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Reads the file's shapes at another scale: its cells are taken to be this large, and its
    heights are scaled alike, so that slopes stay. A .png has no scale of its own: this is it."""
    grey_m: Annotated[tuple[float, float] | None, Field(strict=False)] = None
    """Heights of the black and of the white of a .png, m."""
    drop_m: Annotated[float, Field(ge=0.5, le=200)] = 6.0
    """Height of the cliff."""
    slope_deg: Annotated[float, Field(ge=20, le=89)] = 45.0
    """Steepness of the cliff's face."""
    lip_m: Annotated[float, Field(ge=0.05, le=2)] = 0.25
    """Length over which the face bends at its lip and its foot."""
    edge_meander_m: Annotated[float, Field(ge=0, le=50)] = 2.5
    """How far the edge strays to either side of a straight line."""
    edge_wavelength_m: Annotated[float, Field(ge=2, le=500)] = 12.0
    """Longest bay and spur of the edge."""
    roughness_m: Annotated[float, Field(ge=0, le=5)] = 0.15
    """Fractal ground: standard deviation of its height over the whole window."""
    roughness_exponent: Annotated[float, Field(ge=2.5, le=5)] = 3.6
    """Power spectral density of the fractal ground falls with frequency to this power."""
    swell_m: Annotated[float, Field(ge=0, le=10)] = 0.4
    """Height of a plain's long swells, to either side of the mean."""
    swell_wavelength_m: Annotated[float, Field(ge=4, le=500)] = 14.0
    rock_fraction: Annotated[float, Field(ge=0, le=0.5)] = 0.04
    """k of Golombek's law: the share of the ground under rocks (Viking 1 0.07, Viking 2 0.18)."""
    rock_min_m: Annotated[float, Field(ge=0.05, le=5)] = 0.1
    """Smallest rock that is placed (diameter)."""
    rock_max_m: Annotated[float, Field(ge=0.05, le=5)] = 1.2
    jumble_m: Annotated[float, Field(ge=0, le=50)] = 3.0
    """Diameter of a rock jumble on the middle of the cliff's face; 0 for none."""
    jumble_fraction: Annotated[float, Field(ge=0, le=0.5)] = 0.25
    """k of Golombek's law in the rock jumble."""
    jumbles: Annotated[int, Field(ge=1, le=20)] = 1
    """Of more than one the rest are piles that lie about at the foot of the cliff."""
    texture_poor: Annotated[float, Field(ge=0, le=0.6)] = 0.04
    """Share of the ground, in one piece, that has too little texture to be ranged."""

    @model_validator(mode="before")
    @classmethod
    def _of_its_kind(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        given = cast("dict[str, Any]", given)
        return {**KINDS.get(str(given.get("kind")), {}), **given}

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.kind == "file" and not self.file:
            raise ValueError('kind "file" needs `file`, the path of an elevation file')
        if self.cell_m is not None and not self.file:
            raise ValueError("cell_m is the scale of a file; made-up ground takes map.cell_m")
        if self.grey_m is not None and not self.file.lower().endswith(".png"):
            raise ValueError("grey_m is for a .png; other files tell their heights themselves")
        if self.rock_min_m > self.rock_max_m:
            raise ValueError(
                f"rock_min_m is {self.rock_min_m:g}, allowed is at most rock_max_m"
                f" ({self.rock_max_m:g})"
            )
        return self


Topic = Annotated[str, Field(pattern=r"^(/?[A-Za-z][A-Za-z0-9_]*)+$")]


class RecordingSettings(Settings):
    """A recording that stands in for a robot's body and sensor, on elevation maps."""

    file: Annotated[str, Field(min_length=1)]
    """An MCAP file in the ROS 2 profile, a bag's .db3, or a bag's folder."""
    clouds: Topic | None = None
    """Topic of its point clouds; left out: the only one that there is."""
    images: Annotated[tuple[Topic, Topic] | None, Field(strict=False)] = None
    """Topics of rectified images, left and right, to be matched instead of clouds; their
    `camera_info` stands beside them."""
    poses: Topic | None = None
    """Topic of its poses (Odometry, PoseStamped, PoseWithCovarianceStamped); left out: the
    transforms tell where `base` is."""
    base: str = "base_link"
    """Frame of the robot, at its ground contact, where the poses name none."""
    every_s: NotNegative = 1.0
    """Looks that came sooner than this after the one before are left out."""
    drift: NotNegative = 1.0
    """How unsure its poses are of the way from one to another, as a share of what `drive` says of
    wheels; 0: they do not drift at all."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.clouds is not None and self.images is not None:
            raise ValueError("clouds and images are two kinds of looks: only one may be given")
        return self


class LandmarkSettings(Settings):
    """A thing whose place everybody knows: of a robot's size with its fiducials, or of a shape."""

    x_m: float
    y_m: float
    z_m: float | None = None
    """Height of its foot; left out: it stands on the ground."""
    yaw_deg: float = 0.0
    """Which way it faces, counter-clockwise from east."""
    mesh: str = ""
    """What stereo eyes know it by: `lander`, `solar-panel` or a CAD file (.stl, .obj, .ply, .off,
    .glb; metres, z up), matched to what they measure. Left out: a robot's fiducials."""


class WorldSettings(Settings):
    """The part of the world that is simulated: ground, or the floor of a building."""

    terrain: TerrainSettings = TerrainSettings()
    light: LightSettings = LightSettings()
    landmarks: Annotated[dict[Name, LandmarkSettings], Field(max_length=64)] = Field(
        default_factory=dict[Name, LandmarkSettings]
    )
    """By name: things by which a camera on rough ground tells where it is in the team's frame."""
    cave: CaveSettings = CaveSettings()
    window_m: Annotated[tuple[Metres, Metres], Field(strict=False)] = (32.0, 32.0)
    """Width (east) and height (north) of the window; a made-up floor is a square."""
    map: str = ""
    """A building's floor for planar maps: a map_server yaml, which names its image. What is unknown
    there counts as solid. Left out, a floor is made up from the seed."""
    cell_m: Annotated[float, Field(ge=0.05, le=10)] = 0.4
    """Cell size of a floor or a cave, and of the maps of it; a floor's cell is free where the mean
    of its block of the image is at least 192 of 254."""
    obstacle_share: Annotated[float, Field(ge=0, le=0.5)] = 0.15
    """Share of a made-up floor that is solid."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    """Of the made-up ground and of where the team stands on it; left out: the scenario's seed."""
