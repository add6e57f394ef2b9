"""Occupancy maps in bytes, beside image coders, general compressors and OctoMap.

    python benchmarks/occupancy_codec.py [DATA]

`DATA` is a folder with occupancy/*.png and *.yaml (as map_server has them) and, for voxels,
stereo/; without it only made-up worlds are measured. Bytes hold all that a receiver needs, but for
the size of the map with the general compressors. Image coders pay for their headers, which is much
on tiles. The made-up looks are those of `occupancy_worlds.py`, from other seeds than the priors
were learned from; no real map was used to learn them.
"""

import itertools
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from occupancy_peers import octomap_files, of_three_states, peers
from occupancy_worlds import floor_plan, look, scene, three_states

from comms.codec import (
    decode_occupancy,
    decode_occupancy_tile,
    encode_occupancy,
    encode_occupancy_tile,
    log_odds_as_sent,
)
from comms.occupancy.classes import STATE_OF, symbols_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Map = tuple[Floats, Bools]

SHARED = Path(os.environ.get("ROPETEAM_SHARED", Path(__file__).parents[2] / "shared"))
OURS, LEVELS = "ropeteam", "ropeteam, progressive"


def published(path: Path) -> Map:
    """A map (1, rows, cols) of three states, read by the thresholds of its yaml."""
    lines = path.with_suffix(".yaml").read_text().splitlines()
    fields = dict(line.split(": ", 1) for line in lines)
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.float64)
    occupancy = grey / 255 if fields["negate"] == "1" else (255 - grey) / 255
    occupied = occupancy > float(fields["occupied_thresh"])
    free = occupancy < float(fields["free_thresh"])
    return np.where(occupied, 9.0, -9.0)[None], (free | occupied)[None]


def scanned(floor: Map, looks: int, clamp: tuple[float, float], seed: int) -> Map:
    """Log odds (1, 512, 512) of looks at the busiest part of a floor."""
    known = floor[1][0]
    places = itertools.product(*(range(0, length - 511, 64) for length in known.shape))
    row, col = max(places, key=lambda at: known[at[0] : at[0] + 512, at[1] : at[1] + 512].sum())
    cut = np.s_[:, row : row + 512, col : col + 512]
    solid = ~floor[1][cut] | (floor[0][cut] > 0)
    return look(solid, looks, np.random.default_rng(seed), clamp=clamp)


def motorcycle(folder: Path) -> Map:
    """Voxels of 0.05 m from one real depth picture: free up to the surface, occupied there."""
    camera = json.loads((folder / "motorcycle.json").read_text())
    disparity = np.load(folder / "motorcycle_disparity.npz")["disparity"][::2, ::2]
    rows, cols = np.mgrid[: disparity.shape[0], : disparity.shape[1]] * 2.0
    seen = np.isfinite(disparity)
    depth_m = camera["focal_px"] * camera["baseline_m"] / (disparity + camera["doffs_px"])
    rays = np.stack([camera["cy_px"] - rows, cols - camera["cx_px"], 0 * rows], 2)
    rays = np.where([False, False, True], 1.0, rays / camera["focal_px"])[seen]
    depth_m = depth_m[seen]
    log_odds, origin = np.zeros((64, 96, 128)), np.array([28.0, 44.0, 2.0])
    for step_m in np.arange(0.1, float(depth_m.max()) + 0.2, 0.05):
        ends = (depth_m >= step_m - 0.025) & (depth_m < step_m + 0.025)
        for rule, change in ((depth_m > step_m + 0.05, -0.4), (ends, 0.85)):
            length_m = np.where(rule, np.where(ends, depth_m, step_m), 0)[rule, None]
            cells = np.unique(np.floor(rays[rule] * length_m / 0.05 + origin).astype(int), axis=0)
            inside = ((cells >= 0) & (cells < log_odds.shape)).all(1)
            log_odds[tuple(cells[inside].T)] += change
    return log_odds.clip(-2, 3.5), log_odds != 0


