"""A study file: a scenario, what is changed in it, along which axes, and how it is drawn.

Its trials are all combinations of one case (where there are cases), one value of each axis, and one
seed. Each trial is a complete scenario, known by a digest of it: the same trial is never run twice.
"""

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self, cast

from pydantic import Field, ValidationError, model_validator

from comms.settings import Settings
from scenarios import shelf
from scenarios.errors import ScenarioError
from scenarios.schema import Scenario, dump, load
from scenarios.schema.overrides import Override, parse_override, split_key
from scenarios.schema.problems import sentences

MAX_TRIALS = 100_000
"""More than anybody waits for."""
ID_CHARS = 12

Value = str | int | float | bool
"""What a column of the table holds."""
Tables = dict[str, Any]


class Case(Settings):
    """One way to change several keys together, and what it is called in the table."""

    told: Annotated[dict[str, Value], Field(alias="is", min_length=1)]
    """Columns of the table and this case's values in them."""
    set: Tables = Field(default_factory=Tables)
    """Keys of the scenario and their values."""


class Picture(Settings):
    """What is drawn when the sweep has ended, as `ropeteam plot` takes it."""

    x: str
    y: Annotated[tuple[str, ...], Field(min_length=1, max_length=6)]
    by: str | None = None


class Study(Settings):
    """A study as its file has it."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    """Letters, digits, '.', '-' and '_', at most 64; the study's folder is called after it."""
    title: str = ""
    """One line: what the study answers."""
    scenario: str
    """A name of the library, or a file (from this file's folder or from where the user is)."""
    seeds: Annotated[int, Field(ge=1, le=10_000)] = 5
    """Seeds 1, 2, ... this; more with `--seeds`."""
    set: Tables = Field(default_factory=Tables)
    """Keys of the scenario that are the same in all trials."""
    axes: Tables = Field(default_factory=Tables)
    """Keys of the scenario, each with the list of its values."""
    cases: tuple[Case, ...] = ()
    """Changes of several keys at a time, one after another."""
    plot: Picture | None = None

    @model_validator(mode="after")
    def _same_columns(self) -> Self:
        columns = [list(case.told) for case in self.cases]
        for names in columns[1:]:
            if names != columns[0]:
                wanted, found = ", ".join(columns[0]), ", ".join(names)
                raise ValueError(f"all cases must tell the same columns: {wanted}; one has {found}")
        return self


@dataclass(frozen=True)
class Trial:
    """One run of a study."""

    id: str
    """Of the complete scenario: its digest."""
    values: Mapping[str, Value]
    """What it has on each axis, and its seed: columns of the table."""
    text: str
    """The complete scenario, as TOML."""


