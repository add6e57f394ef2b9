"""What a run has kept of a robot: its team map at the end, and its ways."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path

from agents.geometry import Pose
from scenarios.errors import StudyError
from scenarios.formats.maps import place_of
from scenarios.logs import diary
from scenarios.logs.diary import Chart
from scenarios.ros2.bag import notes_of
from scenarios.schema import Scenario, load


class NothingKeptError(StudyError):
    """A robot of which the run has kept nothing that could be written."""


@dataclass(frozen=True)
class Place:
    """Where the world's frame lies on a planet."""

    east_m: float = 0.0
    north_m: float = 0.0
    """Of the frame's origin, in the CRS."""
    crs: str | None = None
    """None: nowhere; the frame is the world's own."""


@dataclass
class Kept:
    """What is kept of one robot."""

    run: Path
    robot: str
    scenario: Scenario
    place: Place
    newest: Chart | None = None
    true: dict[int, Pose] = field(default_factory=dict[int, Pose])
    """Where it was, by time in ns."""
    believed: dict[int, Pose] = field(default_factory=dict[int, Pose])
    """Where it believed to be, at the times at which it stood."""

    @property
    def chart(self) -> Chart:
        """Its team map at the end of its last life.

        Raises:
            NothingKeptError: its logs hold none.

        """
        if self.newest is None:
            raise NothingKeptError(
                f"{self.run}: {self.robot}'s log holds no map; only a run by this version or a"
                " later one keeps maps, and a robot that never lived has none"
            )
        return self.newest


def keepsakes(run: Path) -> dict[str, Kept]:
    """Return what is kept of each robot of a run, by name.

    Raises:
        StudyError: this is no run.

    """
    notes = notes_of(run)
    scenario = load(str(run / "scenario.toml"))
    place = _place(scenario)
    found: dict[str, Kept] = {}
    for robot, told in notes.items():
        kept = found[robot] = Kept(run, robot, scenario, place)
        for note in told:
            if note.topic == diary.TEAM_MAP:
                kept.newest = diary.draw(kept.newest, note.data)
            elif note.topic == diary.POSE:
                pose = diary.read_pose(note.data)
                kept.true[note.t_ns] = pose.true
                if pose.still:
                    kept.believed[note.t_ns] = pose.believed
    return found


def _place(scenario: Scenario) -> Place:
    """Return the place of the file that the ground was read from, where it has one and is here.

    Ground that was read at another scale lies nowhere.
    """
    terrain = scenario.world.terrain
    if not terrain.file or terrain.cell_m is not None or scenario.map.kind != "elevation":
        return Place()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        origin_m, crs = place_of(Path(terrain.file))
    return Place() if origin_m is None or crs is None else Place(*origin_m, crs)