def whole_maps(data: Path) -> Iterator[tuple[str, Map]]:
    floors = {path.stem: published(path) for path in sorted(data.glob("occupancy/*.png"))}
    for name, floor in floors.items():
        yield name, floor
    for name in ("willow_garage_0p05", "ut_gdc_floor3_0p05"):
        if name in floors:
            yield f"{name}, 8 looks", scanned(floors[name], 8, (-6, 6), 1)
            yield f"{name}, 30 looks", scanned(floors[name], 30, (-2, 3.5), 2)
    plan = floor_plan(np.random.default_rng(90), 512)
    yield "made-up floor, 20 looks", look(plan, 20, np.random.default_rng(91))


def voxel_maps(data: Path) -> Iterator[tuple[str, Map]]:
    for seed in (70, 71):
        rng = np.random.default_rng(seed)
        seen = look(scene(rng, (48, 96, 96)), 4, rng, reach=70.0, clamp=(-2, 3.5))
        yield f"made-up scene {seed}, log odds", seen
        yield f"made-up scene {seed}, three states", three_states(*seen)
    if (data / "stereo" / "motorcycle.json").exists():
        seen = motorcycle(data / "stereo")
        yield "motorcycle (real depth), log odds", seen
        yield "motorcycle (real depth), three states", three_states(*seen)


def sizes_of(pair: Map) -> dict[str, int]:
    """Bytes by coder; ours is decoded and compared."""
    log_odds, known = pair
    flat = (log_odds[0], known[0]) if len(log_odds) == 1 else pair
    data = encode_occupancy(*flat)
    told, mask = decode_occupancy(data)
    assert np.array_equal(mask, flat[1])
    assert np.array_equal(told, log_odds_as_sent(*flat))
    symbols = symbols_of(log_odds, known)
    found = {OURS: len(data)} | {name: size(symbols) for name, size in peers().items()}
    if _has_three_states(symbols):
        found |= {name: size(symbols) for name, size in of_three_states().items()}
    return found


def octomap_sizes(pair: Map) -> dict[str, int]:
    """Bytes of OctoMap's files, if it is installed; .bt holds three states only."""
    if not find_spec("pyoctomap"):
        return {}
    symbols = symbols_of(*pair)
    found = octomap_files(symbols)
    if _has_three_states(symbols):
        return found
    return {name: size for name, size in found.items() if ".bt" not in name}


def _has_three_states(symbols: NDArray[np.uint8]) -> bool:
    return len(set(np.unique(symbols)) - {0}) <= 2


def tile_sizes(pair: Map, shape: tuple[int, int, int]) -> dict[str, int]:
    """Sums over the tiles of a map that are known in part."""
    total: dict[str, int] = {}
    starts = [range(0, n - m + 1, m) for n, m in zip(pair[0].shape, shape, strict=True)]
    for corner in itertools.product(*starts):
        cut = tuple(slice(a, a + m) for a, m in zip(corner, shape, strict=True))
        log_odds, known = pair[0][cut], pair[1][cut]
        if known.mean() < 0.02:
            continue
        flat = (log_odds[0], known[0]) if shape[0] == 1 else (log_odds, known)
        tile = encode_occupancy_tile(*flat)
        assert np.array_equal(decode_occupancy_tile(tile.data).known, flat[1])
        found = {"tiles": 1, LEVELS: len(tile.data), **sizes_of((log_odds, known))}
        total = {name: total.get(name, 0) + size for name, size in found.items()}
    return total


def table(title: str, rows: list[tuple[str, dict[str, int]]]) -> None:
    """Print a table, with the share of the best peer that ours takes."""
    names = list(dict.fromkeys(name for _, sizes in rows for name in sizes))
    print(f"\n## {title}\n")
    print("| map | " + " | ".join(names) + " | ours / best peer |")
    print("|---" * (len(names) + 2) + "|")
    for name, sizes in rows:
        others = [size for peer, size in sizes.items() if peer not in (OURS, LEVELS, "tiles")]
        cells = [str(sizes.get(peer, "")) for peer in names]
        print(f"| {name} | " + " | ".join(cells) + f" | {sizes[OURS] / min(others):.2f} |")


