"""For those who build on it: parts of other packages, schemas, a new study, the Python API."""

import json
import os
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import jsonschema
import pytest

import scenarios
from agents import planar
from agents.planning.strategies import STRATEGIES
from agents.sharing import WAYS
from agents.voxel import choosing
from comms.plugins import PluginError, Plugins
from scenarios import cli
from scenarios.jsonschema import NAMED, scenario_schema, study_schema, text
from scenarios.schema import load
from scenarios.shelf import LIBRARY, STUDIES
from sim.sensors import SENSORS
from sim.terrain import TERRAINS

ROOT = Path(__file__).parents[1]
GROUPS = {
    STRATEGIES.group,
    planar.METHODS.group,
    choosing.METHODS.group,
    WAYS.group,
    SENSORS.group,
    TERRAINS.group,
}


@pytest.fixture(scope="module")
def outside(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a study made by `ropeteam new`, and the folder that it was installed to."""
    folder = tmp_path_factory.mktemp("outside")
    study, site = folder / "near-first", folder / "site"
    assert cli.main(["new", str(study)]) == 0
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--target", str(site)]
    command = [sys.executable, "-m", "pip", "install", *options, str(study)]
    subprocess.run(command, check=True, capture_output=True)
    return study, site


def ropeteam(folder: Path, site: Path, *args: str) -> subprocess.CompletedProcess[str]:
    """Run the command line as somebody who has installed a package of their own."""
    path = os.pathsep.join([str(ROOT), str(site)])
    return subprocess.run(
        [sys.executable, "-m", "scenarios.cli", *args],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


@pytest.mark.parametrize("air", ["memory", "zenoh"])
def test_a_strategy_of_an_installed_package_chooses_the_looks(
    outside: tuple[Path, Path], tmp_path: Path, air: str
) -> None:
    study, site = outside
    options = ["--set", f"air={air}", "--set", "limit_s=200", "--out", str(tmp_path / "run")]
    done = ropeteam(study, site, "run", "scenario.toml", *options)
    assert done.returncode == 0, done.stderr
    run = scenarios.open_run(tmp_path / "run")
    assert len(run.looks) == sum(robot["looks"] for robot in run.summary["robots"].values())
    assert len(run.looks) > 12, "more than the first ones all round"
    assert run.frames[0]["from"] in run.summary["robots"]


def test_without_the_package_its_name_is_refused_in_one_sentence(
    outside: tuple[Path, Path], tmp_path: Path
) -> None:
    study, _ = outside
    (tmp_path / "scenario.toml").write_text((study / "scenario.toml").read_text())
    done = ropeteam(tmp_path, tmp_path, "run", "scenario.toml", "--out", str(tmp_path / "run"))
    assert done.returncode == 2
    assert done.stderr.startswith('scenario.toml: method = "near-first": must be one of inform')
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_the_schema_of_an_installation_knows_its_packages(outside: tuple[Path, Path]) -> None:
    study, site = outside
    told = json.loads(ropeteam(study, site, "schema", "scenario").stdout)
    assert "near-first" in told["properties"]["method"]["enum"]
    assert "near-first" not in scenario_schema()["properties"]["method"]["enum"]


class FromElsewhere:
    """Entry points as `importlib.metadata` gives them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **points: str) -> None:
        found = [metadata.EntryPoint(name, value, "a.group") for name, value in points.items()]
        monkeypatch.setattr("comms.plugins.entry_points", lambda group: found)


def test_the_house_keeps_its_own_names_and_loads_nothing_unasked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    FromElsewhere(monkeypatch, mine="no.such.module:x", other="math:pi", b="math:e")
    parts: Plugins[float] = Plugins("a.group", {"mine": 1.0})
    assert parts.names() == ("mine", "b", "other")
    assert parts.find("mine") == 1.0
    assert parts.find("b") == pytest.approx(2.718281828)
    assert "other" in parts
    assert "none" not in parts


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (
            "no_such_module:x",
            'a.group: "bad" can\'t be loaded from no_such_module:x: ModuleNotFound',
        ),
        ("math:nothing", "AttributeError"),
    ],
)
def test_a_package_that_does_not_load_is_told(
    monkeypatch: pytest.MonkeyPatch, value: str, words: str
) -> None:
    FromElsewhere(monkeypatch, bad=value)
    with pytest.raises(PluginError, match=words.replace("(", r"\(")):
        Plugins("a.group", {}).find("bad")


