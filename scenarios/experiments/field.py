"""`field`: four robots at a cliff of 75 degrees with a rock jumble (Figs. 28 to 32).

The paper ran methods 3 and 5 there; ours and an oracle stand beside them. Each robot is a process
of its own, the map goes to the Cliff-bot over the radio, and poses are the robots' own estimates.
"""

from collections.abc import Sequence

from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.ground.claims import conclude_field
from scenarios.experiments.ground.figure import drawing
from scenarios.experiments.ground.runs import SETTINGS, Trial, measure, trials_of

RUN = ("information-line", "information-interest")


def trials(options: Options) -> Sequence[Trial]:
    """Return methods 3 and 5, ours and the oracle over every seed."""
    return trials_of("field", options, RUN, "zenoh")


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude_field,
    draw=drawing("Field: a cliff of 75 degrees, four robots"),
    settings=SETTINGS,
)
