"""The study: scenario files, the runner, the command line, records and reports.

For programs of your own:

    from scenarios import load, run

    scenario = load("cliff", ["links.rate_bps=600"], seed=3)
    result = run(scenario, Path("runs/mine"))
    print(result.summary["team"]["coverage"])

What a run leaves besides its records is said by `RunOptions`, or by name: `run(scenario, out,
quiet=True)`.

Names are looked up when they are first used, so that `import scenarios` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scenarios.errors import ScenarioError, StudyError
    from scenarios.records.reading import Run, open_run
    from scenarios.runner import RunOptions, RunResult, run
    from scenarios.schema import Scenario, dump, load

__all__ = [
    "Run",
    "RunOptions",
    "RunResult",
    "Scenario",
    "ScenarioError",
    "StudyError",
    "dump",
    "load",
    "open_run",
    "run",
]

_HOMES = {
    "Run": "records.reading",
    "RunOptions": "runner",
    "RunResult": "runner",
    "Scenario": "schema",
    "ScenarioError": "errors",
    "StudyError": "errors",
    "dump": "schema",
    "load": "schema",
    "open_run": "records.reading",
    "run": "runner",
}


def __getattr__(name: str) -> object:
    """Return a public name from the module that it lives in."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