def times(name: str, pair: Map) -> str:
    """Milliseconds of CPU for one encoding and one decoding, best of five."""

    def best_ms(work: Callable[[], object]) -> float:
        spans: list[float] = []
        for _ in range(5):
            start = time.process_time()
            work()
            spans.append(time.process_time() - start)
        return 1e3 * min(spans)

    data = encode_occupancy(*pair)
    encode, decode = (
        best_ms(lambda: encode_occupancy(*pair)),
        best_ms(lambda: decode_occupancy(data)),
    )
    return f"| {name} | {len(data)} | {encode:.1f} | {decode:.1f} |"


def told_by_levels(pair: Map) -> dict[int, list[float]]:
    """Mean share of the bytes, of the known cells told and of the log odds told, level by level."""
    found: dict[int, list[list[float]]] = {}
    for i, j in itertools.product(range(0, 449, 64), repeat=2):
        log_odds, known = pair[0][0, i : i + 64, j : j + 64], pair[1][0, i : i + 64, j : j + 64]
        tile = encode_occupancy_tile(log_odds, known)
        if len(tile.level_ends) != 3:
            continue
        all_told = np.abs(log_odds_as_sent(log_odds, known)).sum()
        for level, end in enumerate(tile.level_ends):
            seen = decode_occupancy_tile(tile.data[:end])
            told = float(np.abs(seen.log_odds).sum() / all_told)
            row = [end / len(tile.data), seen.known.sum() / known.sum(), told]
            found.setdefault(level, []).append(row)
    return {level: np.mean(rows, 0).tolist() for level, rows in found.items()}


def main(data: Path) -> None:
    planes, blocks = dict(whole_maps(data)), dict(voxel_maps(data))
    table("Whole planar maps, bytes", [(name, sizes_of(pair)) for name, pair in planes.items()])
    rows = [(name, tile_sizes(pair, (1, 64, 64))) for name, pair in planes.items()]
    table("Tiles of 64 x 64 cells, bytes of all", rows)
    rows = [(name, sizes_of(pair) | octomap_sizes(pair)) for name, pair in blocks.items()]
    table("Voxel blocks, bytes", rows)
    rows = [(name, tile_sizes(pair, (16, 32, 32))) for name, pair in blocks.items()]
    table("Blocks of 16 x 32 x 32 voxels, bytes of all", rows)
    print("\n## What the levels of a tile tell (tiles with three levels)\n")
    print("| map | level | bytes | known cells | log odds |\n|---|---|---|---|---|")
    for name, pair in planes.items():
        if "looks" in name:
            for level, (share, cells, told) in told_by_levels(pair).items():
                print(f"| {name} | {level} | {share:.0%} | {cells:.0%} | {told:.0%} |")
    print("\n## Time, ms of CPU\n\n| map | bytes | encode | decode |\n|---|---|---|---|")
    for name, pair in planes.items():
        if pair[0].shape[1] >= 600 or "looks" in name:
            middle = np.s_[0, 128:384, 128:384] if "looks" in name else np.s_[0, 400:656, 300:556]
            print(times(f"{name}, 256 x 256", (pair[0][middle], pair[1][middle])))
    rng = np.random.default_rng(72)
    seen = look(scene(rng, (64, 64, 64)), 4, rng, reach=70.0)
    print(times("made-up scene, 64 x 64 x 64, log odds", seen))
    print(times("made-up scene, 64 x 64 x 64, three states", three_states(*seen)))
    states = STATE_OF[symbols_of(*seen)]
    print(f"\nThe scene is known in {np.mean(states != 1):.0%} of its voxels.")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else SHARED / "data")
