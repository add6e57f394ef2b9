"""A greedy oracle that knows the ground: what any way to choose looks is set beside.

It is offered the places that a robot's own rules would let it drive to if it knew all ground, goes
to any of them at no cost, and takes the look that shows most unmapped cells of those that can be
ranged at all; headings and tilts as fine as ours. It then really looks, with the same camera, from
its true pose. It does not look ahead, so a cleverer one could do a little better. It ranges, also
where the robots see by stereo.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Pose
from agents.maps.elevationlook import bin_look
from agents.outlook.survey import Look, Survey
from agents.planning.scene import Scene, View
from scenarios.dice import dice
from scenarios.schema import MAPPERS, Scenario
from scenarios.stage import Stage, set_stage
from sim.camera import expose
from sim.ground import Footing, Terrain
from sim.scene import BLIND_TEXTURE, scene_of

SIGMA_M = 0.005
PLACES = 400


@dataclass(frozen=True)
class Told:
    """What an oracle mapped."""

    first_cells: int
    """By the looks all round."""
    new_cells: list[int]
    """By each look after them."""


def explore(scenario: Scenario, looks: int) -> Told:
    """Return what the oracle maps in so many looks after those all round."""
    eyes = _Eyes(scenario)
    first = [eyes.look(eyes.start, pan, tilt) for pan, tilt in _all_round(scenario)]
    scene = Scene(eyes.view())
    survey = Survey(scene)
    cells = [(int(row), int(col)) for row, col in scene.candidates]
    sites = [survey.site(cell) for cell in cells]
    new: list[int] = []
    for _ in range(looks):
        worth = survey.joined((eyes.rangeable & ~eyes.known).astype(np.float64))
        found = [survey.best(site, worth) for site in sites]
        best = int(np.argmax([look.gain for look in found]))
        look: Look = survey.refined(sites[best], worth, found[best])
        pose = eyes.standing(cells[best], look.heading_rad)
        new.append(eyes.look(pose, 0.0, look.tilt_rad))
    return Told(sum(first), new)


def _all_round(scenario: Scenario) -> list[tuple[float, float]]:
    planner = scenario.planner
    pans = np.linspace(0.0, 2.0 * math.pi, planner.first_looks, endpoint=False)
    return [(float(pan), math.radians(planner.first_tilt_deg)) for pan in pans]


class _Eyes:
    """A camera on the true ground, and which cells it has measured."""

    def __init__(self, scenario: Scenario) -> None:
        stage: Stage = set_stage(scenario)
        assert isinstance(stage.terrain, Terrain)
        self.terrain = stage.terrain
        self.frame = self.terrain.frame
        self._scenario = scenario
        self._name = next(n for n, r in scenario.robots.items() if r.role in MAPPERS)
        self.start = stage.starts[self._name]
        self._mates = {n: p for n, p in stage.starts.items() if n != self._name}
        self._scene = scene_of(self.terrain)
        drive = scenario.drive
        self._footing = Footing(self.terrain, drive.footprint_m, drive.wheel_m)
        self._rng = dice(scenario, self._name, "camera")
        self.known: Bools = np.zeros(self.frame.shape, dtype=np.bool_)
        self.rangeable: Bools = (self.terrain.texture > BLIND_TEXTURE) & np.isfinite(
            self.terrain.elevation_m
        )

    def standing(self, cell: tuple[int, int], heading_rad: float) -> Pose:
        """Return the pose of a robot that looks ahead from a cell; at its start, of that place."""
        x_m, y_m = self.frame.centre_of(*cell)
        if cell == self.frame.cell_of(self.start.x_m, self.start.y_m):
            x_m, y_m = self.start.x_m, self.start.y_m
        return Pose(x_m, y_m, self._footing.ground_m(x_m, y_m), heading_rad)

    def look(self, pose: Pose, pan_rad: float, tilt_rad: float) -> int:
        """Look; return how many new cells that measures."""
        sensor = self._scenario.sensor
        exposure = expose(
            self._scene, sensor, pose, pan_rad, tilt_rad, others=self._mates, rng=self._rng
        )
        cells = bin_look(
            exposure, pose, self.frame, attitude_sigma_rad=0.0, extra_variance=(0, 0, 0, 0)
        )
        before = int(self.known.sum())
        self.known[cells.rows, cells.cols] = True
        return int(self.known.sum()) - before

    def view(self) -> View:
        """Return what a planner would see that knew all ground."""
        scenario, shape = self._scenario, self.frame.shape
        return View(
            frame=self.frame,
            elevation_m=self.terrain.elevation_m.astype(np.float64),
            sigma_m=np.full(shape, SIGMA_M),
            looks=np.zeros(shape, dtype=np.int64),
            interest=np.ones(shape),
            pose=self.start,
            pose_sigma_m=0.0,
            others=list(self._mates.values()),
            sensor=scenario.sensor,
            drive=scenario.drive,
            planner=scenario.planner.model_copy(update={"max_candidates": PLACES}),
            claims=[],
        )
