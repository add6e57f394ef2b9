"""A voxel view worked out: where one can go, what rays may pass, what is worth seeing."""

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats, Ints, Singles
from agents.occupancy.passing import StopPrior, stop_share
from agents.occupancy.view import Means
from agents.planar.sensing import MAPPED
from agents.voxel.casting import Matter, Star, star_of
from agents.voxel.frame import CUBE, Packed
from agents.voxel.ground import FREE, SOLID, UNKNOWN, Build, Ground, States, corners_of, way_back
from agents.voxel.markov import relaxed
from agents.voxel.view import VoxelView

PRIOR = StopPrior(0.05)
BELOW = np.array((-1, 0, 0))
STANDS = 1.6
"""Cells within half its footprint and so many more are taken for floor, where nothing was measured:
no camera sees what is under the robot."""


class Scene:
    """What follows from a view; everything is worked out when it is first asked for."""

    def __init__(self, view: VoxelView, means: Means) -> None:
        """Take a view, and what the robot has."""
        self.view = view
        self.means = means
        blocks = {*view.map.cubes, *view.interest, *self._stance_blocks()}
        self.packed = Packed(view.frame, sorted(blocks))

    # --- the map, block after block -----------------------------------------------------------

    @cached_property
    def log_odds(self) -> Singles:
        """(blocks, 16, 16, 16) of occupancy; 0 where nothing was measured."""
        odds = {block: cube.log_odds for block, cube in self.view.map.cubes.items()}
        return self.packed.stacked(odds, np.float32)

    @cached_property
    def mapped(self) -> NDArray[np.bool_]:
        """(blocks, 16, 16, 16) cells whose occupancy is off by more than 0.4 from 0.5."""
        return np.abs(self.log_odds) > MAPPED

    def mapped_at(self, cells: Ints) -> NDArray[np.bool_]:
        """Say which cells (N, 3) of the frame are mapped."""
        number = self.packed.index[tuple((cells // CUBE[0]).T)]
        return (number >= 0) & self.mapped[(number, *(cells % CUBE[0]).T)]

    @cached_property
    def interest(self) -> Singles:
        """(blocks, 16, 16, 16) weight of each cell's worth (Eq. 9)."""
        return self.packed.stacked(self.view.interest, np.float32, absent=1.0)

    @cached_property
    def occupancy_p(self) -> Singles:
        """(blocks, 16, 16, 16) probability of occupancy; where unmeasured the Markov estimate."""
        p = (1.0 / (1.0 + np.exp(-self.log_odds))).astype(np.float32)
        return relaxed(self.packed.index, p, self.log_odds != 0, self.packed.corners)

    # --- going ----------------------------------------------------------------------------------

    @cached_property
    def build(self) -> Build:
        """The robot's size, in cells."""
        return Build.of(self.means.drive, self.means.sensor, self.view.frame.cell_m)

    @cached_property
    def here(self) -> tuple[int, int, int]:
        """The cell in which its wheels stand."""
        pose, frame = self.view.pose, self.view.frame
        return frame.voxel_of(pose.x_m, pose.y_m, pose.z_m + 0.5 * frame.cell_m)

    def _disc(self, cells: Ints, reach: float) -> Ints:
        """Return the cells (N, 3) of each one's layer whose columns lie within reach of it."""
        near = math.ceil(reach)
        off = np.arange(-near, near + 1)
        rows, cols = np.meshgrid(off, off, indexing="ij")
        inside = np.hypot(rows, cols) <= reach
        moves = np.column_stack(
            (np.zeros(inside.sum(), dtype=np.int64), rows[inside], cols[inside])
        )
        return (cells[:, None] + moves).reshape(-1, 3)

    def _column(self, cells: Ints) -> Ints:
        """Return the cells (N, 3) that a body on cells (N, 3) fills."""
        levels = range(self.build.tall)
        return np.concatenate([cells + np.array((level, 0, 0)) for level in levels])

    @cached_property
    def _stance(self) -> Ints:
        """(N, 3) cells that its body stands on here, and a little more, and stood on before."""
        here = self._disc(np.array([self.here]), self.build.reach + STANDS)
        return np.concatenate((here, self._disc(self.view.stood, self.build.reach + 0.5)))

    def _stance_blocks(self) -> set[tuple[int, int, int]]:
        cells = np.concatenate((self._stance + BELOW, self._column(self._stance)))
        return {(int(a), int(b), int(c)) for a, b, c in np.unique(cells // CUBE[0], axis=0)}

    @cached_property
    def charted(self) -> States:
        """(blocks, 16, 16, 16) what is mapped as free or solid, and nothing else."""
        states = np.where(self.mapped, np.where(self.log_odds > 0, SOLID, FREE), UNKNOWN)
        return states.astype(np.int8)

    @cached_property
    def states(self) -> States:
        """(blocks, 16, 16, 16) what is mapped as free or solid, and where the robot stands."""
        states = self.charted.copy()
        stood = self.view.stood
        self._set(states, stood + BELOW, SOLID, anyway=True)
        self._set(states, self._column(stood), FREE, anyway=True)
        self._set(states, self._stance + BELOW, SOLID, anyway=False)
        self._set(states, self._column(self._stance), FREE, anyway=False)
        return states

    def _set(self, states: States, cells: Ints, state: int, *, anyway: bool) -> None:
        """Set cells (N, 3), those of which something is known only if that does not matter."""
        room = np.array(self.view.frame.voxels)
        cells = cells[((cells >= 0) & (cells < room)).all(axis=1)]
        number = self.packed.index[tuple((cells // CUBE[0]).T)]
        at = (number, *(cells % CUBE[0]).T)
        states[at] = state if anyway else np.where(states[at] == UNKNOWN, state, states[at])

    @cached_property
    def ground(self) -> Ground:
        """Where it can stand."""
        return Ground(self.packed.index, self.states, self.packed.corners, self.build)

    @cached_property
    def place(self) -> int:
        """The number of the place where it stands; `ground.AWAY` where the map forbids it."""
        return self.ground.place_at(*self.here, self.build.climb + 1)

    @cached_property
    def _field(self) -> tuple[Floats, Ints]:
        if self.place < 0:
            count = len(self.ground.cells)
            return np.full(count, np.inf), np.full(count, -1, dtype=np.int64)
        return self.ground.field(self.place)

    @property
    def way_m(self) -> Floats:
        """(places,) length of the way to each in metres; inf where none leads."""
        return self._field[0] * self.view.frame.cell_m

    def way(self, place: int) -> Ints:
        """Return the cells (N, 3) on the way to a place; its own where it stays."""
        if place in (self.place, -1):
            return np.array([self.here], dtype=np.int64)
        return self.ground.cells[way_back(self._field[1], place)]

    def path_m(self, way: Ints) -> Floats:
        """Return the corners (N, 2) of a way over cells (N, 3), from where the robot stands."""
        here = np.array([[self.view.pose.x_m, self.view.pose.y_m]])
        if len(way) < 2:
            return here
        return np.concatenate((here, self.view.frame.centres_m(corners_of(way)[1:])[:, :2]))

    def candidates(self, rng: np.random.Generator) -> Ints:
        """Return the places (N,) where a look may be taken: the robot's own, then a sample.

        They lie on a lattice of `candidate_step_m` with an offset drawn by lot; of more than
        `max_candidates` as many are drawn. -1 is its own where the map forbids that.
        """
        planner, cells = self.means.planner, self.ground.cells
        step = max(1, round(planner.candidate_step_m / self.view.frame.cell_m))
        offset = rng.integers(step, size=2)
        fits = np.isfinite(self.way_m) & ((cells[:, 1:] + offset) % step == 0).all(axis=1)
        places = np.flatnonzero(fits)
        places = places[places != self.place]
        if len(places) > planner.max_candidates - 1:
            places = np.sort(rng.choice(places, planner.max_candidates - 1, replace=False))
        return np.concatenate((np.array([self.place]), places))

    def everywhere(self) -> Ints:
        """Return its own place and one of each square of `candidate_step_m` and layer (N,).

        What is worth no look from any of them is worth none: no lattice or lot leaves them out.
        """
        step = max(1, round(self.means.planner.candidate_step_m / self.view.frame.cell_m))
        places = np.flatnonzero(np.isfinite(self.way_m))
        cells = self.ground.cells[places]
        square, within = np.divmod(cells[:, 1:], step)
        aside = ((within - (step - 1) / 2) ** 2).sum(axis=1)
        order = np.argsort(aside, kind="stable")
        squares = np.column_stack((cells[:, 0] // step, square))
        _, first = np.unique(squares[order], axis=0, return_index=True)
        places = places[np.sort(order[first])]
        return np.concatenate((np.array([self.place]), places[places != self.place]))

    def way_to_m(self, places: Ints) -> Floats:
        """Return how far (N,) places are; -1, its own where the map forbids it, is here."""
        if not len(self.way_m):
            return np.zeros(len(places))
        return np.where(places < 0, 0.0, self.way_m[places])

    def eyes(self, places: Ints) -> Ints:
        """Return the cells (N, 3) in which the camera is at each of some places."""
        up = round(self.means.sensor.height_m / self.view.frame.cell_m - 0.5)
        here = np.array(self.here, dtype=np.int64)
        cells = np.array([here if n < 0 else self.ground.cells[n] for n in places])
        return cells + np.array([up, 0, 0])

    # --- seeing ---------------------------------------------------------------------------------

    @cached_property
    def star(self) -> Star:
        """The sensor's rays."""
        return star_of(self.means.sensor, self.means.planner, self.view.frame.cell_m)

    @cached_property
    def stop_p(self) -> float:
        """Probability that a step from a free cell is stopped by a solid one, on the map so far."""
        return stop_share(self.log_odds < 0, self.log_odds > 0, (1, 2, 3), PRIOR)

    @cached_property
    def through(self) -> Singles:
        """(blocks, 16, 16, 16) probability that a ray passes."""
        known = np.where(self.log_odds < 0, 1.0, 0.0)
        return np.where(self.log_odds != 0, known, 1.0 - self.stop_p).astype(np.float32)

    @cached_property
    def matter(self) -> Matter:
        """What rays meet, and what is worth seeing."""
        short = np.maximum(MAPPED + 1e-6 - np.abs(self.log_odds), 0.0)
        lacking = np.where(self.mapped, 0.0, short) * self.interest
        return Matter(
            self.packed.index,
            self.view.frame.voxels,
            self.through,
            lacking.astype(np.float32),
            (1.0 - self.stop_p, MAPPED),
        )
