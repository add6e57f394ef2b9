"""Learn what the map codec's models know beforehand, and write it to `comms/prior_data.py`.

    python benchmarks/train_codec.py [comms/prior_data.py]

The ground is synthetic: fractal surfaces of many roughnesses with rocks, craters, slopes and
cliffs, seen from random places with the shadows that obstacles throw, with and without noise. A new
file is a new format: robots with different files do not understand one another.
"""

import itertools
import math
import sys
import textwrap
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comms import changecode, maskcode, priors, residuals, sigmachange, sigmacode
from comms.blocks import block_max
from comms.codec import decode_tile, encode_tile
from comms.logistic import Opinions
from comms.maskcode import KINDS, LEARNED_SLOTS, code_mask, mask_opinions
from comms.predict import TAP_SETS, TAPS
from comms.rangecoder import encoder
from comms.scales import bound_for
from comms.tilebase import encode_on
from comms.tilecode import rehearse, split_blocks
from comms.tilecode import write as write_tile
from comms.tilelevels import SIGMA_BLOCK, Head, Truth
from comms.tileplan import plan_levels
from comms.tiletypes import DecodedTile

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Rng = np.random.Generator

SIDE = 128
CELL_M = 0.1
GROUNDS = 36
SUCCESSIONS = 30
PASSES = 2
BOUNDS_M = (0.01, 0.02, 0.03, 0.05, 0.05, 0.1, 0.1, 0.25)
CROPS = {32: 8, 64: 5, 128: 2}


@dataclass(frozen=True)
class Job:
    elevation_m: Floats
    known: Bools
    sigma_m: Floats
    bound_m: float
    levels: int
    profile: int
    base: DecodedTile | None = None
    """The version before, for one that must not tell any cell less surely."""


@dataclass(frozen=True)
class Next:
    """A version that is built on the one before."""

    base: DecodedTile
    elevation_m: Floats
    known: Bools
    sigma_m: Floats
    bound_m: float


def fractal(rng: Rng) -> Floats:
    f = np.hypot(np.fft.fftfreq(2 * SIDE)[:, None], np.fft.rfftfreq(2 * SIDE)[None])
    f[0, 0] = np.inf
    noise = rng.normal(size=f.shape) + 1j * rng.normal(size=f.shape)
    z = np.fft.irfft2(noise * f ** (-(rng.uniform(1.6, 3.0) + 1) / 2))[:SIDE, :SIDE]
    return (z - z.mean()) * (10 ** rng.uniform(-1.2, 0.2) / z.std())


def distances(rng: Rng, margin_m: float = 0.0) -> tuple[Floats, Floats]:
    """East and north of a random place, to every cell, metres."""
    side_m = SIDE * CELL_M
    y, x = (np.mgrid[0:SIDE, 0:SIDE] + 0.5) * CELL_M
    east, north = rng.uniform(-margin_m, side_m + margin_m, 2)
    return x - east, y - north


def rocks(rng: Rng) -> Floats:
    """Half-ellipsoids; the area they cover falls off with size as Golombek and Rapp found."""
    k = rng.uniform(0.02, 0.25)
    q = 1.79 + 0.152 / k
    z = np.zeros((SIDE, SIDE))
    for low, high in itertools.pairwise(np.geomspace(0.15, 3, 30)):
        covered = k * (math.exp(-q * low) - math.exp(-q * high)) * (SIDE * CELL_M) ** 2
        for _ in range(rng.poisson(covered / (math.pi * (low + high) ** 2 / 16))):
            dx, dy = distances(rng)
            d, turn, squash = (
                rng.uniform(low, high),
                rng.uniform(0, math.pi),
                rng.uniform(0.8, 1.25),
            )
            u = (dx * math.cos(turn) + dy * math.sin(turn)) / (d / 2 * squash)
            v = (dy * math.cos(turn) - dx * math.sin(turn)) / (d / 2 / squash)
            height = d * rng.uniform(0.3, 0.6)
            z = np.maximum(z, height * np.sqrt(np.clip(1 - u * u - v * v, 0, None)))
    return z


def craters(rng: Rng) -> Floats:
    z = np.zeros((SIDE, SIDE))
    for _ in range(rng.integers(1, 4)):
        radius = rng.uniform(0.5, 4)
        r = np.maximum(np.hypot(*distances(rng)) / radius, 1e-6)
        z += rng.uniform(0.1, 0.3) * radius * np.where(r < 1, r**2 - 0.75, 0.25 / r**3)
    return z


def cliff(rng: Rng) -> Floats:
    x = np.arange(SIDE) * CELL_M
    line = rng.uniform(0.2, 0.8) * SIDE * CELL_M + rng.uniform(0, 1.5) * np.sin(
        x / rng.uniform(1, 4) + rng.uniform(0, 6)
    )
    z = rng.uniform(0.3, 3) / (1 + np.exp(np.clip(-(x[:, None] - line) / 0.1, -50, 50)))
    return np.rot90(z, int(rng.integers(0, 4)))


