"""What a person sees while a run goes on: a live table, or plain lines where is no terminal.

The wall clock only says here when to draw again; nothing is decided by it.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

REDRAW_S = 0.25
"""Wall seconds between two drawings of the table."""
LINE_S = 5.0
"""Wall seconds between two plain lines."""
LINE_ROBOTS = 8
"""Robots that a plain line tells of."""


@dataclass(frozen=True, slots=True)
class RobotNow:
    """One robot at a moment of a run."""

    name: str
    role: str
    state: str
    """alive, waiting, stopped, killed, left ... as the runner knows it."""
    doing: str = ""
    """In a few words, as the robot says."""
    looks: int = 0
    own_cells: int = 0
    team_cells: int = 0
    sent_bytes: int = 0
    link_use: float = 0.0
    """Share of the time so far that its transmitter was on the air."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A run at a moment."""

    t_s: float
    limit_s: float
    robots: Sequence[RobotNow] = field(default_factory=tuple[RobotNow, ...])


class LiveView:
    """Shows a run while it goes on; between `start` and `stop`, and usable as a context.

    `update` may be called as often as one likes: it draws only now and then.
    """

    def __init__(self, title: str, *, quiet: bool = False, stream: TextIO | None = None) -> None:
        """Make a view of a run of this title.

        Args:
            title: shown above the table.
            quiet: show nothing at all.
            stream: where to; left out: standard output.

        """
        self._title = title
        self._quiet = quiet
        self._stream = sys.stdout if stream is None else stream
        self._is_terminal = self._stream.isatty()
        self._live: Live | None = None
        self._due_s = 0.0
        self._last: Snapshot | None = None

    @property
    def quiet(self) -> bool:
        """Whether nothing is shown at all."""
        return self._quiet

    def __enter__(self) -> "LiveView":
        """Start."""
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop, whatever happened."""
        self.stop()

    def say(self, text: str) -> None:
        """Print a line of its own, e.g. that kernels are being compiled."""
        if self._quiet:
            return
        if self._live is not None:
            self._live.console.print(text, highlight=False, markup=False)
        else:
            print(text, file=self._stream, flush=True)

    def start(self) -> None:
        """Begin to show."""
        if self._quiet:
            return
        if not self._is_terminal:
            self.say(self._title)
            return
        from rich.console import Console
        from rich.live import Live

        console = Console(file=self._stream)
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._live.start()

    def update(self, snapshot: Snapshot) -> None:
        """Show a moment, if it is time to."""
        if self._quiet:
            return
        self._last = snapshot
        now_s = time.monotonic()
        if now_s < self._due_s:
            return
        self._due_s = now_s + (LINE_S if self._live is None else REDRAW_S)
        self._show(snapshot)

    def stop(self) -> None:
        """Show the last moment once more, and leave the terminal as it was."""
        if self._live is None:
            return
        if self._last is not None:
            self._show(self._last)
        self._live.stop()
        self._live = None

    def _show(self, snapshot: Snapshot) -> None:
        if self._live is None:
            self.say(line(snapshot))
        else:
            self._live.update(table(self._title, snapshot), refresh=True)


def clock_text(t_s: float) -> str:
    """Write a simulated time as h:mm:ss."""
    whole = int(t_s)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def line(snapshot: Snapshot) -> str:
    """Return a moment of a run as one plain line."""
    words = [_robot_words(robot) for robot in snapshot.robots[:LINE_ROBOTS]]
    if len(snapshot.robots) > LINE_ROBOTS:
        words.append(f"and {len(snapshot.robots) - LINE_ROBOTS} more robots")
    robots = "; ".join(words)
    return f"{clock_text(snapshot.t_s)} of at most {clock_text(snapshot.limit_s)}: {robots}"


def _robot_words(robot: RobotNow) -> str:
    words = [robot.name if robot.state == "alive" else f"{robot.name} ({robot.state})"]
    if robot.looks:
        words.append(f"{robot.looks} looks")
    words.append(f"{robot.team_cells} cells")
    words.append(f"{robot.sent_bytes / 1000:.1f} kB sent (link {100 * robot.link_use:.0f} %)")
    return " ".join([words[0], ", ".join(words[1:])])


def table(title: str, snapshot: Snapshot) -> "Table":
    """Return a moment of a run as a table."""
    from rich.table import Table
    from rich.text import Text

    limit = f"of at most {clock_text(snapshot.limit_s)}"
    heading = Text(f"{title}\nsimulated time {clock_text(snapshot.t_s)} {limit}")
    view = Table(title=heading, title_justify="left", title_style="bold", header_style="bold")
    view.add_column("robot")
    view.add_column("role")
    view.add_column("state")
    for name in ("looks", "own cells", "team cells", "sent kB", "link use"):
        view.add_column(name, justify="right")
    for robot in snapshot.robots:
        view.add_row(
            Text(robot.name),
            Text(robot.role),
            Text(_state_words(robot), style="" if robot.state == "alive" else "yellow"),
            f"{robot.looks}" if robot.looks else "",
            f"{robot.own_cells:,}",
            f"{robot.team_cells:,}",
            f"{robot.sent_bytes / 1000:,.1f}",
            f"{100 * robot.link_use:.0f} %",
        )
    return view


def _state_words(robot: RobotNow) -> str:
    return robot.doing if robot.state == "alive" and robot.doing else robot.state
