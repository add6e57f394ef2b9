"""Grids of a run for the figure, taken from a robot that lives its run once more (`replay`)."""

import base64
import csv
import zlib
from pathlib import Path

import numpy as np

from agents.elevationmapper import ElevationMapper
from agents.geometry import Bools, Floats, Pose, Singles
from agents.outlook.base import Strategy
from agents.planning.looks import LookPlan
from agents.planning.scene import View
from agents.ports import Exposure
from scenarios.experiments.tables import Row
from scenarios.host import Host
from scenarios.replay import watch
from scenarios.stage import Stage
from sim.ground import Terrain

SHOWN_LOOK = 4
"""The look after those all round of which the expected and the acquired region are kept."""
LEVELS = 200


def watched(run: Path, out: Path, robot: str, looks: int, stage: Stage) -> list[Row]:
    """Return the grids of a run's robot after so many looks, and those of one look before.

    `known` cells, `interest`, and of one look `expected` and `acquired`; `ground` and `poor` of
    the truth.
    """
    terrain = stage.terrain
    assert isinstance(terrain, Terrain)
    times = [float(row["t_s"]) for row in _looks(run) if row["robot"] == robot][:looks]
    watcher = _Watcher()
    watch(run, robot, out, watcher.meet, until_s=times[-1])
    kept = {
        "known": watcher.known.astype(np.float64),
        "interest": watcher.interest,
        **watcher.regions,
        "ground": _scaled(terrain.elevation_m.astype(np.float64)),
        "poor": (terrain.texture < 0.3).astype(np.float64),
    }
    return [_row(name, grid, stage) for name, grid in kept.items()]


def _looks(run: Path) -> list[dict[str, str]]:
    with (run / "looks.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def _scaled(heights_m: Floats) -> Floats:
    low, high = float(np.nanmin(heights_m)), float(np.nanmax(heights_m))
    return np.nan_to_num((heights_m - low) / max(high - low, 1e-6))


def _row(name: str, grid: Floats, stage: Stage) -> Row:
    """Return a grid (H, W) in [0, 1] as a row of plain values."""
    terrain = stage.terrain
    levels = np.rint(grid * LEVELS).astype(np.uint8)
    data = base64.b64encode(zlib.compress(levels.tobytes(), 9)).decode()
    frame = terrain.frame
    west, east, south, north = frame.extent_m
    return {
        "grid": name,
        "rows": frame.rows,
        "cols": frame.cols,
        "west_m": west,
        "east_m": east,
        "south_m": south,
        "north_m": north,
        "data": data,
    }


def grid_of(row: Row) -> Floats:
    """Return the grid (H, W) in [0, 1] of a row; row 0 is the south."""
    levels = np.frombuffer(zlib.decompress(base64.b64decode(str(row["data"]))), np.uint8)
    return levels.reshape(int(row["rows"]), int(row["cols"])) / LEVELS


class _Watcher:
    """Stands between a robot and its strategy and log, and notes what passes."""

    def __init__(self) -> None:
        self.known: Bools = np.zeros((0, 0), dtype=np.bool_)
        self.interest: Floats = np.zeros((0, 0))
        self.regions: dict[str, Floats] = {}
        self._looks = 0

    def meet(self, host: Host) -> None:
        """Take the place of a robot's strategy and of its log."""
        self._host = host
        mapper = host.robot.mapper
        assert isinstance(mapper, ElevationMapper)
        self._mapper = mapper
        self._strategy: Strategy = mapper.strategy
        mapper.strategy = self
        host.robot.log = self

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Choose as the strategy does."""
        return self._strategy.choose(view, rng)

    def expect(self, view: View, pose: Pose, pan_rad: float, tilt_rad: float) -> Singles:
        """Expect as the strategy does, and note it."""
        chances = self._strategy.expect(view, pose, pan_rad, tilt_rad)
        if self._looks + 1 == self._mapper.settings.planner.first_looks + SHOWN_LOOK:
            self.regions["expected"] = (chances > 0.5).astype(np.float64)
            self.regions["before"] = (view.looks > 0).astype(np.float64)
        return chances

    def event(self, what: str, detail: str = "") -> None:
        """Pass on to the host."""
        self._host.event(what, detail)

    def look(
        self, exposure: Exposure, *, expected_cells: float, obtained_cells: int, new_cells: int
    ) -> None:
        """Note the map after a look."""
        self._looks += 1
        robot = self._host.robot
        self.known = robot.team.fused().known.copy()
        self.interest = self._mapper.interest.share.copy()
        if self._looks == self._mapper.settings.planner.first_looks + SHOWN_LOOK:
            acquired = np.zeros(self.known.shape)
            cells = robot.settings.frame.cells_of(robot.pose.team_from_robot(exposure.points_m))
            inside = ((cells >= 0) & (cells < np.array(acquired.shape))).all(axis=1)
            acquired[cells[inside, 0], cells[inside, 1]] = 1.0
            self.regions["acquired"] = acquired
        self._host.look(
            exposure,
            expected_cells=expected_cells,
            obtained_cells=obtained_cells,
            new_cells=new_cells,
        )
