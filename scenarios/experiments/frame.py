"""The frame of all experiments: from trials, in processes, to tables, claims and a figure."""

import importlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from scenarios.errors import UsageError
from scenarios.experiments import EXPERIMENTS
from scenarios.experiments.figure import save_figure
from scenarios.experiments.keeping import Keeper
from scenarios.experiments.tables import Row, Table, as_csv, as_data, as_text, rows_csv
from scenarios.records import folder
from scenarios.records.tables import write_atomic
from scenarios.workers import workers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

T = TypeVar("T")

SCHEMA = 1


@dataclass(frozen=True)
class Options:
    """What the user asks of an experiment."""

    seeds: int = 10
    """How many seeds: 1, 2, ... this."""
    sets: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    """Values given by `--set KEY=VALUE`, in their order; every key is one that it knows."""

    def one(self, key: str, default: str) -> str:
        """Return the last value of a key, or the default where none was given."""
        values = self.sets.get(key, ())
        return values[-1] if values else default

    def number(self, key: str, default: float) -> float:
        """Return the last value of a key as a number above 0.

        Raises UsageError for anything else.
        """
        text = self.one(key, repr(default))
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not 0 < value < float("inf"):
            raise UsageError(f"--set {key}={text}: must be a number above 0")
        return value


@dataclass(frozen=True)
class Claim:
    """Something that somebody said, and what we measured."""

    text: str
    """The claim, in its author's sense."""
    source: str
    """Where it is said: a section or figure of the paper, or `ours`."""
    held: bool
    number: float
    """What decided it."""
    found: str
    """One sentence with the number and its unit."""


@dataclass(frozen=True)
class Findings:
    """What came out of an experiment."""

    tables: Sequence[Table]
    claims: Sequence[Claim]


@dataclass(frozen=True)
class Experiment(Generic[T]):
    """Four functions; `scenarios.experiments` says what each has to do."""

    trials: Callable[[Options], Sequence[T]]
    measure: Callable[[T], Sequence[Row]]
    conclude: Callable[[Sequence[Row]], Findings]
    draw: Callable[["Figure", Sequence[Row]], None]
    settings: Mapping[str, str] = field(default_factory=dict[str, str])
    """Keys of `--set` and what each means."""


def load(name: str) -> Experiment[Any]:
    """Return the experiment of that name.

    Raises UsageError where there is none.
    """
    if name not in EXPERIMENTS:
        raise UsageError(f"there is no experiment {name!r}; there are: {', '.join(EXPERIMENTS)}")
    module = importlib.import_module(f"scenarios.experiments.{name.replace('-', '_')}")
    return cast("Experiment[Any]", module.EXPERIMENT)


def checked_sets(experiment: Experiment[Any], pairs: Sequence[str]) -> dict[str, list[str]]:
    """Return the values of `--set KEY=VALUE` by key.

    Raises UsageError for what is no pair, or a key that the experiment does not know.
    """
    values: dict[str, list[str]] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise UsageError(f"--set {pair}: must be KEY=VALUE")
        if key not in experiment.settings:
            known = ", ".join(experiment.settings) or "no keys"
            raise UsageError(f"--set {pair}: the experiment knows no {key!r}; it knows: {known}")
        values.setdefault(key, []).append(value)
    return values


def run(
    name: str,
    options: Options,
    out: Path,
    *,
    jobs: int,
    overwrite: bool = False,
    resume: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> Findings:
    """Run an experiment and leave its files in a folder; `tell` is given its progress.

    What each trial found is kept as soon as it is known: with `resume` only those are run that the
    folder does not hold yet.

    Raises StudyError for bad input; nothing is written then.
    """
    if options.seeds < 1 or jobs < 1:
        raise UsageError(f"--seeds {options.seeds} --jobs {jobs}: both must be at least 1")
    if resume and overwrite:
        raise UsageError("--resume --overwrite: one goes on with what the other takes away")
    keeper = Keeper(out, name)
    if resume:
        keeper.check()
    else:
        folder.check(out, overwrite=overwrite)
    experiment = load(name)
    trials = experiment.trials(options)
    missing = [trial for trial in trials if not resume or keeper.rows(trial) is None]
    kept = len(trials) - len(missing)
    for done, found in enumerate(_measured(experiment, missing, jobs)):
        if done == 0 and not resume:
            folder.prepare(out, overwrite=overwrite)
            keeper.start()
        keeper.keep(missing[done], found)
        tell(f"{name}: {kept + done + 1} of {len(trials)} trials")
    rows = [row for trial in trials for row in keeper.rows(trial) or ()]
    findings = experiment.conclude(rows)
    _write(out, name, options, findings, rows)
    save_figure(out / "figure.png", lambda figure: experiment.draw(figure, rows))
    return findings


def _measured(experiment: Experiment[T], trials: Sequence[T], jobs: int) -> Iterator[Sequence[Row]]:
    """Yield the rows of each trial, in the order of the trials, however many run at a time."""
    if jobs == 1 or len(trials) < 2:
        yield from map(experiment.measure, trials)
        return
    with workers(min(jobs, len(trials))) as pool:
        yield from pool.map(experiment.measure, trials)


def default_jobs() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0))


def _write(out: Path, name: str, options: Options, findings: Findings, rows: Sequence[Row]) -> None:
    write_atomic(out / "rows.csv", rows_csv(rows))
    for table in findings.tables:
        write_atomic(out / f"{table.name}.csv", as_csv(table))
    told = {
        "schema": SCHEMA,
        "experiment": name,
        "seeds": options.seeds,
        "sets": {key: list(values) for key, values in options.sets.items()},
        "claims": [asdict(claim) for claim in findings.claims],
        "tables": [as_data(table) for table in findings.tables],
    }
    write_atomic(out / "experiment.json", json.dumps(told, indent=2) + "\n")


def told(findings: Findings) -> str:
    """Return all findings for a person to read."""
    tables = [as_text(table) for table in findings.tables]
    return "\n\n".join([*tables, *([_claims(findings.claims)] if findings.claims else [])])


def _claims(claims: Sequence[Claim]) -> str:
    lines = ["Claims"]
    for claim in claims:
        verdict = "held" if claim.held else "did not hold"
        lines += [f"  {verdict}: {claim.text} ({claim.source})", f"    {claim.found}"]
    return "\n".join(lines)
