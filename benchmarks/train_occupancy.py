"""Learn what the occupancy codec's models know beforehand; write `comms/occupancy/prior_data.py`.

    python benchmarks/train_occupancy.py [comms/occupancy/prior_data.py]

All maps are made up: floor plans and voxel scenes as a scanner with errors sees them. A new file is
a new format: robots with different files do not understand one another.
"""

import sys
import textwrap
from pathlib import Path

import numpy as np
from occupancy_worlds import CLAMPS, floor_plan, look, scene, three_states, turned_map

from comms.logistic import fresh_models
from comms.occupancy import blockcode, planar, priors, sizes, voxels
from comms.occupancy.classes import Symbols, symbols_of
from comms.occupancy.field import blank, palette_of
from comms.occupancy.judge import Judge
from comms.occupancy.levels import Models, code_level
from comms.rangecoder import Mark, encoder

Rng = np.random.Generator

FLOORS, SCENES, PASSES = 120, 40, 2
SIDES = ((16, 1), (8, 1), (8, 4, 1), (8, 2, 1))
HASH_BITS = 17


def floors(rng: Rng) -> list[Symbols]:
    """Tiles and whole maps of floors, clean, published or as a robot has them."""
    found: list[Symbols] = []
    for _ in range(FLOORS):
        solid = floor_plan(rng, int(rng.choice([128, 192, 256])))
        reach = float(rng.uniform(30, 160))
        clamp = CLAMPS[rng.integers(len(CLAMPS))]
        log_odds, known = look(solid, int(rng.integers(1, 14)), rng, reach=reach, clamp=clamp)
        kind = rng.random()
        if kind < 0.1:
            log_odds, known = np.where(solid, 6.0, -6.0), np.ones(solid.shape, np.bool_)
        elif kind < 0.55:
            log_odds, known = three_states(log_odds, known, float(rng.uniform(-1.5, 0.8)))
            if rng.random() < 0.5:
                log_odds, known = turned_map(log_odds, known, float(rng.uniform(-0.8, 0.8)))
        symbols = symbols_of(log_odds, known)
        for side, count in ((32, 6), (64, 4), (128, 1)):
            found += [crop(symbols, (1, side, side), rng) for _ in range(count)]
    return found


def scenes(rng: Rng) -> list[Symbols]:
    """Blocks of voxel scenes."""
    found: list[Symbols] = []
    for _ in range(SCENES):
        solid = scene(rng, (40, 96, 96))
        clamp = CLAMPS[rng.integers(len(CLAMPS))]
        log_odds, known = look(
            solid, int(rng.integers(1, 6)), rng, reach=float(rng.uniform(25, 90)), clamp=clamp
        )
        if rng.random() < 0.4:
            log_odds, known = three_states(log_odds, known)
        symbols = symbols_of(log_odds, known)
        found += [crop(symbols, (16, 16, 16), rng) for _ in range(6)]
        found += [crop(symbols, (32, 32, 32), rng) for _ in range(3)]
    return found


def crop(symbols: Symbols, shape: tuple[int, int, int], rng: Rng) -> Symbols:
    starts = [
        int(rng.integers(0, max(n - m, 0) + 1)) for n, m in zip(symbols.shape, shape, strict=True)
    ]
    cut = tuple(slice(a, a + m) for a, m in zip(starts, shape, strict=True))
    return np.ascontiguousarray(symbols[cut])


def fresh() -> dict[str, tuple[Judge, int]]:
    """The judges to teach, and how many of their models are kept."""
    return {
        "planar states": (planar.state_judge(HASH_BITS), planar.DENSE),
        "voxel states": (voxels.state_judge(HASH_BITS), voxels.DENSE),
        "voxel calm": (voxels.calm_judge(), voxels.CALM_DENSE),
        "planar sizes": (sizes.size_judge("planar", HASH_BITS), sizes.DENSE),
        "voxel sizes": (sizes.size_judge("voxel", HASH_BITS), sizes.DENSE),
        "planar block sizes": (sizes.size_judge("planar block", HASH_BITS), sizes.DENSE),
        "voxel block sizes": (sizes.size_judge("voxel block", HASH_BITS), sizes.DENSE),
        "planar blocks": (blockcode.block_judge("planar"), blockcode.DENSE),
        "voxel blocks": (blockcode.block_judge("voxel"), blockcode.DENSE),
    }


def learn(judges: dict[str, tuple[Judge, int]], symbols: Symbols, sides: tuple[int, ...]) -> int:
    """Code one map in the shared models; return its size in bytes."""
    for kept, slots in judges.values():  # the rest has to be as it will be: new to every payload
        kept.opinions.models[slots:] = fresh_models(1)[0]
    palette, field = palette_of(symbols), blank(symbols.shape)
    coder, models = encoder(symbols.size * 4 + 64), Models.fresh(symbols.shape, palette)
    for side in sides:
        code_level(coder, models, palette, field, side, symbols)
    return len(Mark(coder).finish(length_is_known=True))


def write(path: Path, judges: dict[str, tuple[Judge, int]]) -> None:
    doc = "Priors of the occupancy codec: written by `benchmarks/train_occupancy.py`, not by hand."
    lines = [f'"""{doc}"""', "", "PRIORS: dict[str, str] = {"]
    for name, (kept, slots) in judges.items():
        text = priors.pack(kept.opinions, slots)
        lines.append(f'    "{name}": (')
        lines += [f'        "{part}"' for part in textwrap.wrap(text, 88, break_on_hyphens=False)]
        lines.append("    ),")
    path.write_text("\n".join([*lines, "}", ""]))


def main(path: Path) -> None:
    rng = np.random.default_rng(4242)
    priors.PRIORS.clear()
    judges, todo = fresh(), floors(rng) + scenes(rng)
    todo = [symbols for symbols in todo if (symbols > 0).mean() > 0.02]
    priors.share({name: kept.opinions for name, (kept, _) in judges.items()})
    for turn in range(PASSES):
        total = 0
        for k in rng.permutation(len(todo)):
            total += learn(judges, todo[k], SIDES[rng.integers(len(SIDES))])
        print(f"pass {turn}: {len(todo)} maps, {total} bytes", flush=True)
    priors.share({})
    write(path, judges)


if __name__ == "__main__":
    default = Path(__file__).parents[1] / "comms" / "occupancy" / "prior_data.py"
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
