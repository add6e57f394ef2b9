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
FLAT = ("air=memory", "limit_s=20", "planner.max_looks=2")
EYES = (
    *BRIEF, "air=memory", "world.window_m=[16.0, 14.0]", "map.cell_m=0.2",
    "sensor.stereo.width_px=160", "sensor.stereo.height_px=120",
)  # fmt: skip
SETS = {
    "cliff": (*SMALL, *LOW_CLIFF, *BRIEF),
    "field": (*EYES, "world.terrain.drop_m=3.0"),
    "planar": FLAT,
    "cave": (*FLAT, "world.cave.chambers=2"),
}
"""Added to `ropeteam run NAME` as `--set`; to all other scenarios `SMALL` and `BRIEF`."""
MORE = {
    "run": ("--quiet",),
    "sweep": ("--jobs", "1", "--quiet"),
    "link": ("--bytes", "200"),
    "new": (),
}
"""Added to commands of a kind, where the option is not there already."""
REPLACED = {
    "--look 7": "--look 1",
    "--break-at 455": "--break-at 10",
    "--speed 20": "--speed 200",
    "sweep bandwidth": "sweep bandwidth.toml",
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

    def has(self, *words: str) -> bool:
        return all(word in self.argv for word in words)


def commands(page: Path) -> list[Command]:
    """Return the commands of a page in order: `ropeteam ...`, and `cd` between them."""
    fences = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)
    lines = [line for kind, code in fences if kind in SHELL for line in code.splitlines()]
    return [Command(page.name, line) for line in lines if re.match(r"(ropeteam|cd) ", line)]


def scenarios(page: Path) -> dict[str, str]:
    """Return the scenario files that a page has the reader write, by the name that they bear."""
    blocks = re.findall(r"^```toml\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)
    named = ((re.search(r'^name = "([^"]+)"', block, re.M), block) for block in blocks)
    return {f"{found[1]}.toml": block for found, block in named if found}


def smaller(command: Command) -> list[str]:
    """Return a command's words after `ropeteam`, as a test runs it."""
    line = command.line
    for long, short in REPLACED.items():
        line = line.replace(long, short)
    argv = shlex.split(line, comments=True)[1:]
    if argv[0] == "run" and "--help" not in argv:
        sets = SETS.get(argv[1], (*SMALL, *BRIEF))
        if "sensor.kind=stereo" in argv:
            sets = EYES
        if "real" in argv:
            sets = tuple(one for one in sets if not one.startswith("air="))
        argv += [word for one in sets for word in ("--set", one)]
    if "--view" in argv:
        argv.append("--no-browser")
    more = MORE.get(argv[0], ())
    return [*argv, *(() if set(more) & set(argv) else more)]


def study(text: str) -> str:
    """Return a shipped study with two values on each axis and tiny trials."""
    text = re.sub(r"^(\S+ = \[[^,\]]+, [^,\]]+),[^\]]*\]", r"\1]", text, flags=re.M)
    text = re.sub(r"^limit_s = .*", "limit_s = 20", text, flags=re.M)
    text = re.sub(r"^seeds = .*", "seeds = 1", text, flags=re.M)
    return re.sub(r"^planner.max_looks = .*", "planner.max_looks = 1", text, flags=re.M)
