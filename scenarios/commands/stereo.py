"""`ropeteam stereo`: two images to depth, as a robot's eyes do it."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.commands.parsing import OK, Commands, whole

if TYPE_CHECKING:
    from agents.stereo.calibration import Calibration
    from agents.stereo.matching import Grey, Matched

EXAMPLES = """\
examples:
  ropeteam stereo left.png right.png
  ropeteam stereo left.png right.png --max-disparity 96 --disparity disparity.npy
  ropeteam stereo left.png right.png --calibration pair.json --out cloud.ply
"""
_HELP = """\
Matches a rectified pair of images: the disparity of every pixel of the left one, in pixels, where
both images agree on one, and a coloured picture of it. With a calibration also points, each with
its covariance, and the noise law (Eq. 4 of the paper) that they follow.

A calibration is a .json with focal_px, cx_px, cy_px, baseline_m (and doffs_px), a calib.txt as of
Middlebury (baseline in mm), a KITTI calib file (P0 and P1, or P2 and P3), or a .yml/.xml of OpenCV
with P1 and P2.
"""


def add(commands: Commands) -> None:
    """Add the command."""
    stereo = commands.add_parser(
        "stereo",
        help="two images to depth",
        description=_HELP,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    stereo.add_argument("left", metavar="LEFT", help="left image of a rectified pair")
    stereo.add_argument("right", metavar="RIGHT", help="right image")
    stereo.add_argument("--calibration", metavar="FILE", help="of the pair; points need it")
    stereo.add_argument(
        "--max-disparity", type=whole, metavar="N", help="largest searched (found by itself)"
    )
    stereo.add_argument(
        "--min-disparity", type=whole, default=0, metavar="N", help="smallest searched (0)"
    )
    stereo.add_argument(
        "--disparity", metavar="OUT.npy", help="write disparities: float32, px, NaN where unmatched"
    )
    stereo.add_argument("--out", metavar="CLOUD.ply", help="write points: m, sigma, grey")
    stereo.add_argument(
        "--picture", metavar="OUT.png", help="coloured picture (LEFT's name with -depth.png)"
    )
    stereo.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from agents.stereo.matching import MatchSettings, PairError, match
    from agents.stereo.span import largest_disparity
    from scenarios.formats import stereo as files

    left, right = files.read_grey(args.left), files.read_grey(args.right)
    calibration = _calibration(args, left)
    try:
        most = args.max_disparity
        if most is None:
            most = max(largest_disparity(left, right), args.min_disparity + 16)
        settings = MatchSettings(max_disparity_px=most, min_disparity_px=args.min_disparity)
        matched = match(left, right, settings)
    except PairError as error:
        raise files.StereoError(f"{args.left}, {args.right}: {error}") from error
    picture = Path(args.picture or Path(args.left).stem + "-depth.png")
    files.write_picture(picture, matched.disparity_px)
    _tell(left, right, matched, most)
    print(f"picture: {picture}")
    if args.disparity is not None:
        files.write_disparity(args.disparity, matched.disparity_px)
        print(f"disparity: {args.disparity}")
    if calibration is not None:
        _points(args, left, matched, calibration)
    return OK


def _calibration(args: argparse.Namespace, left: "Grey") -> "Calibration | None":
    from scenarios.errors import UsageError
    from scenarios.formats.stereo import read_calibration

    if args.calibration is None:
        if args.out is not None:
            raise UsageError(f"--out {args.out}: points need a calibration; add --calibration FILE")
        return None
    height, width = left.shape
    return read_calibration(args.calibration, width, height)


def _tell(left: "Grey", right: "Grey", matched: "Matched", most: int) -> None:
    from agents.stereo.conditions import ill_conditions

    height, width = left.shape
    print(f"{width} x {height} px, disparities up to {most} px: {matched.density:.1%} matched")
    for reason, share in matched.lost.items():
        print(f"  {share:6.1%} {reason}")
    for ill in ill_conditions(left, right, matched):
        print(f"  {ill}")


def _points(
    args: argparse.Namespace, left: "Grey", matched: "Matched", calibration: "Calibration"
) -> None:
    import numpy as np

    from agents.stereo.points import cloud, fit_range_law
    from scenarios.formats.stereo import write_cloud

    found = cloud(matched, calibration)
    depth_m = found.points_m[:, 2]
    if depth_m.size < 2:
        print("no points")
    else:
        low, middle, high = np.quantile(depth_m, (0.01, 0.5, 0.99))
        print(f"{depth_m.size} points, depth {low:.2f} to {high:.2f} m, median {middle:.2f} m")
        law = fit_range_law(found)
        print(
            f"sigma = S T L^n (Eq. 4): S {law.s:.2g}, n {law.n:.2f}, T across {law.t_right:.2f}"
            f" and down {law.t_down:.2f}; fits to {law.residual:.0%}"
        )
    if args.out is not None:
        write_cloud(args.out, found, left)
        print(f"points: {args.out}")
