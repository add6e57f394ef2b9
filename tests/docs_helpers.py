"""The commands of the documents as they stand there, and how a test makes them smaller.

A test changes commands by the tables here and in no other way: what is not in them is run as it is
written.
"""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from run_helpers import LOW_CLIFF, SMALL

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SHELL = ("", "sh")
"""Fences that hold commands are marked as these."""

BRIEF = ("limit_s=20", "planner.max_looks=1", "planner.first_looks=1", "planner.headings=4")
FLAT = ("air=memory", "limit_s=20", "planner.max_looks=2", "world.window_m=[12.0, 12.0]")
EYES = (
    *BRIEF, "air=memory", "world.window_m=[16.0, 14.0]", "map.cell_m=0.2",
    "sensor.stereo.width_px=160", "sensor.stereo.height_px=120", *LOW_CLIFF,
)  # fmt: skip
OWN = (
    "air=memory", "map.cell_m=0.2", "sensor.columns=64", "sensor.rows=48",
    "planner.max_candidates=20", *BRIEF,
)  # fmt: skip
"""Of files that the page has the reader write; in them all happens `SOONER` times sooner."""
SOONER = 50
SETS = {
    "cliff": (*SMALL, *LOW_CLIFF, *BRIEF),
    "pair": (*SMALL, *BRIEF),
    "planar": FLAT,
    "cave": (*FLAT, "world.cave.chambers=1"),
}
"""Added to `ropeteam run NAME` as `--set`."""
MORE = {"run": ("--quiet",), "sweep": ("--jobs", "1"), "link": ("--bytes", "200")}
"""Added to commands of a kind, where the option is not there already."""
REPLACED = {
    "--look 7": "--look 1",
    "--break-at 455": "--break-at 10",
    "--speed 20": "--speed 200",
    "sweep bandwidth": "sweep bandwidth.toml",
    "runs/bandwidth --scheduler tcp://10.0.0.7:8786": "runs/far --scheduler tcp://127.0.0.1:1",
}
"""A run of a few seconds has no seventh look; the file is the study with fewer values (`study`)."""


@dataclass(frozen=True)
class Command:
    """One line of a page's code."""

    page: str
    line: str

    @property
    def argv(self) -> list[str]:
        return shlex.split(self.line, comments=True)


def commands(page: Path) -> list[Command]:
    """Return the commands of a page in order: `ropeteam ...`, and what stands between them."""
    fences = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)
    lines = [line for kind, code in fences if kind in SHELL for line in code.splitlines()]
    return [
        Command(page.name, line)
        for line in lines
        if re.match(r"ropeteam |cd |pip install -e", line)
    ]


def scenarios(page: Path) -> dict[str, str]:
    """Return the scenario files that a page has the reader write, by the name that they bear."""
    blocks = re.findall(r"^```toml\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)
    blocks = [re.sub(r"^(at_s|after_s) = (\d+)", _sooner, block, flags=re.M) for block in blocks]
    named = ((re.search(r'^name = "([^"]+)"', block, re.M), block) for block in blocks)
    return {f"{found[1]}.toml": block for found, block in named if found}


def _sooner(found: re.Match[str]) -> str:
    return f"{found[1]} = {int(found[2]) / SOONER}"


def smaller(command: Command) -> list[str]:
    """Return a command's words after `ropeteam`, as a test runs it."""
    line = command.line
    for long, short in REPLACED.items():
        line = line.replace(long, short)
    argv = shlex.split(line, comments=True)[1:]
    if argv[0] == "run" and "--help" not in argv:
        sets = EYES if "sensor.kind=stereo" in argv else SETS.get(argv[1], OWN)
        if "real" in argv:
            sets = tuple(one for one in sets if not one.startswith("air="))
        argv += [word for one in sets for word in ("--set", one)]
    if "--view" in argv:
        argv.append("--no-browser")
    more = MORE.get(argv[0], ())
    return [*argv, *(() if {*more, "--scheduler"} & set(argv) else more)]


def study(text: str) -> str:
    """Return a shipped study with two values on each axis and tiny trials."""
    text = re.sub(r"^(\S+ = \[[^,\]]+, [^,\]]+),[^\]]*\]", r"\1]", text, flags=re.M)
    text = re.sub(r"^limit_s = .*", "limit_s = 20", text, flags=re.M)
    text = re.sub(r"^seeds = .*", "seeds = 1", text, flags=re.M)
    return re.sub(r"^planner.max_looks = .*", "planner.max_looks = 1", text, flags=re.M)
