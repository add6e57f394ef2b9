"""`planar-one`: one robot maps an unknown planar world (Sujan & Meggiolaro, Figs. 17, 18, 20).

100 m x 100 m, a camera of 90 degrees and 15 m, start in the middle; the paper's five methods, two
variants of its fifth, and ours. No radio; poses are exact.
"""

from collections.abc import Sequence

from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.planar_claims import conclude
from scenarios.experiments.planar_figure import drawing
from scenarios.experiments.planar_runs import SETTINGS, Trial, measure, trials_of


def trials(options: Options) -> Sequence[Trial]:
    """Return every method over every seed."""
    return trials_of(options, robots=1, fov_deg=90.0, range_m=15.0)


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude,
    draw=drawing("One robot, 90 degrees, 15 m"),
    settings=SETTINGS,
)
