"""`sandpit`: a pit with an upright edge, its west without texture (Figs. 23 to 27).

A RECON-bot alone, on the flat ground behind the edge; methods 1 to 5 of section 3.2, ours, and an
oracle. Whole runs: the robot drives, drifts and maps by its own pose.
"""

from collections.abc import Sequence

from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.ground.claims import conclude_sandpit
from scenarios.experiments.ground.figure import drawing
from scenarios.experiments.ground.runs import PAPER, SETTINGS, Trial, measure, trials_of


def trials(options: Options) -> Sequence[Trial]:
    """Return every method over every seed."""
    return trials_of("sandpit", options, PAPER, "memory")


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude_sandpit,
    draw=drawing("Sandpit: a RECON-bot behind an upright edge"),
    settings=SETTINGS,
)