def test_every_group_is_named_where_builders_look() -> None:
    template = (ROOT / "scenarios" / "template" / "pyproject.toml").read_text()
    page = (ROOT / "docs" / "building.md").read_text()
    for group in GROUPS:
        assert group in template
        assert f"`{group}`" in page


# --- schemas --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("folder", "schema", "name"),
    [(LIBRARY, scenario_schema, "scenario"), (STUDIES, study_schema, "study")],
)
def test_shipped_files_name_their_schema_and_obey_it(folder: Path, schema, name: str) -> None:
    assert (folder / f"{name}.schema.json").read_text() == text(schema())
    paths = sorted(folder.glob("*.toml"))
    assert paths
    for path in paths:
        content = path.read_text()
        assert content.startswith(f"#:schema ./{name}.schema.json\n")
        jsonschema.validate(tomllib.loads(content), schema())


def test_the_schema_marks_what_the_program_refuses() -> None:
    tables = tomllib.loads((LIBRARY / "pair.toml").read_text())
    check = jsonschema.Draft202012Validator(scenario_schema())
    assert check.is_valid(tables)
    for wrong in (
        {"methd": "random"},
        {"method": "randm"},
        {"limit_s": -1},
        {"sensor": {"kind": "sonar"}},
        {"robots": {"count": 0}},
    ):
        assert not check.is_valid(tables | wrong), wrong


def test_every_key_that_names_a_part_is_told_in_the_schema() -> None:
    schema = scenario_schema()
    for (table, key), (kinds, more) in NAMED.items():
        node = schema["$defs"][table] if table else schema
        own = {name for kind in kinds for name in kind.own}
        assert set(node["properties"][key]["enum"]) == own | set(more)


# --- a new study, and the rest ------------------------------------------------------------------


def test_a_new_study_is_whole_and_obeys_the_schemas(outside: tuple[Path, Path]) -> None:
    study, _ = outside
    for kind, schema in (("scenario", scenario_schema), ("study", study_schema)):
        content = (study / f"{kind}.toml").read_text()
        told = tomllib.loads(content.replace("near-first", "random"))
        jsonschema.validate(told, schema())
        assert content.startswith(f"#:schema ./{kind}.schema.json\n")
        assert (study / f"{kind}.schema.json").is_file()
    assert "NAME" not in "".join(p.read_text() for p in study.iterdir() if p.is_file())


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("My Study", "is no name for a study"),
        ("9lives", "is no name for a study"),
        ("sim", "is taken by Python or by ropeteam"),
        ("class", "is taken by Python or by ropeteam"),
    ],
)
def test_a_bad_name_for_a_study_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, words: str
) -> None:
    assert cli.main(["new", str(tmp_path / name)]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / name).exists()


def test_nothing_is_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "README.md").write_text("my own")
    assert cli.main(["new", str(tmp_path / "mine")]) == 2
    assert "holds files; must be new or empty" in capsys.readouterr().err
    assert (tmp_path / "mine" / "README.md").read_text() == "my own"


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_a_shell_completes_commands_and_options(
    shell: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["completion", shell]) == 0
    told = capsys.readouterr().out
    assert "experiment" in told
    assert "overwrite" in told


def test_the_public_names_are_there_and_cost_nothing_before() -> None:
    code = "import scenarios, sys; print('numpy' in sys.modules, 'pydantic' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["False", "False"]
    assert scenarios.load is load
    for name in scenarios.__all__:
        assert getattr(scenarios, name) is not None
    with pytest.raises(AttributeError, match="no_such"):
        scenarios.no_such  # noqa: B018


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(scenarios.StudyError, match="holds no run that has ended"):
        scenarios.open_run(tmp_path)
