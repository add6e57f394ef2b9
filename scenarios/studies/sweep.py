"""A sweep: a study's trials, in a folder that can be left at any time and gone on with.

In the folder: `study.toml`, a folder `trials/ID` for each trial that ended (its `scenario.toml`,
`summary.json` and `host.json`, or `error.log`; `trial.json` is written last and says that all is
there), and, made anew whenever a sweep ends, `trials.parquet`.
"""

import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

from scenarios.errors import FolderError
from scenarios.records import folder
from scenarios.records.tables import write_atomic
from scenarios.studies.engine import Engine
from scenarios.studies.study import Study, Trial
from scenarios.studies.table import FILE, row_of, write_table
from scenarios.studies.trial import Told

TRIALS = "trials"
STUDY = "study.toml"
SCHEMA = 1


@dataclass(frozen=True)
class Progress:
    """How far a sweep has come."""

    total: int
    done: int
    """Ended in whatever way, those of former sweeps included."""
    failed: int
    left_s: float | None
    """Wall time that the rest will take, by what the trials of this sweep took; None: unknown."""


@dataclass(frozen=True)
class Swept:
    """What a sweep leaves."""

    out: Path
    total: int
    done: int
    failed: int
    kept: int
    """Trials that a former sweep had run already."""


def sweep(
    study: Study,
    trials: Sequence[Trial],
    out: Path,
    engine: Engine,
    *,
    source: str,
    overwrite: bool = False,
    retry: bool = False,
    tell: Callable[[Progress], None] = lambda _: None,
) -> Swept:
    """Run all trials that `out` does not hold yet; write the table, whatever happens.

    Args:
        study: what is studied; `source` is its text, which is kept beside the results.
        trials: of the study.
        out: a folder that is new, empty, or holds an earlier sweep of a study of this name.
        engine: runs the trials.
        source: the study's file.
        overwrite: start anew.
        retry: run those again that failed.
        tell: is given the progress.

    Raises:
        FolderError: `out` can't be used.

    """
    _open(out, study, overwrite=overwrite)
    write_atomic(out / STUDY, source)
    unique = list({trial.id: trial for trial in trials}.values())
    if retry:
        _forget_failed(out, unique)
    ended = {trial.id: told for trial in unique if (told := read_trial(out, trial)) is not None}
    kept = len(ended)
    pending = [trial for trial in unique if trial.id not in ended]
    clock = _Clock(len(unique), kept)
    try:
        tell(clock.progress(ended))
        if pending:
            for trial, told in engine(pending, out):
                _keep(out, trial, told)
                ended[trial.id] = told
                tell(clock.progress(ended))
    finally:
        _write_table(out, study, trials, ended)
    failed = sum(told.state == "failed" for told in ended.values())
    return Swept(out, len(unique), len(ended), failed, kept)


class _Clock:
    """Guesses how long the rest will take, from how long the trials of this sweep took."""

    def __init__(self, total: int, kept: int) -> None:
        self._total, self._kept = total, kept
        self._started_s = time.monotonic()

    def progress(self, ended: dict[str, Told]) -> Progress:
        """Return how far it is."""
        done, here = len(ended), len(ended) - self._kept
        spent_s = time.monotonic() - self._started_s
        left_s = spent_s / here * (self._total - done) if here else None
        failed = sum(told.state == "failed" for told in ended.values())
        return Progress(self._total, done, failed, left_s)


def _open(out: Path, study: Study, *, overwrite: bool) -> None:
    """Make a sweep's folder, or take up the one that is there."""
    former = out / STUDY
    if not overwrite and former.is_file() and (out / folder.MARK).is_file():
        name = _name_in(former)
        if name != study.name:
            raise FolderError(
                f"--out {out}: holds the study {name!r}, not {study.name!r}; must be new or empty,"
                " or add --overwrite"
            )
        return
    folder.prepare(out, overwrite=overwrite)


def _name_in(path: Path) -> str:
    for line in path.read_text(errors="replace").splitlines():
        key, _, value = line.partition("=")
        if key.strip() == "name":
            return value.split("#")[0].strip().strip("\"'")
    return ""


def _keep(out: Path, trial: Trial, told: Told) -> None:
    """Write what came of a trial; `trial.json` last."""
    place = out / TRIALS / trial.id
    place.mkdir(parents=True, exist_ok=True)
    write_atomic(place / "scenario.toml", trial.text)
    for name, text in (
        ("summary.json", told.summary),
        ("host.json", told.host),
        ("error.log", told.log),
    ):
        if text:
            write_atomic(place / name, text)
    facts = {key: value for key, value in asdict(told).items() if key in _FACTS}
    written = {"schema": SCHEMA, "values": dict(trial.values), **facts}
    write_atomic(place / "trial.json", json.dumps(written, indent=2) + "\n")


_FACTS = ("state", "error", "measures")


def read_trial(out: Path, trial: Trial) -> Told | None:
    """Return what came of a trial by a sweep's folder; None where it has not ended."""
    place = out / TRIALS / trial.id
    try:
        facts = cast("dict[str, Any]", json.loads((place / "trial.json").read_text()))
        told = Told(**{key: facts[key] for key in _FACTS})
        if told.state == "failed":
            return told
        summary = (place / "summary.json").read_text()
        return Told(told.state, told.error, summary=summary, measures=told.measures)
    except (OSError, ValueError, KeyError, TypeError):
        return None  # cut short, or never begun: it is run (again)


def _forget_failed(out: Path, trials: Sequence[Trial]) -> None:
    for trial in trials:
        told = read_trial(out, trial)
        if told is not None and told.state == "failed":
            shutil.rmtree(out / TRIALS / trial.id)


def _write_table(out: Path, study: Study, trials: Sequence[Trial], ended: dict[str, Told]) -> None:
    rows = [row_of(trial, ended.get(trial.id)) for trial in trials]
    facts = {"study": study.name, "title": study.title, "ropeteam": version("ropeteam")}
    write_table(out / FILE, rows, facts)