def ground(rng: Rng) -> Floats:
    z = fractal(rng)
    for chance, shape in ((0.35, cliff), (0.7, rocks), (0.4, craters)):
        if rng.random() < chance:
            z = z + shape(rng)
    if rng.random() < 0.3:
        dx, dy = distances(rng)
        z = z + rng.uniform(-0.4, 0.4) * dx + rng.uniform(-0.4, 0.4) * dy
    return z


def seen(z: Floats, rng: Rng) -> tuple[Bools, Floats]:
    """Cells in line of sight within one wedge from a random place, and their ranges in metres."""
    row, col = rng.uniform(0.03, 0.97, 2) * SIDE
    camera_m = z[int(row), int(col)] + rng.uniform(0.8, 1.6)
    half = math.radians(rng.choice([30, 45]))
    azimuth = rng.uniform(0, 2 * math.pi) + np.arange(-half, half, 0.002)[:, None]
    r = np.arange(5, rng.uniform(5, 15) / CELL_M, 0.5)[None]
    i = np.floor(row + r * np.sin(azimuth)).astype(int)
    j = np.floor(col + r * np.cos(azimuth)).astype(int)
    inside = (i >= 0) & (i < SIDE) & (j >= 0) & (j < SIDE)
    slope = (z[np.clip(i, 0, SIDE - 1), np.clip(j, 0, SIDE - 1)] - camera_m) / r
    visible = inside & (slope >= np.maximum.accumulate(slope, 1) - 1e-9)
    mask = np.zeros(z.shape, bool)
    mask[i[visible], j[visible]] = True
    rows, cols = np.indices(z.shape) + 0.5
    return mask, CELL_M * np.hypot(rows - row, cols - col)


def view(z: Floats, rng: Rng) -> Bools:
    if rng.random() < 0.4:
        return np.ones(z.shape, bool)
    target, mask = rng.uniform(0.3, 0.95), seen(z, rng)[0]
    for _ in range(60):
        if mask.mean() > target:
            break
        mask |= seen(z, rng)[0]
    return mask


def sigmas(rng: Rng) -> Floats:
    """Standard deviations after a few looks whose error grows with the square of the range."""
    information = np.zeros((SIDE, SIDE))
    for look in range(rng.integers(1, 5)):
        dx, dy = distances(rng, 5.0)
        turned = np.angle(np.exp(1j * (np.arctan2(dy, dx) - rng.uniform(0, 6.3))))
        met = (np.abs(turned) < 0.6) | (look == 0)
        information += met / (0.0008 * (dx**2 + dy**2 + 1)) ** 2
    return 1 / np.sqrt(information)


def jobs(rng: Rng) -> list[Job]:
    found: list[Job] = []
    for _ in range(GROUNDS):
        z = ground(rng)
        known = view(z, rng)
        if rng.random() < 0.35:
            z = z + rng.normal(0, rng.choice([0.003, 0.01, 0.02, 0.03]), z.shape)
        sigma_m = sigmas(rng)
        for side, crops in CROPS.items():
            for _ in range(crops):
                i, j = rng.integers(0, SIDE - side + 1, 2)
                cut = np.s_[i : i + side, j : j + side]
                bound_m = float(rng.choice(BOUNDS_M))
                profile = 0 if bound_m < 0.08 or rng.random() < 0.3 else int(rng.integers(1, 4))
                if known[cut].mean() > 0.05:
                    levels = int(rng.integers(2, 5))
                    job = Job(z[cut], known[cut], sigma_m[cut], bound_m, levels, profile)
                    found.append(job)
    return found


def measured(z: Floats, rng: Rng, looks: int, honest: float, before: Floats | None) -> Floats:
    """Information and weighted sum of errors, (2, H, W), after some more looks."""
    total = np.zeros((2, *z.shape)) if before is None else before.copy()
    for _ in range(looks):
        mask, range_m = seen(z, rng)
        hit = np.clip(rng.uniform(3, 20) / np.maximum(range_m, 0.1), 0.3, 1)
        mask &= rng.random(z.shape) < hit
        sigma_m = 0.0008 * (range_m**2 + 1) * np.exp(rng.normal(0, 0.25, z.shape))
        sigma_m = np.hypot(sigma_m, rng.uniform(0.003, 0.02))
        weight = mask / sigma_m**2
        total += [weight, weight * rng.normal(0, honest * sigma_m)]
    return total


def successions(rng: Rng) -> list[Job | Next]:
    """Tiles measured by a few looks, then by a few more."""
    found: list[Job | Next] = []
    for _ in range(SUCCESSIONS):
        z, honest = ground(rng), rng.uniform(0.2, 0.8)
        first = measured(z, rng, int(rng.integers(2, 14)), honest, None)
        second = measured(z, rng, int(rng.integers(1, 5)), honest, first)
        for side, crops in ((32, 10), (64, 3)):
            for _ in range(crops):
                i, j = rng.integers(0, SIDE - side + 1, 2)
                cut = np.s_[i : i + side, j : j + side]
                found += succession(z[cut], first[:, *cut], second[:, *cut], rng)
    return found


