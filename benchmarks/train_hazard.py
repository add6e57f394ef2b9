"""Train what `team-information` guesses of unknown cells; write `agents/planar/hazard_data.py`.

    python benchmarks/train_hazard.py [--worlds 60] [--out agents/planar/hazard_data.py]

`team-information` explores made-up buildings (three in four) and made-up squares; of each cell that
a look reaches for the first time, what lay about it before and whether it is solid is an example.
No real building is among them. Every sixth world is held back, and how well it is guessed told.

The network in use was trained by an earlier form of this, on 33 worlds that `team-information`
explored before it chose routes.
"""

import argparse
import textwrap
from itertools import pairwise
from pathlib import Path

import numpy as np
from floor_plans import FOOTPRINT_M, floor_plan

from agents.geometry import Bools, Floats, Pose
from agents.ground.markov import distance_to_known_m
from agents.planar.hazard import SIZES, WITHIN_M, Layers, network, packed
from agents.planar.surroundings import DIRECTIONS, surroundings
from scenarios.experiments.planar_runs import DRIVE, PLANNER, sensor_of
from scenarios.experiments.planar_trial import Exploration, Setup
from sim.planar_world import PlanarWorld, made_up

LOOKS = 90
HELD_BACK = 6
STEPS, BATCH, RATE = 8000, 1024, 2e-3
DECAY = 1e-5
Rng = np.random.Generator


class Watched(Exploration):
    """An exploration that keeps examples."""

    def __post_init__(self) -> None:
        """Begin with none."""
        super().__post_init__()
        self.examples: list[tuple[Floats, Bools]] = []

    def _look(self, pose: Pose, rng: Rng) -> float:
        before, frame = self.log_odds, self.world.frame
        got = super()._look(pose, rng)
        fresh = (before == 0) & (self.log_odds != 0)
        if (before < 0).any():
            fresh &= distance_to_known_m(before < 0, frame.cell_m) < WITHIN_M
            cells = np.argwhere(fresh)
            solid = self.log_odds[cells[:, 0], cells[:, 1]] > 0
            self.examples.append((surroundings(before, cells, frame), solid))
        return got


def world_of(seed: int) -> PlanarWorld:
    """Return one world to learn from."""
    rng = np.random.default_rng([seed, 77])
    if seed % 4:
        return floor_plan(rng)
    side_m, share = float(rng.uniform(30, 80)), float(rng.uniform(0.05, 0.3))
    return made_up(rng, side_m=side_m, solid_share=share, footprint_m=FOOTPRINT_M)


def examples(seed: int) -> tuple[Floats, Bools]:
    """Return the examples of one exploration: inputs (N, NUMBERS) and what was solid (N,)."""
    world = world_of(seed)
    sensor = sensor_of(90.0, 15.0) if seed % 3 else sensor_of(75.0, 10.0)
    planner = PLANNER.model_copy(update={"max_looks": LOOKS})
    everything = np.ones(world.solid.shape, dtype=np.bool_)
    watched = Watched(world, everything, Setup("team-information", sensor, DRIVE, planner))
    watched.run(np.random.default_rng([seed, 21]))
    return _joined(watched.examples)


def _joined(parts: list[tuple[Floats, Bools]]) -> tuple[Floats, Bools]:
    numbers = [np.zeros((0, SIZES[0])), *(part for part, _ in parts)]
    solid = [np.zeros(0, dtype=np.bool_), *(part for _, part in parts)]
    return np.concatenate(numbers), np.concatenate(solid)


def turned(numbers: Floats, quarters: int, mirrored: bool) -> Floats:
    """Return the same surroundings, turned by quarters and mirrored."""
    count = len(DIRECTIONS)
    order = (np.arange(count) + 2 * quarters) % count
    if mirrored:
        order = -order % count
    parts = [numbers[:, k * count + order] for k in range(3)]
    return np.concatenate((*parts, numbers[:, 3 * count :]), axis=1)


