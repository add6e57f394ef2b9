"""One look of a finished stereo run, as it was: images, disparity, points and fiducials.

Nothing of the images was kept. The robot lives its run once more, from its own log, up to that
look: the same true pose, the same light, the same noise.
"""

import csv
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from agents.geometry import Floats, Pose
from agents.pose.waywatch import Seen as Leg
from agents.stereo.calibration import Calibration
from agents.stereo.eyes import Seen, calibration_of
from agents.stereo.fiducials import choose
from agents.stereo.noise import noise_by_level
from agents.stereo.tags import corners
from comms.timebase import from_s
from scenarios.errors import UsageError
from scenarios.experiments.figure import save_figure
from scenarios.formats.stereo import depth_picture
from scenarios.host import Host
from scenarios.palette import MUTED
from scenarios.replay import watch
from scenarios.schema import load
from sim.stereo.camera import StereoCamera
from sim.stereo.shoot import Shot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TAG_COLOUR = "#ffe34d"
FIDUCIALS = 60
POINTS = 20_000
"""At most so many are drawn."""


@dataclass(frozen=True)
class OneLook:
    """A look, seen again."""

    robot: str
    number: int
    """Of the robot's looks, the first is 1."""
    shot: Shot
    seen: Seen
    pose: Pose
    """The true one, in the world's frame."""
    leg: Leg | None
    """The last leg that it watched before the look."""
    calibration: Calibration


def look_again(run: Path, robot: str, number: int) -> OneLook:
    """Return a look of a run's robot.

    Raises:
        StudyError: this is no run, no robot or no look of it, its eyes are no stereo cameras, or
            the run can't be replayed.

    """
    if not (run / "scenario.toml").is_file():
        raise UsageError(f"{run}: is no run: there is no scenario.toml in it")
    scenario = load(str(run / "scenario.toml"))
    kind = scenario.sensor.kind
    if kind != "stereo":
        raise UsageError(
            f"{run}: its robots saw with sensor.kind = {kind!r}, which has no images; must be a run"
            " with sensor.kind = 'stereo'"
        )
    if robot not in scenario.robots:
        team = ", ".join(scenario.robots)
        raise UsageError(f"--robot {robot}: there is no such robot; must be one of {team}")
    keeper = _Keeper(number)
    with tempfile.TemporaryDirectory(prefix="ropeteam-show-") as folder:
        watch(run, robot, Path(folder) / "again", keeper.meet, until_s=_time_s(run, robot, number))
    if keeper.kept is None:
        raise UsageError(f"--look {number}: {robot} took it in a later life, after a restart")
    calibration = calibration_of(scenario.sensor, scenario.sensor.stereo)
    return OneLook(robot, number, *keeper.kept, calibration)


def _time_s(run: Path, robot: str, number: int) -> float:
    try:
        with (run / "looks.csv").open(newline="") as file:
            times = [float(row["t_s"]) for row in csv.DictReader(file) if row["robot"] == robot]
    except (OSError, KeyError, ValueError) as error:
        raise UsageError(f"{run / 'looks.csv'}: can't be read ({error})") from error
    if not 1 <= number <= len(times):
        raise UsageError(f"--look {number}: {robot} took {len(times)} looks; must be 1 to that")
    return times[number - 1]


class _Keeper:
    """Counts a camera's looks, and keeps one."""

    def __init__(self, number: int) -> None:
        self.kept: tuple[Shot, Seen, Pose, Leg | None] | None = None
        self._number = number
        self._count = 0

    def meet(self, host: Host) -> None:
        """Stand behind a robot's camera."""
        camera = host.rig.hardware.camera
        if isinstance(camera, StereoCamera):
            self._host = host
            camera.kept = self.keep

    def keep(self, shot: Shot, seen: Seen) -> None:
        """Note a look."""
        self._count += 1
        if self._count == self._number:
            watch = self._host.robot.watch
            leg = None if watch is None else watch.seen
            self.kept = (shot, seen, self._host.true_pose(from_s(seen.exposure.t_s)), leg)


def save_picture(look: OneLook, path: Path) -> None:
    """Write a picture of a look: left image with tags, disparity, points from above, its error."""
    if path.suffix.lower() != ".png":
        raise UsageError(f"--out {path}: must be a .png")
    try:
        save_figure(path, lambda figure: _draw(figure, look))
    except OSError as error:
        raise UsageError(f"--out {path}: can't be written ({error.strerror})") from error


def _draw(figure: "Figure", look: OneLook) -> None:
    figure.set_size_inches(15, 16.5)
    exposure = look.seen.exposure
    figure.suptitle(
        f"{look.robot}, look {look.number}, at {exposure.t_s:.1f} s",
        x=0.012, ha="left", fontsize=16, fontweight="bold",
    )  # fmt: skip
    (image, disparity), (above, error), (spots, tracks) = figure.subplots(3, 2)
    _draw_image(image, look)
    _draw_disparity(disparity, look)
    _draw_points(above, look)
    _draw_error(error, look)
    _draw_spots(spots, look)
    _draw_tracks(tracks, look.leg)


