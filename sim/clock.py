"""Three clocks for one program: virtual, scaled and real event loops.

Agents know the running loop's `time()` and asyncio's own waits, nothing else. On `VirtualLoop`
that time is simulated: integer nanoseconds that jump from one event to the next, and only inside
the window that a conductor has granted. `ScaledLoop` runs the same program on the wall clock,
at any speed.

What is simultaneous is ordered by (time, source, sequence): asyncio's own heap compares the time
alone, so eight timers of one instant may fire in any order; this loop keeps a heap of its own.
"""

import asyncio
import heapq
import selectors
import time
from collections.abc import Callable
from contextvars import Context
from functools import partial
from typing import Any, TypeVar, TypeVarTuple

from comms.timebase import NS

T = TypeVar("T")
Ts = TypeVarTuple("Ts")


MOST_THOUGHTS = 2000
"""Computations that a robot may make at one instant; a sound one makes a handful."""


def _no_time(_t_ns: int) -> int:
    return 0


def _settle(future: "asyncio.Future[T]", tell: Callable[[Any], None], outcome: Any) -> None:
    if not future.done():  # nobody waits for it any more
        tell(outcome)


class VirtualLoop(asyncio.BaseEventLoop):
    """An event loop on simulated time that runs window by window.

    `run_window(end_ns)` runs every event before `end_ns` and returns; between windows nothing
    happens, and `next_event_ns` says what would happen next. There is no selector, no thread and
    no wall clock in it, so a thousand of them fit in one process.
    """

    _ready: Any  # asyncio's own queue of handles that are due (private, typed nowhere)
    _stopping: bool

    def __init__(self, source: int, start_ns: int = 0) -> None:
        """Make a loop for the robot of index `source` whose clock stands at `start_ns`."""
        super().__init__()
        self.source = source
        self._now_ns = start_ns
        self._end_ns = start_ns
        self._sequence = 0
        self._timers: list[tuple[int, int, int, asyncio.Handle]] = []
        self._mail: list[tuple[int, int, int, Callable[[], None]]] = []
        self._thoughts = (start_ns, 0)
        self.think_ns: Callable[[int], int] = _no_time
        """Simulated time that a computation takes which begins at a time."""

    def time(self) -> float:
        """Return the simulated time in seconds; exact to the nanosecond for 50 days."""
        return self._now_ns / NS

    @property
    def now_ns(self) -> int:
        """The simulated time in nanoseconds."""
        return self._now_ns

    def call_at(
        self,
        when: float,
        callback: Callable[[*Ts], object],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        """Schedule a callback at a simulated time, after what was scheduled there before it."""
        handle = asyncio.TimerHandle(when, callback, args, self, context)
        self._push(max(round(when * NS), self._now_ns), self.source, handle)
        return handle

    def call_later(
        self,
        delay: float,
        callback: Callable[[*Ts], object],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        """Schedule a callback after a simulated delay."""
        return self.call_at(self.time() + delay, callback, *args, context=context)

    def _push(self, when_ns: int, source: int, handle: asyncio.Handle) -> None:
        self._sequence += 1
        heapq.heappush(self._timers, (when_ns, source, self._sequence, handle))

    def post(
        self,
        arrive_ns: int,
        source_index: int,
        number: int,
        callback: Callable[[], None],
        wake: bool,
    ) -> None:
        """Deliver something from outside at `arrive_ns`, in order of (time, source, number).

        With `wake` it is an event like any other. Without, it is mail: it does not wake the
        robot, who finds it, in order, when it next acts.
        """
        if wake:
            handle = asyncio.Handle(callback, (), self)
            heapq.heappush(
                self._timers, (max(arrive_ns, self._now_ns), source_index, number, handle)
            )
        else:
            heapq.heappush(self._mail, (arrive_ns, source_index, number, callback))

    def run_in_executor(  # pyright: ignore[reportIncompatibleMethodOverride]  (typed more narrowly)
        self, executor: object, func: Callable[[*Ts], T], *args: *Ts
    ) -> "asyncio.Future[T]":
        """Run a function here and now, without a thread's luck.

        Computing takes no simulated time but what `think_ns` says: its outcome, of what was known
        when it began, is there so much later.
        """
        del executor
        self._let_time_pass()
        future: asyncio.Future[T] = self.create_future()
        settle: Callable[[], None]
        try:
            settle = partial(_settle, future, future.set_result, func(*args))
        except Exception as error:  # the caller's to handle, as with a thread
            settle = partial(_settle, future, future.set_exception, error)
        think_ns = self.think_ns(self._now_ns)
        if think_ns > 0:
            self.call_at((self._now_ns + think_ns) / NS, settle)
        else:
            settle()
        return future

    def _let_time_pass(self) -> None:
        """Raise where a robot thinks and thinks, and nothing else: it would never end."""
        instant_ns, thoughts = self._thoughts
        thoughts = thoughts + 1 if instant_ns == self._now_ns else 1
        self._thoughts = (self._now_ns, thoughts)
        if thoughts > MOST_THOUGHTS:
            raise RuntimeError(
                f"{thoughts} computations at {self._now_ns / NS:g} s: the program goes round in"
                " circles without letting time pass"
            )

    def next_event_ns(self) -> int | None:
        """Return the time of the next event that wakes this loop, or None."""
        if self._ready:
            return self._now_ns
        timers = self._timers
        while timers and timers[0][3].cancelled():
            heapq.heappop(timers)
        return timers[0][0] if timers else None

    def run_window(self, end_ns: int, floor_ns: int = 0) -> None:
        """Run all events before `end_ns`; the clock stands at `floor_ns` or later throughout.

        `floor_ns` is for a robot that was stopped: its overdue timers fire in their order, at the
        instant at which it went on.
        """
        self._now_ns = max(self._now_ns, floor_ns)
        self._end_ns = end_ns
        self.run_forever()

    def advance(self, to_ns: int) -> None:
        """Let the clock stand at `to_ns` and hand out the mail of that time; no event is due."""
        self._now_ns = max(self._now_ns, to_ns)
        self.collect_mail(self._now_ns)

    def collect_mail(self, until_ns: int) -> None:
        """Hand out the mail that arrived up to `until_ns`, though nothing wakes the robot."""
        while self._mail and self._mail[0][0] <= until_ns:
            heapq.heappop(self._mail)[3]()

    def _run_once(self) -> None:
        if not self._ready:
            when_ns = self.next_event_ns()
            if when_ns is None or when_ns >= self._end_ns:
                self._stopping = True
                return
            self._now_ns = max(self._now_ns, when_ns)
            self.collect_mail(self._now_ns)
            while self._timers and self._timers[0][0] <= self._now_ns:
                handle = heapq.heappop(self._timers)[3]
                if not handle.cancelled():
                    self._ready.append(handle)
        for _ in range(len(self._ready)):
            handle = self._ready.popleft()
            if not handle.cancelled():
                handle._run()

    def _timer_handle_cancelled(self, handle: asyncio.TimerHandle) -> None:
        """Leave a cancelled timer in the heap; it is skipped when its time comes."""

    def _write_to_self(self) -> None:
        """Nothing sleeps in this loop, so nothing has to be woken."""

    def _process_events(self, event_list: list[Any]) -> None:
        raise AssertionError("a virtual loop has no I/O")


class _ScaledSelector(selectors.DefaultSelector):
    def __init__(self, speed: float) -> None:
        super().__init__()
        self._speed = speed

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        return super().select(None if timeout is None else timeout / self._speed)


class ScaledLoop(asyncio.SelectorEventLoop):
    """An ordinary event loop whose seconds pass `speed` times as fast as the wall's.

    Processes of one machine that begin at the same monotonic time agree about the run's time.
    """

    def __init__(self, speed: float) -> None:
        """Make a loop whose clock stands at zero until it begins."""
        self._epoch_s: float | None = None
        self._speed = speed
        super().__init__(_ScaledSelector(speed))

    def begin(self, epoch_s: float) -> None:
        """Let the clock run; up to monotonic time `epoch_s` it shows zero."""
        self._epoch_s = epoch_s

    def time(self) -> float:
        """Return the seconds of the run."""
        if self._epoch_s is None:
            return 0.0
        return max(0.0, (time.monotonic() - self._epoch_s) * self._speed)

    def post(
        self,
        arrive_ns: int,
        source_index: int,
        number: int,
        callback: Callable[[], None],
        wake: bool,
    ) -> None:
        """Deliver something from outside at its time (or now, if that has passed).

        The wall clock orders what arrives, and every arrival wakes.
        """
        del source_index, number, wake
        self.call_at(arrive_ns / NS, callback)