def trained(numbers: Floats, solid: Bools, rng: Rng) -> Layers:
    """Return a network: log loss, Adam, the rate falling as a cosine."""
    layers = [(rng.normal(0.0, np.sqrt(2.0 / a), (a, b)), np.zeros(b)) for a, b in pairwise(SIZES)]
    mean = [[np.zeros_like(part) for part in layer] for layer in layers]
    square = [[np.zeros_like(part) for part in layer] for layer in layers]
    for step in range(1, STEPS + 1):
        drawn = rng.integers(0, len(numbers), BATCH)
        batch = turned(numbers[drawn], int(rng.integers(4)), bool(rng.integers(2)))
        rate = RATE * 0.5 * (1.0 + np.cos(np.pi * step / STEPS))
        for k, slopes in enumerate(_slopes(layers, batch, solid[drawn])):
            new: list[Floats] = []
            for q, (part, slope) in enumerate(zip(layers[k], slopes, strict=True)):
                mean[k][q] = 0.9 * mean[k][q] + 0.1 * slope
                square[k][q] = 0.999 * square[k][q] + 0.001 * slope * slope
                along = mean[k][q] / (1.0 - 0.9**step)
                new.append(
                    part - rate * along / (np.sqrt(square[k][q] / (1.0 - 0.999**step)) + 1e-8)
                )
            layers[k] = (new[0], new[1])
    return layers


def _slopes(layers: Layers, batch: Floats, solid: Bools) -> list[tuple[Floats, Floats]]:
    """Return the log loss's derivatives by each layer's weights and biases."""
    values = [batch]
    for k, (weight, bias) in enumerate(layers):
        out = values[-1] @ weight + bias
        values.append(np.maximum(out, 0.0) if k < len(layers) - 1 else out)
    error = (1.0 / (1.0 + np.exp(-values[-1])) - solid[:, None]) / len(batch)
    found: list[tuple[Floats, Floats]] = []
    for k in range(len(layers) - 1, -1, -1):
        found.append((values[k].T @ error + DECAY * layers[k][0], error.sum(axis=0)))
        error = (error @ layers[k][0].T) * (values[k] > 0)
    return found[::-1]


def log_loss(layers: Layers, numbers: Floats, solid: Bools) -> float:
    """Return the mean log loss of guesses, nats per cell."""
    guess = network(numbers, layers)
    return float(np.mean(np.logaddexp(0.0, np.where(solid, -guess, guess))))


def main() -> None:
    """Explore, train, tell, write."""
    told = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    told.add_argument("--worlds", type=int, default=60)
    told.add_argument("--out", type=Path, default=Path("agents/planar/hazard_data.py"))
    args = told.parse_args()
    known: list[tuple[Floats, Bools]] = []
    held: list[tuple[Floats, Bools]] = []
    for seed in range(args.worlds):
        found = examples(seed)
        (held if seed % HELD_BACK == 0 else known).append(found)
        print(f"world {seed}: {len(found[1])} cells, {found[1].mean():.3f} solid", flush=True)
    rng = np.random.default_rng(0)
    layers = trained(*_joined(known), rng)
    for name, parts in (("known", known), ("held back", held)):
        inputs, answers = _joined(parts)
        share = float(answers.mean())
        blind = -share * np.log(share) - (1.0 - share) * np.log(1.0 - share)
        print(f"{name}: log loss {log_loss(layers, inputs, answers):.4f}, blind {blind:.4f}")
    lines = textwrap.wrap(packed(layers), 88, break_on_hyphens=False)
    quoted = "".join(
        f"    {line!r}\n" if "'" not in line and '"' in line else f'    "{line}"\n'
        for line in lines
    )
    args.out.write_text(
        '"""The network of `hazard`: written by `benchmarks/train_hazard.py`, not by hand."""\n\n'
        f"LAYERS = (\n{quoted})\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
