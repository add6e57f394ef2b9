"""How a camera's error grows as it moves by fiducials: Sujan & Meggiolaro, Eqs. 10-13, Fig. 19.

Fiducials lie 350 mm and 1100 mm away on average, few of them or many. By `source=formula` they are
points whose measurements are as bad as Eq. 4 says; by `source=images` they are what is tracked in
rendered pairs of images. The motions are told three ways from the same points: by least squares
with each point's covariance (ours), by the closed form, and by Eq. 12.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agents.settings import SensorSettings
from scenarios.errors import UsageError
from scenarios.experiments import localisation_images as images
from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.localisation_claims import conclude
from scenarios.experiments.localisation_figure import draw
from scenarios.experiments.localisation_walk import STEP_NUMBERS, WAYS, Course, walk
from scenarios.experiments.tables import Row

DISTANCES_M = (0.35, 1.1)
COUNTS = (6, 12, 24, 48)
IMAGE_COUNTS = (12, 24, 48, 96)
"""With fewer, real tracks leave too few now and then to tell a motion by."""
SOURCES = ("formula", "images")
MOTIONS = 80
STEP_M = 0.05
FALSE_SHARE = 0.02
WALKS = 4
"""Walks of a seed: its error is their root mean square."""
EVERY = 4
"""A row is kept for every fourth motion."""


@dataclass(frozen=True)
class Trial:
    """Some walks of one kind."""

    seed: int
    course: Course


def trials(options: Options) -> Sequence[Trial | images.Walk]:
    """Return a trial for each seed and distance, and of formulas for each number of fiducials.

    Raises UsageError for an unknown source, or what images have no use for.
    """
    source = options.one("source", "formula")
    if source not in SOURCES:
        raise UsageError(f"--set source={source}: must be one of {', '.join(SOURCES)}")
    step_m = options.number("step_m", STEP_M)
    if source == "images":
        for key in ("false_share", "noise_s"):
            if key in options.sets:
                raise UsageError(f"--set {key}: images have their own; must be left out")
        return [
            images.Walk(seed, distance_m, IMAGE_COUNTS, MOTIONS, step_m)
            for seed in range(1, options.seeds + 1)
            for distance_m in DISTANCES_M
        ]
    false_share = options.number("false_share", FALSE_SHARE)
    noise_s = options.number("noise_s", SensorSettings().noise_s)
    return [
        Trial(seed, Course(distance_m, count, MOTIONS, step_m, false_share, noise_s))
        for seed in range(1, options.seeds + 1)
        for distance_m in DISTANCES_M
        for count in COUNTS
    ]


def measure(trial: Trial | images.Walk) -> Sequence[Row]:
    """Return a row for every fourth motion, and one of single motions (Eq. 13)."""
    if isinstance(trial, images.Walk):
        return images.measure(trial, EVERY)
    course = trial.course
    # The same walks for any number of fiducials and any distance, but for what is seen on them.
    generators = [np.random.default_rng((trial.seed, number)) for number in range(WALKS)]
    walks = [list(walk(course, rng)) for rng in generators]
    base: Row = {"seed": trial.seed, "distance_m": course.distance_m, "fiducials": course.count}
    rows: list[Row] = []
    for k in range(EVERY - 1, course.motions, EVERY):
        row: Row = {**base, "kind": "path", "travelled_m": (k + 1) * course.step_m}
        for name in ("said_m", *(f"{way} error_m" for way in WAYS)):
            row[name] = _rms([float(steps[k][name]) for steps in walks])
        rows.append(row)
    every = [step for steps in walks for step in steps]
    single: Row = {**base, "kind": "step", "lost": sum(bool(step["lost"]) for step in every)}
    for name in STEP_NUMBERS:
        single[name] = _rms([float(step[name]) for step in every if name in step])
    return [*rows, single]


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude,
    draw=draw,
    settings={
        "source": "formula: points with Eq. 4's noise; images: rendered pairs, tracked (formula)",
        "step_m": f"how far the camera goes between frames ({STEP_M:g})",
        "false_share": f"share of tracks that are false ({FALSE_SHARE:g})",
        "noise_s": "S of Eq. 4, 1/m (the sensor's)",
    },
)