def _draw_spots(axes: "Axes", look: OneLook) -> None:
    """Draw the fiducials that Eqs. 17 and 18 choose in this look, the better the larger."""
    left, right = look.shot.left, look.shot.right
    found = choose(left, look.seen.matched, FIDUCIALS, noise_by_level(left, right))
    axes.set_title(f"The {len(found.pixels)} best fiducials of {found.proposed} proposed")
    axes.imshow(left, cmap="gray", vmin=0, vmax=255)
    size = 20 + 60 * found.terms.sum(axis=1)
    axes.scatter(*found.pixels.T, s=size, facecolors="none", edgecolors=TAG_COLOUR)
    axes.set_axis_off()


def _draw_tracks(axes: "Axes", leg: Leg | None) -> None:
    """Draw how fiducials went through the image on the last leg before the look."""
    axes.set_axis_off()
    if leg is None:
        axes.set_title("No leg was watched before this look")
        return
    step = leg.step
    followed = np.isfinite(step.after_px[:, 0])
    axes.set_title(
        f"Last leg before: {len(followed)} fiducials, {followed.sum()} followed,"
        f" {step.inliers.sum()} agree{': ' + step.reason if step.reason else ''}"
    )
    axes.imshow(leg.after.left, cmap="gray", vmin=0, vmax=255)
    for kind, colour in ((step.inliers, TAG_COLOUR), (followed & ~step.inliers, "#d55e00")):
        for one, other in zip(step.before_px[kind], step.after_px[kind], strict=True):
            axes.plot([one[0], other[0]], [one[1], other[1]], color=colour, lw=1)
        axes.plot(*step.before_px[kind].T, "s", color=colour, ms=4, mfc="none")
        axes.plot(*step.after_px[kind].T, "o", color=colour, ms=4)


def _draw_image(axes: "Axes", look: OneLook) -> None:
    axes.set_title("Left image; tags that were found in it")
    axes.imshow(look.shot.left, cmap="gray", vmin=0, vmax=255)
    for number, quad in sorted(corners(look.shot.left).items()):
        ring = np.concatenate((quad, quad[:1]))
        axes.plot(ring[:, 0], ring[:, 1], color=TAG_COLOUR, lw=1.5)
        style: dict[str, Any] = {"color": TAG_COLOUR, "fontsize": 10}
        axes.annotate(f"{number}", tuple(quad.max(axis=0)), **style)
    axes.set_axis_off()


def _draw_disparity(axes: "Axes", look: OneLook) -> None:
    matched = look.seen.matched
    axes.set_title(f"Disparity: red near, blue far, grey none ({matched.density:.0%} matched)")
    axes.imshow(cv2.cvtColor(depth_picture(matched.disparity_px), cv2.COLOR_BGR2RGB))
    told = [f"{share:.1%} {reason}" for reason, share in matched.lost.items()]
    axes.set_xlabel("; ".join(told), fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])


def _draw_points(axes: "Axes", look: OneLook) -> None:
    exposure = look.seen.exposure
    points = exposure.points_m[:: max(1, len(exposure.points_m) // POINTS)]
    axes.set_title(f"{len(exposure.points_m):,} points from above, by height; team-mates by tag")
    dots = axes.scatter(points[:, 0], points[:, 1], c=points[:, 2], s=1.0, cmap="viridis")
    axes.figure.colorbar(dots, ax=axes, label="above the wheels, m", shrink=0.8)
    axes.plot(0, 0, "k^", ms=9)
    for mate in exposure.sightings:
        x, y, _ = mate.offset_m
        axes.plot(x, y, "s", color="#d55e00", ms=8)
        axes.annotate(f" {mate.name}", (x, y), color="#d55e00")
    for index, reason in enumerate(exposure.ill):
        axes.annotate(reason, (0.01, 0.97 - 0.05 * index), xycoords="axes fraction", fontsize=9)
    axes.set_aspect("equal")
    axes.set_xlabel("ahead, m")
    axes.set_ylabel("left, m")


def depth_errors(look: OneLook) -> tuple[Floats, Floats]:
    """Return true depths (N,) of matched pixels and by how much what was measured is longer, m."""
    disparity = look.seen.matched.disparity_px.astype(np.float64)
    true_m, c = look.shot.depth_m, look.calibration
    both = np.isfinite(disparity) & np.isfinite(true_m) & (disparity > 0)
    measured_m = c.focal_px * c.baseline_m / (disparity[both] + c.doffs_px)
    return true_m[both], measured_m - true_m[both]


def _draw_error(axes: "Axes", look: OneLook) -> None:
    axes.set_title("Error of depth against the truth: median and 95 % of pixels")
    axes.set_xlabel("true depth, m")
    axes.set_ylabel("m")
    axes.grid(color=MUTED, alpha=0.2)
    depth_m, error_m = depth_errors(look)
    edges = np.arange(0.0, math.ceil(float(depth_m.max())) + 1.0) if depth_m.size else np.zeros(0)
    middle: list[float] = []
    half: list[float] = []
    far: list[float] = []
    for low in edges:
        mine = np.abs(error_m[(depth_m >= low) & (depth_m < low + 1.0)])
        if mine.size > 50:
            middle.append(float(low) + 0.5)
            half.append(float(np.median(mine)))
            far.append(float(np.quantile(mine, 0.95)))
    axes.plot(middle, half, "o-", label="median")
    axes.plot(middle, far, "o--", label="95 %")
    axes.set_yscale("log")
    axes.legend()
