"""`planar-two`: two robots map an unknown planar world together (Figs. 21, 22).

As `planar-one`, with two robots of 75 degrees and 10 m, who know at once what the other measured;
and, for comparison, one robot of that sensor by our own method (the paper has none).
"""

from collections.abc import Sequence
from dataclasses import replace

from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.planar_claims import conclude
from scenarios.experiments.planar_figure import drawing
from scenarios.experiments.planar_runs import OURS, SETTINGS, Trial, measure, trials_of


def trials(options: Options) -> Sequence[Trial]:
    """Return every method over every seed, and ours with one robot too."""
    two = trials_of(options, robots=2, fov_deg=75.0, range_m=10.0)
    one = [replace(trial, robots=1, looks=2 * trial.looks) for trial in two if trial.method == OURS]
    return [*two, *one]


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude,
    draw=drawing("Two robots, 75 degrees, 10 m"),
    settings=SETTINGS,
)
