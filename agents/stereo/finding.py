"""A landmark of known geometry, found in what a pair of cameras measured.

What stands on the ground and is about as large is a candidate. From each, turned every way, the
cloud is registered to the landmark's surface (GICP, by small_gicp); the best is then refined in
place and heading, with each point's own sigma. It is taken for the landmark only if the points lie
on its surface, if the camera did not see through what should be there, if enough of it was seen,
and if no other pose says the same.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import small_gicp
from scipy import ndimage
from scipy.spatial import KDTree

from agents.fusion import symmetric
from agents.geometry import Bools, Floats, Ints, wrap_angle
from agents.stereo.shape import Shape

GRID_M = 0.2
"""Cells in which things that stand out are looked for."""
STANDS_SHARE = 0.25
"""What is higher over the ground about it than this share of the shape may be a part of it."""
SKIRT_M = 0.15
"""Points under such a part are its too, down to this height."""
WORST_M = 0.15
"""Points that are less sure than this along their ray tell no shape."""
FEWEST_POINTS = 80
MOST_POINTS = 1500
HEADINGS = 12
REACH_M = 0.6
"""Points farther from the surface than this don't draw."""
NEAR_M = 0.06
"""A point this near to the surface, and two of its sigmas, lies on it."""
LEAST_ON = 0.7
"""Share of a candidate's points that must lie on the surface."""
LEAST_SHOWN = 0.7
"""Of the surface that was either seen or seen through this share must have been seen. Where nothing
was measured (too dark, too plain) nothing is known."""
LEAST_SEEN = 0.4
"""Share of the surface that the camera should see of which it must have seen points."""
LEAST_FACING = 0.15
"""Of less than this share of the surface being seen, the rest of it counts as not seen."""
ALIKE = 0.93
"""A second pose that scores more than this share of the best makes both unsure."""
NEARLY = 1.1
"""Of poses that are nearly one, those whose points lie off by no more than this times the best."""
APART_M, APART_RAD = 0.3, math.radians(20.0)
"""Poses that differ by less are one."""
LEANING_RAD = math.radians(45.0)
"""GICP may lean by this on its way; a landmark stands upright, and is set so."""
BIN_RAD = math.radians(1.5)
"""Of surface points in one direction only the nearest are seen."""
BEHIND_M = 0.12
GROUND_M = 0.6
"""A landmark's foot is no farther than this from the ground about it."""
ROUNDS = 15
SHARED = 4.0
"""Neighbouring points come out of one another's windows: so many count as one."""
FLOOR_M, FLOOR_RAD = 0.006, math.radians(0.4)
"""Least sigmas, for what points' own don't tell: edges that stereo rounds off. These three were set
by 24 rendered landers; `benchmarks/landmarks.py` tells how well they do on others."""


@dataclass(frozen=True)
class Found:
    """Where a landmark stands, in the frame of the points."""

    foot_m: Floats
    """(3,)"""
    yaw_rad: float
    covariance: Floats
    """(4, 4) of (x, y, z, yaw), without what all points have in common wrong: the calibration."""
    on: float
    """Share of the candidate's points that lie on it."""
    shown: float
    """Share of what was seen or seen through of it that was seen."""


@dataclass(frozen=True)
class NotFound:
    """There is no landmark, as far as can be told."""

    reason: str
    """Empty where nothing is there that could have been it."""


@dataclass(frozen=True)
class _Fit:
    foot_m: Floats
    yaw_rad: float
    on: float
    shown: float
    seen: float
    off_m: float
    """Mean distance of its points from the surface, of each `NEAR_M` at most."""
    information: Floats

    @property
    def score(self) -> float:
        # A rock may be taken for one small part of it: who explains more of it is likelier.
        return self.on * self.shown * math.sqrt(self.seen)


class _Rays:
    """How far a camera measured in each direction, in bins of `BIN_RAD`."""

    def __init__(self, points_m: Floats, eye_m: Floats) -> None:
        self._eye_m = eye_m
        bins, range_m = _directions(points_m - eye_m)
        self._near_m = np.full((_TURNS, _RISES), np.inf)
        np.minimum.at(self._near_m, (bins[:, 0], bins[:, 1]), range_m)

    def through(self, points_m: Floats, by_m: float) -> Bools:
        """Say through which points (N, 3) the camera saw what lies beyond, by some distance."""
        bins, range_m = _directions(points_m - self._eye_m)
        near_m = self._near_m[bins[:, 0], bins[:, 1]]
        return np.isfinite(near_m) & (near_m > range_m + by_m)


