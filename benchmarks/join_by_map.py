"""Does a late-comer find its map on the team's, and never where it is not?

    python benchmarks/join_by_map.py [CASES [WORLD ...]]

Per world, so many seeded cases: a team's map and a late-comer's, from two to 30 m apart, many
without any overlap. Enough is 30 % of the late-comer's map and 80 m2. A place is wrong where it is
off by more than two cells or three degrees. NEES is the squared error of (x, y, z, yaw) in units of
the stated covariance; of (x, y, yaw) on floors.
"""

import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from join_cases import Case, floor, floor_case, ground, ground_case
from scipy.stats import chi2

from agents.geometry import Floats, wrap_angle
from agents.joining import Joined, placed
from agents.joining.searching import turning

SHARED = Path(os.environ.get("ROPETEAM_SHARED", Path(__file__).parents[2] / "shared"))
GROUNDS = ("plain", "cliff", "marsyard", "ames yard", "gale crater", "hinwil", "ripples", "flat")
FLOORS = (
    "hall", "building", "willow_garage_0p05", "ut_gdc_floor3_0p05", "ut_gdc_floor2_0p05",
    "offices", "empty",
)  # fmt: skip
ENOUGH, ENOUGH_M2 = 0.3, 80.0
"""Share of the late-comer's map that the team knows, and m2, from which on it should be found."""
SEEDS = 5000
"""Cases are numbered from here: none was looked at when the numbers of the method were chosen."""
APART_M = {"ground": (3.0, 6.0, 9.0, 30.0), "floor": (3.0, 8.0, 14.0, 45.0)}


@dataclass(frozen=True)
class Try:
    """What came of one case."""

    world: str
    seed: int
    overlap: float
    is_enough: bool
    found: bool
    wrong: bool
    nees: float
    error_m: float
    cpu_s: float
    told: str


def error_of(found: Joined, case: Case) -> Floats:
    """Return by how much (x, y, z, yaw) a place is off, in the middle of the overlap."""
    origin, truth = found.origin, case.truth
    own = turning(-origin.yaw_rad) @ (found.middle_m - (origin.x_m, origin.y_m))
    there = turning(truth.yaw_rad) @ own + (truth.x_m, truth.y_m)
    turn = wrap_angle(origin.yaw_rad - truth.yaw_rad)
    return np.array((*(found.middle_m - there), origin.z_m - truth.z_m, turn))


def tried(world: str, seed: int, case: Case, *, is_floor: bool) -> Try:
    """Match one pair of maps."""
    began = time.process_time()
    found = placed(case.own, case.team, case.frame)
    cpu_s = time.process_time() - began
    much = case.overlap >= ENOUGH and case.overlap_m2 >= ENOUGH_M2
    if not isinstance(found, Joined):
        return Try(world, seed, case.overlap, much, False, False, 0.0, 0.0, cpu_s, found.why)
    off = error_of(found, case)
    axes = [0, 1, 3] if is_floor else [0, 1, 2, 3]
    nees = float(off[axes] @ np.linalg.solve(found.covariance[np.ix_(axes, axes)], off[axes]))
    error_m = math.hypot(off[0], off[1])
    wrong = error_m > 2 * case.frame.cell_m or abs(off[3]) > math.radians(3.0)
    return Try(world, seed, case.overlap, much, True, wrong, nees, error_m, cpu_s, found.told)


def tries(world: str, count: int) -> Iterator[Try]:
    """Return what comes of so many cases on a world."""
    is_floor = world in FLOORS
    if is_floor:
        apart = APART_M["floor"]
        for seed in range(SEEDS, SEEDS + count):
            case = floor_case(floor(world, seed, SHARED), seed, apart[seed % len(apart)])
            yield tried(world, seed, case, is_floor=True)
        return
    apart = APART_M["ground"]
    for seed in range(SEEDS, SEEDS + count):
        case = ground_case(ground(world, seed, SHARED), seed, apart[seed % len(apart)])
        yield tried(world, seed, case, is_floor=False)


def row(name: str, done: list[Try], freedom: int) -> str:
    """Return a table's row: found by overlap, wrong ones, NEES, error and time."""
    much = [t for t in done if t.is_enough]
    some = [t for t in done if t.overlap >= 0.02 and not t.is_enough]
    none = [t for t in done if t.overlap < 0.02]
    right = [t for t in done if t.found and not t.wrong]

    def share(of: list[Try]) -> str:
        return f"{sum(t.found for t in of)} of {len(of)}"

    nees = rms = band = "-"
    if right:
        nees = f"{np.mean([t.nees for t in right]):.2f}"
        rms = f"{math.sqrt(np.mean([t.error_m**2 for t in right])):.3f}"
        low, high = (chi2.ppf(q, freedom * len(right)) / len(right) for q in (0.025, 0.975))
        band = f"{low:.2f} to {high:.2f}"
    cpu = max(t.cpu_s for t in done)
    wrong = sum(t.wrong for t in done)
    return (
        f"{name:<20}{share(much):>12}{share(some):>12}{share(none):>12}{wrong:>7}{nees:>7}"
        f"{band:>15}{rms:>8}{cpu:>7.2f}"
    )


def main(count: int, worlds: tuple[str, ...], say: Callable[[str], None] = print) -> None:
    """Print the table; with ROPETEAM_JOIN_ALL set, each case too."""
    say(
        f"{'world':<20}{'enough':>12}{'less':>12}{'none':>12}{'wrong':>7}{'NEES':>7}"
        f"{'95 % band':>15}{'rms, m':>8}{'CPU, s':>7}"
    )
    for group, freedom in ((GROUNDS, 4), (FLOORS, 3)):
        every: list[Try] = []
        for world in (w for w in group if w in worlds):
            done: list[Try] = []
            for one in tries(world, count):
                done.append(one)
                if "ROPETEAM_JOIN_ALL" in os.environ:
                    say(
                        f"  {one.world} {one.seed}: overlap {one.overlap:.2f}"
                        f" {'WRONG ' if one.wrong else ''}{'found' if one.found else 'not'}"
                        f" {one.error_m:.2f} m NEES {one.nees:.1f} {one.cpu_s:.2f} s: {one.told}"
                    )
            say(row(world, done, freedom))
            every += done
        if every:
            say(row("all", every, freedom))


if __name__ == "__main__":
    main(
        int(sys.argv[1]) if len(sys.argv) > 1 else 20,
        tuple(sys.argv[2:]) or (*GROUNDS, *FLOORS),
    )
