"""The file of a robot that runs by itself: who it is, its team, its radio, its hardware."""

import json
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from agents.geometry import GridFrame
from agents.settings import (
    DriveSettings,
    MapSettings,
    PlannerSettings,
    SensorSettings,
    SharingSettings,
    TetherSettings,
)
from comms.frames import MAX_KEY_BYTES, MAX_TEAM, MIN_KEY_BYTES
from comms.linksettings import TeamLinks
from comms.settings import Settings
from scenarios.errors import ScenarioError
from scenarios.schema import Name, Role
from scenarios.schema.problems import sentences

EPOCH = "2026-01-01T00:00:00+00:00"


class RouterSettings(Settings):
    """The Zenoh router at which the team meets."""

    endpoint: str
    """tls/ADDRESS:PORT, or tcp/127.0.0.1:PORT on one computer."""
    keys: str = ""
    """Folder of ca.pem, NAME.pem and NAME.key; needed for tls."""


class GridSettings(Settings):
    """The team's grid, in the team's frame; the same for all."""

    x_m: float = 0.0
    y_m: float = 0.0
    rows: Annotated[int, Field(ge=4, le=20_000)]
    cols: Annotated[int, Field(ge=4, le=20_000)]


class TeamSettings(Settings):
    """Who belongs to the team; the same, in the same order, in every robot's file."""

    key_file: str
    """File of the team's key: 16 to 32 bytes, which sign every frame."""
    roles: Annotated[dict[Name, Role], Field(min_length=1, max_length=MAX_TEAM)]
    grid: GridSettings
    goal_m: tuple[float, float] | None = None
    """Where a Cliff-bot is to go."""
    epoch: str = EPOCH
    """Instant from which the team counts its time (ISO 8601); clocks need to agree to seconds."""


class StartSettings(Settings):
    """Where the robot believes to stand when it starts, and how sure that is."""

    x_m: float
    y_m: float
    z_m: float = 0.0
    yaw_deg: float = 0.0
    sigma_m: Annotated[float, Field(gt=0)] = 0.02
    sigma_deg: Annotated[float, Field(gt=0)] = 0.25


class HardwareSettings(Settings):
    """The driver of the robot's body."""

    driver: str
    """Name of an entry point of the group `ropeteam.hardware`, or "module:function"."""
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)
    """What the driver wants to know."""


class AgentFile(Settings):
    """All that a robot by itself is told."""

    name: Name
    folder: str
    """Where it keeps its disk, its log and `status.json`."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    method: str = "information-interest"
    router: RouterSettings
    team: TeamSettings
    start: StartSettings
    hardware: HardwareSettings
    map: MapSettings = MapSettings()
    sensor: SensorSettings = SensorSettings()
    drive: DriveSettings = DriveSettings()
    planner: PlannerSettings = PlannerSettings()
    sharing: SharingSettings = SharingSettings()
    tether: TetherSettings = TetherSettings()
    links: TeamLinks = TeamLinks()
    clock: Literal["real"] = "real"

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.name not in self.team.roles:
            raise ValueError(f"name is {self.name!r}; team.roles has {', '.join(self.team.roles)}")
        try:
            epoch = datetime.fromisoformat(self.team.epoch)
        except ValueError:
            raise ValueError(f"team.epoch is {self.team.epoch!r}; must be like {EPOCH}") from None
        if epoch.tzinfo is None or epoch > datetime.now(UTC):
            raise ValueError(f"team.epoch is {self.team.epoch!r}; must be past, with its zone")
        return self

    @property
    def role(self) -> Role:
        """This robot's role."""
        return self.team.roles[self.name]

    @property
    def epoch_s(self) -> float:
        """The team's epoch as Unix time."""
        return datetime.fromisoformat(self.team.epoch).timestamp()

    @property
    def frame(self) -> GridFrame:
        """The team's grid."""
        grid = self.team.grid
        return GridFrame(grid.x_m, grid.y_m, self.map.cell_m, grid.rows, grid.cols)


def read_agent_file(path: Path) -> tuple[AgentFile, bytes]:
    """Return a robot's settings, with its paths made absolute, and the team's key.

    Raises:
        ScenarioError: with one sentence per problem.

    """
    try:
        tables: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScenarioError([f"{path}: can't be read: {error.strerror}"]) from error
    except ValueError as error:
        raise ScenarioError([f"{path}: is no TOML: {error}"]) from error
    try:
        # As JSON: strict about types, and lists are taken for tuples.
        file = AgentFile.model_validate_json(json.dumps(tables, default=str))
    except ValidationError as error:
        raise ScenarioError(sentences(error, AgentFile, lambda _: str(path))) from error
    beside = path.absolute().parent
    keys = str(beside / file.router.keys) if file.router.keys else ""
    file = file.model_copy(
        update={
            "folder": str(beside / file.folder),
            "router": file.router.model_copy(update={"keys": keys}),
        }
    )
    return file, _key(beside / file.team.key_file)


def _key(path: Path) -> bytes:
    try:
        key = path.read_bytes()
    except OSError as error:
        raise ScenarioError([f"team.key_file {path}: can't be read: {error.strerror}"]) from error
    if not MIN_KEY_BYTES <= len(key) <= MAX_KEY_BYTES:
        raise ScenarioError(
            [f"team.key_file {path}: has {len(key)} bytes; {MIN_KEY_BYTES} to {MAX_KEY_BYTES} are"]
        )
    return key
