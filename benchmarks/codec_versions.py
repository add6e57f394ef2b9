"""What a tile's next version costs: whole, and built on the version before.

    python benchmarks/codec_versions.py [--grounds N]

Tiles of 32 x 32 cells of made-up ground (that of `train_codec.py`, from other seeds) are measured
by a few looks, then by a few more, with noise. One row for each share of new cells: bytes of the
next version whole; whole, but telling no cell less surely than before; and built on the one before.
"""

import argparse
import itertools

import numpy as np
from train_codec import SIDE, Floats, ground, measured

from comms.codec import decode_tile, encode_tile

TILE = 32
BOUND_M = 0.05
GROWTHS = (0.0, 0.02, 0.1, 0.25, 0.5, 1.0, np.inf)
Row = tuple[float, int, int, int, int]


def tile_of(information: Floats, z: Floats) -> tuple[Floats, Floats, Floats]:
    known = information[0] > 0
    safe = np.where(known, information[0], 1.0)
    return z + information[1] / safe, known, 1 / np.sqrt(safe)


def rows_of(seed: int) -> list[Row]:
    rng = np.random.default_rng([seed, 4242])
    z, honest = ground(rng), rng.uniform(0.2, 0.8)
    before = measured(z, rng, int(rng.integers(3, 14)), honest, None)
    after = measured(z, rng, int(rng.integers(1, 4)), honest, before)
    found: list[Row] = []
    for i in range(0, SIDE, TILE):
        for j in range(0, SIDE, TILE):
            cut = np.s_[i : i + TILE, j : j + TILE]
            old = tile_of(before[:, *cut], z[cut])
            new = tile_of(after[:, *cut], z[cut])
            changed = (after[0][cut] > before[0][cut]).any()
            if old[1].mean() < 0.05 or not changed:
                continue
            base = decode_tile(encode_tile(*old, BOUND_M).data)
            next_one = encode_tile(*new, BOUND_M, base=base)
            whole = len(encode_tile(*new, BOUND_M).data)
            alone = len(encode_tile(*new, BOUND_M, base=base, alone=True).data)
            growth = (new[1].sum() - old[1].sum()) / old[1].sum()
            found.append((float(growth), whole, alone, len(next_one.data), next_one.needs_base))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--grounds", type=int, default=40)
    rows = [row for seed in range(parser.parse_args().grounds) for row in rows_of(seed)]
    table = np.array(rows, np.float64)
    print(
        "| new cells to old | tiles | whole, bytes | never less sure | on base | ratio | chosen |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|")
    spans = [*itertools.pairwise(GROWTHS), (0.0, np.inf)]
    for low, high in spans:
        some = table[(table[:, 0] >= low) & (table[:, 0] < high)]
        if len(some):
            _, whole, alone, on_base, chosen = some.mean(0)
            print(
                f"| {low:.2f} to {high:.2f} | {len(some)} | {whole:.0f} | {alone:.0f} "
                f"| {on_base:.0f} | {on_base / whole:.2f} | {chosen:.0%} |"
            )


if __name__ == "__main__":
    main()
