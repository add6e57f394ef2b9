"""The operator's desk: what people ask of a run that goes on, and what they are shown of it.

They ask from another thread; the runner attends to them between two windows, never inside one. The
wall clock says here when to show something and how fast to go, and decides nothing of the run.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from comms.timebase import from_s, to_s
from scenarios.view.hand import DEEDS, Deed, DeedError
from scenarios.view.reel import Reel

TELL_S = 0.1
"""Wall seconds between two batches of what is new."""
DOZE_S = 0.05
"""Wall seconds between two looks at a run that waits."""
STEP_S = 5.0
"""Simulated seconds of a step."""
SPEEDS = (0.0, 1.0, 5.0, 20.0, 60.0, 300.0)
"""Simulated seconds to one wall second; 0: as fast as it goes."""
MOST_ASKED = 64
"""More wishes than these, not yet attended to, are dropped."""

Tell = Callable[[dict[str, Any]], None]
Wish = dict[str, Any]


class Watched(Protocol):
    """A run that goes on, as far as those who watch it have to do with it."""

    ending: str
    """Empty for as long as it goes on."""
    reel: Reel | None
    desk: "Desk | None"

    @property
    def now_ns(self) -> int:
        """The run's time."""
        ...

    def due_ns(self) -> int | None:
        """Return when its next window begins; None: it keeps the wall's time."""
        ...

    def by_hand(self, deed: Deed, robot: str) -> int:
        """Do something to a robot as soon as can be; return when it happens.

        Raises:
            DeedError: it can't happen now.

        """
        ...


class Desk:
    """Between one run and those who watch it."""

    def __init__(self, tell: Tell, *, paused: bool = False) -> None:
        """Tell what is to be shown through `tell`; begin paused or not."""
        self._tell = tell
        self._wishes: deque[Wish] = deque(maxlen=MOST_ASKED)
        self._woken = threading.Event()
        self._marks: dict[str, int] = {}
        self._told_s = 0.0
        self._told_ns = -1
        self._paused = paused
        self._until_ns: int | None = None
        """Where a step ends."""
        self._speed = SPEEDS[0]
        self._pace: tuple[float, int] | None = None
        """Wall second and instant from which the speed is reckoned."""
        self._has_pace = True

    # --- from the page ---------------------------------------------------------------------

    def ask(self, wish: Wish) -> None:
        """Take a wish, from any thread: {"do": pause, go, step, speed or a deed; robot, value}."""
        self._wishes.append(wish)
        self._woken.set()

    # --- from the runner -------------------------------------------------------------------

    def attend(self, play: Watched, due_ns: int | None) -> None:
        """Do what was asked for, show what is new, and wait if the run is to wait.

        Args:
            play: the run, between two windows.
            due_ns: when its next window begins; None: it keeps the wall's time, and waits for
                nobody.

        """
        self._has_pace = due_ns is not None
        while True:
            while self._wishes:
                self._grant(self._wishes.popleft(), play)
            self.show(play)
            if due_ns is None or play.ending or not (wait_s := self._wait_s(due_ns, play.now_ns)):
                return
            self._woken.wait(min(wait_s, DOZE_S))
            self._woken.clear()
            due_ns = play.due_ns()  # what was asked for may come first

    def show(self, play: Watched, *, now: bool = False) -> None:
        """Show what is new, if it is time to (or `now`)."""
        wall_s = time.monotonic()
        if play.reel is None or (not now and wall_s < self._told_s + TELL_S):
            return
        self._told_s = wall_s
        rows = play.reel.since(self._marks)
        if rows or play.now_ns != self._told_ns:
            self._told_ns = play.now_ns
            self._tell({"type": "rows", "now_s": to_s(play.now_ns), "rows": rows})

    def state(self) -> dict[str, Any]:
        """Return how the run is to go on, for the page."""
        return {
            "type": "state",
            "paused": self._paused,
            "steps": self._until_ns is not None,
            "speed": self._speed,
            "speeds": list(SPEEDS),
            "has_pace": self._has_pace,
        }

    # --- inside ------------------------------------------------------------------------------

    def _wait_s(self, due_ns: int, now_ns: int) -> float:
        """Return for how long, at most, the next window is not yet to begin."""
        if self._paused:
            if self._until_ns is not None and due_ns < self._until_ns:
                return 0.0
            if self._until_ns is not None:
                self._until_ns = None
                self._tell(self.state())
            return DOZE_S
        if self._speed == 0.0:
            return 0.0
        if self._pace is None:
            self._pace = (time.monotonic(), now_ns)
        wall_s, from_ns = self._pace
        return max(0.0, wall_s + to_s(due_ns - from_ns) / self._speed - time.monotonic())

    def _grant(self, wish: Wish, play: Watched) -> None:
        match wish:
            case {"do": "pause"}:
                self._paused, self._until_ns = True, None
            case {"do": "go"}:
                self._paused, self._pace = False, None
            case {"do": "step"}:
                self._paused = True
                self._until_ns = play.now_ns + from_s(STEP_S)
            case {"do": "speed", "value": float() | int() as value} if value in SPEEDS:
                self._speed, self._pace = float(value), None
            case {"do": str() as deed, "robot": str() as robot} if deed in DEEDS:
                self._do(deed, robot, play)
            case _:
                return
        self._tell(self.state())

    def _do(self, deed: Deed, robot: str, play: Watched) -> None:
        try:
            at_ns = play.by_hand(deed, robot)
        except DeedError as error:
            self._tell({"type": "no", "why": str(error)})
        else:
            told = {"type": "done", "deed": deed, "robot": robot, "at_s": to_s(at_ns)}
            self._tell(told)