def find(name_or_path: str) -> Path:
    """Return the study file that a user means: a name of those shipped, or a path.

    Raises:
        ScenarioError: there is none.

    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    shipped = shelf.names(shelf.STUDIES)
    if name_or_path in shipped:
        return shelf.STUDIES / f"{name_or_path}.toml"
    allowed = f"{', '.join(shipped)}, or a path to a .toml file"
    raise ScenarioError([f"{name_or_path}: there is no such study; allowed: {allowed}"])


def read_study(path: Path, *, seeds: int | None = None) -> Study:
    """Read a study file; `seeds` replaces its own number of them.

    Raises:
        ScenarioError: with one sentence per problem.

    """
    tables = shelf.read(path)
    if seeds is not None:
        tables["seeds"] = seeds
    try:
        # As JSON: strict about types, and lists are taken for tuples.
        return Study.model_validate_json(json.dumps(tables, default=str))
    except ValidationError as error:
        raise ScenarioError(sentences(error, Study, lambda _: str(path))) from error


def trials(study: Study, path: Path, sets: Sequence[str] = ()) -> list[Trial]:
    """Return all trials of a study, the cases slowest and the seeds fastest.

    `sets` are KEY=VALUE changes of the user's for all of them.

    Raises:
        ScenarioError: a trial is no sound scenario; one sentence per problem.

    """
    asked = [parse_override(text) for text in sets]
    source = _scenario_file(study, path)
    count = study.seeds * len(study.cases or (0,))
    for axis in _axes(study, path):
        count *= len(axis.values)
    if count > MAX_TRIALS:
        raise ScenarioError([f"{path}: makes {count} trials; at most {MAX_TRIALS} are allowed"])
    return list(_trials(study, path, source, asked))


def _trials(study: Study, path: Path, source: str, asked: Sequence[Override]) -> Iterator[Trial]:
    common = [*_overrides(study.set, f"{path} [set]"), *asked]
    axes = _axes(study, path)
    for case in study.cases or (None,):
        told = dict(case.told) if case else {}
        changes = [*common, *(_overrides(case.set, f"{path} [[cases]]") if case else ())]
        for picks in itertools.product(*(axis.values for axis in axes)):
            chosen = [axis.override(pick) for axis, pick in zip(axes, picks, strict=True)]
            columns = {axis.key: shown(v) for axis, v in zip(axes, picks, strict=True)}
            for seed in range(1, study.seeds + 1):
                scenario = load(source, [*changes, *chosen, *_IN_MEMORY], seed=seed)
                yield _trial(scenario, {**told, **columns, "seed": seed})


_IN_MEMORY = tuple(
    parse_override(text) for text in ("air=memory", "clock.mode=virtual", "clock.speed=1.0")
)
"""A trial is one process on the virtual clock: so it is a function of its scenario alone."""


def _trial(scenario: Scenario, values: Mapping[str, Value]) -> Trial:
    text = dump(scenario)
    return Trial(hashlib.sha256(text.encode()).hexdigest()[:ID_CHARS], values, text)


def shown(value: Any) -> Value:
    """Return a key's value as the table shows it: text, where it is more than one."""
    return value if isinstance(value, str | int | float | bool) else repr(value)


@dataclass(frozen=True)
class Axis:
    """One key of the scenario, and the values that it takes."""

    key: str
    path: tuple[str, ...]
    values: Sequence[Any]
    option: str

    def override(self, value: Any) -> Override:
        """Return the change that gives the key a value."""
        return Override(f"{self.option} {self.key} = {value!r}", self.path, value)


def _axes(study: Study, path: Path) -> list[Axis]:
    option = f"{path} [axes]"
    axes: list[Axis] = []
    for parts, values in _leaves(study.axes, option):
        key = ".".join(parts)
        if not isinstance(values, list) or not values:
            raise ScenarioError([f"{option}: {key} = {values!r}: must be a list of its values"])
        if key in ("seed", "air", "clock.mode", "clock.speed"):
            raise ScenarioError([f"{option}: {key}: can't be an axis (for seeds there is `seeds`)"])
        axes.append(Axis(key, parts, cast("list[Any]", values), option))
    taken = set(study.cases[0].told) if study.cases else set[str]()
    for key in ("seed", *(axis.key for axis in axes)):
        if key in taken:
            raise ScenarioError([f"{path}: {key}: two columns have this name"])
        taken.add(key)
    return axes


def _overrides(tables: Tables, option: str) -> list[Override]:
    return [
        Override(f"{option} {'.'.join(parts)} = {value!r}", parts, value)
        for parts, value in _leaves(tables, option)
    ]


def _leaves(tables: Tables, option: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the key, part by part, and value of all that is no table; keys may be dotted texts."""
    for key, value in tables.items():
        # A quoted part ("a>b") may hold anything; a dotted text is split like a `--set`.
        parts = split_key(key, option) if "." in key else (key,)
        if isinstance(value, dict) and value:
            for below, leaf in _leaves(cast("Tables", value), option):
                yield (*parts, *below), leaf
        else:
            yield parts, value


def _scenario_file(study: Study, path: Path) -> str:
    beside = path.parent / study.scenario
    if study.scenario.endswith(".toml") and beside.is_file():
        return str(beside)
    return str(shelf.find(study.scenario))