class Finder:
    """Looks for one landmark."""

    def __init__(self, shape: Shape) -> None:
        """Make a landmark's surface ready."""
        self.shape = shape
        self._tree = KDTree(shape.points_m)
        self._target = small_gicp.PointCloud(shape.points_m)
        self._target_tree = small_gicp.KdTree(self._target)
        small_gicp.estimate_covariances(self._target, self._target_tree)

    def find(self, points_m: Floats, sigma_m: Floats, eye_m: Floats) -> Found | NotFound:
        """Return where the landmark stands among points (N, 3), z up, seen from an eye (3,).

        `sigma_m` (N,) is along each ray.
        """
        fits: list[_Fit] = []
        sure = sigma_m <= WORST_M
        points_m, sigma_m = points_m[sure], sigma_m[sure]
        rays = _Rays(points_m, eye_m)
        for chosen, ground_m in candidates(points_m, self.shape):
            thin = np.flatnonzero(chosen)
            thin = thin[:: max(1, len(thin) // MOST_POINTS)]
            fits += self._fits(points_m[thin], sigma_m[thin], eye_m, ground_m, rays)
        if not fits:
            return NotFound("")
        fits.sort(key=lambda fit: -fit.score)
        # Of poses that are nearly one, the closest to the points.
        alike = [fit for fit in fits if not _apart(fits[0], fit)]
        best = min(alike, key=lambda fit: fit.off_m)
        if best.on < LEAST_ON or best.shown < LEAST_SHOWN or best.seen < LEAST_SEEN:
            return NotFound(
                f"nothing in sight has its shape: {best.on:.0%} of the points of the likeliest"
                f" thing lie on it, {best.seen:.0%} of it was seen, and {1 - best.shown:.0%} of"
                " what was looked at was seen through"
            )
        for other in fits[1:]:
            if _apart(best, other) and other.score > ALIKE * best.score:
                return NotFound("two poses of it look alike from here")
        floor = np.diag([FLOOR_M**2] * 3 + [FLOOR_RAD**2])
        covariance = symmetric(
            SHARED * np.linalg.inv(best.information) + floor + _spread(best, alike)
        )
        return Found(best.foot_m, best.yaw_rad, covariance, best.on, best.shown)

    def _fits(
        self, points_m: Floats, sigma_m: Floats, eye_m: Floats, ground_m: float, rays: _Rays
    ) -> Sequence[_Fit]:
        """Return how the landmark fits a candidate, from every heading."""
        # Among low points is much ground, which would draw the start to where it was seen best.
        standing_m = points_m[points_m[:, 2] - ground_m > _low_m(self.shape)]
        if len(standing_m) < FEWEST_POINTS / 2:
            return []
        source = small_gicp.PointCloud(standing_m)
        small_gicp.estimate_covariances(source, small_gicp.KdTree(source))
        middle = standing_m.mean(axis=0)
        away = middle[:2] - eye_m[:2]
        # What is seen is its near side: its middle lies somewhat behind.
        middle[:2] += 0.3 * self.shape.radius_m * away / max(float(np.linalg.norm(away)), 1e-6)
        centre = self.shape.points_m.mean(axis=0)
        fits: list[_Fit] = []
        for k in range(HEADINGS):
            yaw_rad = 2 * math.pi * k / HEADINGS
            foot_m = np.append(middle[:2] - (_turn(yaw_rad) @ centre)[:2], ground_m)
            starts = [(foot_m, yaw_rad), self._registered(source, foot_m, yaw_rad)]
            for start in starts:
                if start is not None:
                    fit = self._refined(points_m, sigma_m, eye_m, *start, rays)
                    if fit is not None and self._near(fit.foot_m, foot_m):
                        fits.append(fit)
        return fits

    def _near(self, foot_m: Floats, guess_m: Floats) -> bool:
        """Say whether a foot is where the candidate stands, on its ground."""
        apart = foot_m - guess_m
        aside_m = float(np.hypot(apart[0], apart[1]))
        return aside_m < self.shape.radius_m and abs(float(apart[2])) < GROUND_M

    def _registered(
        self, source: Any, foot_m: Floats, yaw_rad: float
    ) -> tuple[Floats, float] | None:
        """Return foot and heading after GICP from a guess; None where it lies on its side."""
        guess = np.eye(4)
        guess[:3, :3] = _turn(-yaw_rad)
        guess[:3, 3] = -_turn(-yaw_rad) @ foot_m
        found: Any = small_gicp.align(
            self._target,
            source,
            self._target_tree,
            guess,
            registration_type="GICP",
            max_correspondence_distance=REACH_M,
            num_threads=1,
        )
        to_shape = np.asarray(found.T_target_source, dtype=np.float64)
        back = np.asarray(np.linalg.inv(to_shape), dtype=np.float64)
        if not np.isfinite(back).all() or back[2, 2] < math.cos(LEANING_RAD):
            return None
        return back[:3, 3], math.atan2(float(back[1, 0]), float(back[0, 0]))

    def _refined(
        self,
        points_m: Floats,
        sigma_m: Floats,
        eye_m: Floats,
        foot_m: Floats,
        yaw_rad: float,
        rays: _Rays,
    ) -> _Fit | None:
        """Return the fit of place and heading to points by their sigmas (point to plane)."""
        information = np.zeros((4, 4))
        for _ in range(ROUNDS):
            turn = _turn(yaw_rad)
            local = (points_m - foot_m) @ turn
            distance, nearest = self._tree.query(local)
            off_m = local - self.shape.points_m[nearest]
            normal = self.shape.normals[nearest]
            along = np.asarray((off_m * normal).sum(axis=1))
            spread = _sigma_across(points_m, sigma_m, eye_m, normal @ turn.T)
            counts = (distance < REACH_M) & (local[:, 2] > 2 * SKIRT_M)
            weight = counts / (spread**2 * (1 + (along / (2 * spread)) ** 2))
            lever = points_m - foot_m
            world = normal @ turn.T
            jacobian = np.column_stack(
                (world, world[:, 1] * lever[:, 0] - world[:, 0] * lever[:, 1])
            )
            information = (jacobian * weight[:, None]).T @ jacobian
            if np.linalg.cond(information) > 1e9:
                return None
            step = np.linalg.solve(information, (jacobian * weight[:, None]).T @ along)
            foot_m, yaw_rad = foot_m + step[:3], wrap_angle(yaw_rad + float(step[3]))
        return self._scored(points_m, sigma_m, eye_m, foot_m, yaw_rad, information, rays)

    def _scored(
        self,
        points_m: Floats,
        sigma_m: Floats,
        eye_m: Floats,
        foot_m: Floats,
        yaw_rad: float,
        information: Floats,
        rays: _Rays,
    ) -> _Fit:
        turn = _turn(yaw_rad)
        local, eye = (points_m - foot_m) @ turn, (eye_m - foot_m) @ turn
        # What is low may be the ground about it, which says nothing for it and nothing against it.
        high = local[:, 2] > _low_m(self.shape)
        off_m = self._tree.query(local[high])[0]
        on = off_m <= NEAR_M + 2 * sigma_m[high]
        facing = self.shape.points_m[visible(self.shape, eye)]
        reach_m = NEAR_M + 2 * float(np.median(sigma_m))
        seen = KDTree(local).query(facing)[0] <= reach_m
        through = ~seen & rays.through(facing @ turn.T + foot_m, 2 * reach_m)
        # A pose from which next to nothing of it could be seen is not shown by that.
        most = max(len(facing), LEAST_FACING * len(self.shape.points_m))
        share = float(seen.sum()) / max(float((seen | through).sum()), 1.0)
        return _Fit(
            foot_m,
            yaw_rad,
            float(on.mean()) if high.any() else 0.0,
            share,
            float(seen.sum()) / most,
            float(np.minimum(off_m, NEAR_M).mean()) if high.any() else NEAR_M,
            information,
        )


def candidates(points_m: Floats, shape: Shape) -> list[tuple[Bools, float]]:
    """Return what stands out of the ground and may be a shape: its points (N,), and its ground."""
    if len(points_m) < FEWEST_POINTS:
        return []
    low = points_m[:, :2].min(axis=0)
    cell = np.floor((points_m[:, :2] - low) / GRID_M).astype(np.int64)
    size = cell.max(axis=0) + 1
    floor = np.full(tuple(size), np.inf)
    np.minimum.at(floor, (cell[:, 0], cell[:, 1]), points_m[:, 2])
    wide = 2 * math.ceil(shape.radius_m / GRID_M) + 3
    lowest = np.asarray(ndimage.grey_erosion(floor, wide))
    # Where nothing was seen nothing is known: it neither lowers the ground nor lifts it.
    ground = np.asarray(ndimage.grey_dilation(np.where(np.isfinite(lowest), lowest, -np.inf), wide))
    height = points_m[:, 2] - ground[cell[:, 0], cell[:, 1]]
    stands = height > _low_m(shape)
    marked = np.zeros(tuple(size), dtype=np.bool_)
    marked[cell[stands, 0], cell[stands, 1]] = True
    joined = ndimage.binary_dilation(marked, iterations=2)
    labels = np.asarray(cast("tuple[Any, int]", ndimage.label(joined))[0])
    mine = np.where(height > SKIRT_M, labels[cell[:, 0], cell[:, 1]], 0)
    found: list[tuple[Bools, float]] = []
    for label in range(1, int(labels.max(initial=0)) + 1):
        chosen = mine == label
        if chosen.sum() < FEWEST_POINTS:
            continue
        span_m = float(np.linalg.norm(np.ptp(points_m[chosen, :2], axis=0)))
        if not 0.4 * shape.radius_m <= span_m <= 3.0 * shape.radius_m:
            continue
        row, col = cell[chosen, 0], cell[chosen, 1]
        found.append((chosen, float(np.median(ground[row, col]))))
    return found


def _low_m(shape: Shape) -> float:
    """Return the height over the ground below which ground may be taken for a shape."""
    return max(STANDS_SHARE * shape.height_m, 2 * SKIRT_M)


def visible(shape: Shape, eye_m: Floats) -> Bools:
    """Say which points (M,) of a surface an eye (3,) in its frame can see, about."""
    ray = shape.points_m - eye_m
    range_m = np.linalg.norm(ray, axis=1)
    facing = (shape.normals * ray).sum(axis=1) < -0.17 * range_m
    bins, _ = _directions(ray)
    nearest_m = np.full((_TURNS, _RISES), np.inf)
    np.minimum.at(nearest_m, (bins[:, 0], bins[:, 1]), range_m)
    return facing & (range_m <= nearest_m[bins[:, 0], bins[:, 1]] + BEHIND_M)


_TURNS, _RISES = (math.ceil(span / BIN_RAD) + 1 for span in (2 * math.pi, math.pi))


def _directions(rays_m: Floats) -> tuple[Ints, Floats]:
    """Return the bins (N, 2) of azimuth and elevation angle of rays (N, 3), and their lengths."""
    range_m = np.linalg.norm(rays_m, axis=1)
    turn = np.arctan2(rays_m[:, 1], rays_m[:, 0]) + math.pi
    rise = np.arcsin(np.clip(rays_m[:, 2] / np.maximum(range_m, 1e-9), -1, 1)) + math.pi / 2
    return np.rint(np.column_stack((turn, rise)) / BIN_RAD).astype(np.int64), range_m


def _sigma_across(points_m: Floats, sigma_m: Floats, eye_m: Floats, normals: Floats) -> Floats:
    """Return the standard deviation (N,) of points along a surface's normals, 2 cm at least."""
    ray = points_m - eye_m
    share = np.abs((ray * normals).sum(axis=1)) / np.linalg.norm(ray, axis=1)
    return np.sqrt((sigma_m * share) ** 2 + 0.02**2)


def _apart(one: _Fit, other: _Fit) -> bool:
    turned = abs(wrap_angle(one.yaw_rad - other.yaw_rad)) > APART_RAD
    return turned or float(np.linalg.norm(one.foot_m - other.foot_m)) > APART_M


def _spread(best: _Fit, alike: Sequence[_Fit]) -> Floats:
    """Return the mean square (4, 4) of how far poses lie off that say nearly the same as the best.

    Refinement may end at several of them: which one is right the points do not say.
    """
    close = [fit for fit in alike if fit.off_m <= NEARLY * best.off_m]
    apart = np.array(
        [[*(fit.foot_m - best.foot_m), wrap_angle(fit.yaw_rad - best.yaw_rad)] for fit in close]
    )
    return apart.T @ apart / len(close)


def _turn(yaw_rad: float) -> Floats:
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
