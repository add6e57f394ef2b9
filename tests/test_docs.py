"""What the documents say can be done can be done: commands parse, examples load, links lead on."""

import importlib.util
import re
import shlex
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

from scenarios.cli import make_parser
from scenarios.records.tables import EVENT_COLUMNS, FRAME_COLUMNS, LOOK_COLUMNS, MAP_COLUMNS
from scenarios.schema import Scenario, load, parse
from scenarios.schema.overrides import parse_override
from scenarios.shelf import names

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
OF_FILES = (
    "world.map",
    "world.terrain.file",
    "world.terrain.cell_m",
    "world.terrain.grey_m",
    "robots.recon.recording",
)
"""Settings that need a file of the reader's."""
LIBRARY = sorted((ROOT / "scenarios" / "library").glob("*.toml"))
CLIFF = ROOT / "scenarios" / "library" / "cliff.toml"


def text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def commands(page: Path) -> list[str]:
    """Return every `ropeteam ...` command in a page's code blocks, its comment cut off."""
    lines = [line for block in blocks(page, "") for line in block.splitlines()]
    if page.suffix == ".toml":
        lines = [line.lstrip("# ").removeprefix("Try:").strip() for line in text(page).splitlines()]
        lines = [re.sub(r"\s+\([^)]*\)$", "", line) for line in lines]
    return [line for line in lines if line.startswith("ropeteam ")]


def blocks(page: Path, language: str) -> list[str]:
    """Return the code blocks of a page that are marked as of one language (or as of none)."""
    fences = re.findall(r"^```(\w*)\n(.*?)^```$", text(page), re.MULTILINE | re.DOTALL)
    return [code for marked, code in fences if marked == language]


def makefile_targets() -> set[str]:
    return set(re.findall(r"^([a-z][a-z-]*):", text(ROOT / "Makefile"), re.MULTILINE))


def all_commands() -> list[tuple[str, str]]:
    pages = [*PAGES, *LIBRARY]
    return [(page.name, command) for page in pages for command in commands(page)]


@pytest.mark.parametrize(("page", "command"), all_commands())
def test_every_command_in_the_documents_is_understood(page: str, command: str) -> None:
    del page
    argv = shlex.split(command, comments=True)[1:]
    if "--help" in argv:
        argv.remove("--help")
        assert argv in ([], ["run"])
        return
    args = make_parser().parse_args(argv)
    if args.command != "run":
        return
    sets = [setting for setting in args.sets if not setting.startswith(OF_FILES)]
    changes = [parse_override(setting) for setting in sets]
    clock = [parse_override(f"clock.mode={args.clock}")] if args.clock else []
    speed = [parse_override(f"clock.speed={args.speed}")] if args.speed else []
    if args.scenario.endswith(".toml"):
        return  # a file that the reader is to make
    assert args.scenario in names()
    scenario = load(args.scenario, [*changes, *clock, *speed], seed=args.seed)
    assert isinstance(scenario, Scenario)


def test_the_documents_have_commands() -> None:
    assert len(all_commands()) > 15


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_scenario_in_the_documents_is_sound(page: Path) -> None:
    for block in blocks(page, "toml"):
        tables = tomllib.loads(block)
        if "name" not in tables:  # a part: lay it over the cliff
            tables = tomllib.loads(text(CLIFF)) | tables
        assert parse(tables, page.name).limit_s > 0


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)\s]+)\)", text(page))
    files = [target.split("#")[0] for target in targets if "://" not in target]
    missing = [file for file in files if file and not (page.parent / file).exists()]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_make_target_exists(page: Path) -> None:
    named = set(re.findall(r"\bmake ([a-z][a-z-]+)\b", "\n".join(code(page))))
    assert named <= makefile_targets()


def code(page: Path) -> list[str]:
    """Return all that stands as code in a page: blocks and single words."""
    return [*blocks(page, ""), *re.findall(r"`([^`\n]+)`", text(page))]


def test_the_readme_names_every_column() -> None:
    readme = text(ROOT / "README.md")
    grouped = {"x_m", "y_m", "z_m"}  # "true position"
    for columns in (LOOK_COLUMNS, FRAME_COLUMNS, MAP_COLUMNS, EVENT_COLUMNS):
        assert [c for c in columns if c not in grouped and f"`{c}`" not in readme] == []


def scenario_keys() -> ModuleType:
    spec = importlib.util.spec_from_file_location("scenario_keys", ROOT / "docs/scenario_keys.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_of_keys_is_up_to_date() -> None:
    page = text(ROOT / "docs" / "scenarios.md")
    assert scenario_keys().with_tables(page) == page, "run: make scenario-keys"


def test_every_setting_is_on_the_page_of_keys() -> None:
    page = text(ROOT / "docs" / "scenarios.md")
    dumped = load("cliff").model_dump()
    tables = [dumped, *(table for table in dumped.values() if isinstance(table, dict))]
    keys = {key for table in tables for key, value in table.items() if not isinstance(value, dict)}
    assert [key for key in sorted(keys - {"events"}) if f"| `{key}` |" not in page] == []


def test_constraints_pin_names_and_versions_only() -> None:
    lines = text(ROOT / "constraints.txt").splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert [
        line for line in pins if not re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+", line)
    ] == []


def test_constraints_pin_every_dependency() -> None:
    project = tomllib.loads(text(ROOT / "pyproject.toml"))["project"]
    extras = project["optional-dependencies"].values()
    wanted = [*project["dependencies"], *(need for needs in extras for need in needs)]
    pinned = {plain(line.split("==")[0]) for line in text(ROOT / "constraints.txt").splitlines()}
    assert [need for need in wanted if plain(re.split(r"[\[<>=!~ ]", need)[0]) not in pinned] == []


def plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
