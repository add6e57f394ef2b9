"""How a pair of cameras moved, from the ground that it saw before and after (Fig. 14).

Fiducials are chosen (Eqs. 17, 18), followed, measured in both pairs, checked against each other,
and the motion is what Eqs. 10 to 13 make of those that agree (`pose.egomotion`). Where there is
no motion to be had, a `Step` says why.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Floats
from agents.pose.egomotion import Found, Tracks, find_motion
from agents.pose.rigidmotion import EgomotionError, Motion
from agents.stereo import tracks
from agents.stereo.calibration import Calibration
from agents.stereo.conditions import ill_conditions
from agents.stereo.fiducials import choose
from agents.stereo.spots import Frame, Spots, joined, measured, none, placing_noise

SPARE = 2.0
"""So many times what is wanted are chosen: not all have a depth to a tenth of a pixel."""
FEWEST = 5
"""Fiducials that must agree on a motion."""
LEAST_SHARE = 0.5
"""Share of the measured tracks that must."""
FIRST_SHARE = 0.25
"""Share that must before the later image is redrawn by the motion itself."""
BLIND = 0.1
"""Share of an image that must have a depth, or nothing is looked for in it."""
IN_VIEW = 0.2
"""Share of the earlier image that the later one must show."""


@dataclass(frozen=True)
class Step:
    """What two pairs told of a motion."""

    motion: Motion | None
    """Points of the camera frame before to that after (Eq. 10); None: see `reason`."""
    reason: str
    """Why there is no motion, or empty."""
    before_px: Floats
    """(n, 2) the fiducials that were looked for."""
    after_px: Floats
    """(n, 2) where they were found; NaN where they were not."""
    inliers: Bools
    """(n,) those that speak for the motion."""
    tracks: Tracks | None = None
    """These, measured in space before and after."""


@dataclass(frozen=True)
class _Told:
    """What one round of following gave."""

    motion: Motion | None
    reason: str
    there: Spots
    after_px: Floats
    inliers: Bools
    tracks: Tracks | None


class Odometer:
    """Tells each motion, from the pair before it to the pair after it; adds up nothing."""

    def __init__(self, calibration: Calibration, count: int, rng: np.random.Generator) -> None:
        """Follow up to `count` fiducials at a time."""
        self._calibration = calibration
        self._count = count
        self._rng = rng
        self._survivors = none()
        self.frame: Frame | None = None
        """The pair before."""

    def begin(self, frame: Frame | None) -> None:
        """Take a pair as the one before; None lets go of it."""
        self.frame = frame
        self._survivors = none()

    def step(self, after: Frame, predicted: Motion) -> Step:
        """Tell the motion to a later pair, which then is the one before.

        Fiducials are those that were followed before and stay in view as far as can be foretold,
        and fresh ones for the others.
        """
        assert self.frame is not None, "no pair before"
        before, former = self.frame, self._survivors
        self.begin(after)
        h = tracks.homography(
            predicted, tracks.mean_plane(before.matched, self._calibration), self._calibration
        )
        lasting = tracks.in_view(h, before.left.shape)
        if lasting.mean() < IN_VIEW:
            return _failed(f"moved or turned too far: the views share {lasting.mean():.0%}")
        stays = tracks.inside(self._predicted_px(former.points_m, predicted), after.left.shape)
        spots = self._filled(before, former.only(stays), lasting)
        told = _ill(before, after, spots)
        if told:
            return _failed(told, spots.pixels)
        best = self._followed(before, after, spots, predicted, FIRST_SHARE)
        if best.motion is not None:
            # Drawn by the motion itself windows look alike: more are followed, and better.
            best = self._followed(before, after, spots, best.motion, LEAST_SHARE)
        if best.motion is not None:
            self._survivors = best.there.only(best.inliers)
        return Step(
            best.motion, best.reason, spots.pixels, best.after_px, best.inliers, best.tracks
        )

    def _followed(
        self, before: Frame, after: Frame, spots: Spots, predicted: Motion, share: float
    ) -> _Told:
        """Follow spots, and tell the motion from those that keep together: a share at least."""
        c = self._calibration
        h = tracks.homography(predicted, tracks.mean_plane(before.matched, c), c)
        guess = self._predicted_px(spots.points_m, predicted)
        followed, stretch = tracks.follow_through(before.left, after.left, spots.pixels, guess, h)
        there, seen = measured(after, followed.pixels, c)
        kept = followed.found & seen
        kept[kept] = tracks.agreeing(spots.pixels[kept], followed.pixels[kept], c)
        noise = there.noise + placing_noise(before, spots.pixels, stretch, there.points_m, c)
        pairs = (
            Tracks(spots.points_m[kept], there.points_m[kept], spots.noise[kept], noise[kept])
            if kept.sum() >= FEWEST
            else None
        )
        inliers = np.zeros(len(kept), dtype=np.bool_)
        after_px = np.where(followed.found[:, None], followed.pixels, np.nan)
        if pairs is None:
            reason = (
                f"too few tracks: {int(kept.sum())} fiducials were followed, {FEWEST} are needed"
            )
            return _Told(None, reason, there, after_px, inliers, None)
        found, reason = self._agreed(pairs, share)
        if found is None:
            return _Told(None, reason, there, after_px, inliers, None)
        inliers[kept] = found.inliers
        agreed = pairs.only(found.inliers)
        motion = calibrated(found.motion, agreed.before_m, self._calibration)
        return _Told(motion, "", there, after_px, inliers, agreed)

    def _agreed(self, pairs: Tracks, share: float) -> tuple[Found | None, str]:
        """Return the motion and who agrees on it, or why there is none."""
        n = len(pairs.before_m)
        try:
            found = find_motion(pairs, self._rng)
        except EgomotionError as error:
            return None, f"the tracks agree on no motion: {error}"
        agree = int(found.inliers.sum())
        if agree < max(FEWEST, share * n):
            return None, f"the tracks agree on no motion: {agree} of {n} do"
        return found, ""

    def _predicted_px(self, points_m: Floats, motion: Motion) -> Floats:
        moved_m = motion.moved(points_m)
        ahead = moved_m[:, 2] > 1e-3
        moved_m[~ahead] = (-1e6, -1e6, 1.0)
        return self._calibration.pixels(moved_m)

    def _filled(self, frame: Frame, spots: Spots, allowed: Bools) -> Spots:
        """Return spots with fresh ones, where allowed (H, W), for those that are missing."""
        wanted = self._count - len(spots.pixels)
        if wanted <= 0:
            return spots
        fresh = choose(
            frame.left,
            frame.matched,
            math.ceil(SPARE * wanted),
            frame.noise_by_level,
            taken=spots.pixels,
            allowed=allowed,
        )
        new, seen = measured(frame, fresh.pixels, self._calibration)
        seen &= np.cumsum(seen) <= wanted
        return joined(spots, new.only(seen))


def _ill(before: Frame, after: Frame, spots: Spots) -> str:
    """Say why it need not be tried, or nothing."""
    blind = after.matched.density < BLIND
    for frame, is_poor in ((before, len(spots.pixels) < FEWEST), (after, blind)):
        told = ill_conditions(frame.left, frame.right, frame.matched) if is_poor else ()
        if told:
            return told[0]
    if len(spots.pixels) < FEWEST:
        return f"too few fiducials: {len(spots.pixels)} were found, {FEWEST} are needed"
    return ""


def calibrated(motion: Motion, points_m: Floats, c: Calibration) -> Motion:
    """Return a motion with what the calibration's errors add: the scale of all lengths."""
    depth_m = float(np.median(points_m[:, 2]))
    offset = depth_m / (c.focal_px * c.baseline_m) * c.offset_sigma_px
    share = c.baseline_sigma**2 + c.focal_sigma**2 + offset**2
    covariance = motion.covariance.copy()
    covariance[:3, :3] += share * np.outer(motion.translation_m, motion.translation_m)
    return Motion(motion.rotation, motion.translation_m, covariance)


def _failed(reason: str, pixels: Floats | None = None) -> Step:
    spots = np.zeros((0, 2)) if pixels is None else pixels
    return Step(None, reason, spots, np.full(spots.shape, np.nan), np.zeros(len(spots), np.bool_))