def succession(z: Floats, first: Floats, second: Floats, rng: Rng) -> list[Job | Next]:
    if (first[0] > 0).mean() < 0.03 or (second[0] == first[0]).all():
        return []
    bound_m = float(rng.choice(BOUNDS_M))
    known, later = first[0] > 0, second[0] > 0
    with np.errstate(all="ignore"):
        was, sigma_m = z + first[1] / first[0], 1 / np.sqrt(first[0])
        now, now_sigma_m = z + second[1] / second[0], 1 / np.sqrt(second[0])
    base = decode_tile(encode_tile(was, known, sigma_m, bound_m).data)
    found: list[Job | Next] = [Next(base, now, later, now_sigma_m, bound_m)]
    if rng.random() < 0.4:
        found.append(Job(now, later, now_sigma_m, bound_m, int(rng.integers(2, 5)), 0, base))
    return found


def prepare(job: Job) -> tuple[Head, list[Truth]]:
    """What the encoder would write, as far as the models do not matter."""
    bound = bound_for(job.bound_m, 1e-9, 2)
    assert bound is not None
    known = np.ascontiguousarray(job.known)
    base = round(float(np.median(job.elevation_m[known])) / bound.step_m)
    head = Head(known.shape, bound, job.levels, job.profile, bool(known.all()), base)
    cells = sigmacode.code_of(job.sigma_m, known)
    codes, mask = block_max(cells, SIGMA_BLOCK), known.astype(np.uint8)
    values = np.where(known, job.elevation_m, job.elevation_m[known][0])
    split, told_codes = split_blocks(cells, known, job.base)
    truth = Truth(head.scale.units(values), mask, codes, mask, 0, split, told_codes)
    errors_m = rehearse(values, truth, head)
    plan = plan_levels(errors_m, known, bound, job.levels)
    return head, [replace(truth, told=told, bound_code=code) for code, told in plan]


def fresh() -> dict[str, Opinions]:
    learned = {kind: mask_opinions(kind) for kind in KINDS}
    learned["residuals"] = residuals.residual_opinions()
    learned["sigma"] = sigmacode.sigma_opinions()
    learned["changes"] = changecode.change_opinions()
    learned["sigma-changes"] = sigmachange.change_opinions()
    learned["sigma-cells"] = sigmachange.cell_opinions()
    return learned


def learn(learned: dict[str, Opinions], taps: NDArray[np.int64], job: Job | Next) -> int:
    """Code one job in the shared models; return its size in bytes."""
    for kind in KINDS:  # what is not kept has to be as it will be: new to every payload
        learned[kind].models[LEARNED_SLOTS:] = priors.fresh_models(1)[0]
    if isinstance(job, Job):
        return learn_tile(learned, taps, job)
    priors.share(learned, taps)
    size = learn_next(job)
    priors.share({}, None)
    return size


def learn_tile(learned: dict[str, Opinions], taps: NDArray[np.int64], job: Job) -> int:
    head, truths = prepare(job)
    priors.share(learned, taps)
    if not head.whole:
        mask = truths[0].mask.copy()
        code_mask(encoder(mask.size + 256), learned["whole"], np.zeros_like(mask), mask)
    size = len(write_tile(head, truths).data)
    priors.share({}, None)
    return size


def learn_next(job: Next) -> int:
    bound = bound_for(job.bound_m, 1e-6, 2)
    assert bound is not None
    values = np.where(job.known, job.elevation_m, job.elevation_m[job.known][0])
    tile = encode_on(job.base, values, job.known, sigmacode.code_of(job.sigma_m, job.known), bound)
    return len(tile.data) if tile else 0


def write(path: Path, learned: dict[str, Opinions], taps: NDArray[np.int64]) -> None:
    texts = {
        name: priors.pack_opinions(opinions, slots_of(name, opinions))
        for name, opinions in learned.items()
    }
    texts["taps"] = priors.pack_taps(taps)
    lines = ['"""Priors of the codec: written by `benchmarks/train_codec.py`, not by hand."""', ""]
    lines.append("PRIORS: dict[str, str] = {")
    for name, text in texts.items():
        lines.append(f'    "{name}": (')
        lines += [f'        "{part}"' for part in textwrap.wrap(text, 88, break_on_hyphens=False)]
        lines.append("    ),")
    path.write_text("\n".join([*lines, "}", ""]))


def slots_of(name: str, opinions: Opinions) -> int:
    return LEARNED_SLOTS if name in maskcode.KINDS else opinions.models.size


def main(path: Path) -> None:
    rng = np.random.default_rng(777)
    priors.PRIORS.clear()
    todo, learned = [*jobs(rng), *successions(rng)], fresh()
    taps, history = np.zeros((TAP_SETS, TAPS), np.int64), []
    for turn in range(PASSES):
        total = 0
        for k in rng.permutation(len(todo)):
            total += learn(learned, taps, todo[k])
            history = [*history[-200:], taps.copy()]
            if len(history) % 50 == 0:
                taps[:] = np.mean(history, 0)
        print(f"pass {turn}: {len(todo)} tiles, {total} bytes")
    write(path, learned, np.rint(np.mean(history, 0)).astype(np.int64))


if __name__ == "__main__":
    default = Path(__file__).parents[1] / "comms" / "prior_data.py"
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
