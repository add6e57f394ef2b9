"""What is to happen in a run, and when."""

import heapq
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(order=True)
class Appointment:
    """Something that happens at an instant; of one instant, in the order in which it was made."""

    t_ns: int
    order: int
    act: Callable[[], None] = field(compare=False)
    holds_end: bool = field(compare=False, default=False)
    """The run waits for this, even when everything else is done."""


class Agenda:
    """Appointments, by time."""

    def __init__(self) -> None:
        """Begin with none."""
        self._due: list[Appointment] = []
        self._order = itertools.count()

    def at(self, t_ns: int, act: Callable[[], None], *, holds_end: bool = False) -> None:
        """Have something done at an instant; the run waits for it if it `holds_end`."""
        heapq.heappush(self._due, Appointment(t_ns, next(self._order), act, holds_end))

    @property
    def next_ns(self) -> int | None:
        """When something is due; None: never."""
        return self._due[0].t_ns if self._due else None

    @property
    def holds_end(self) -> bool:
        """Whether the run has to wait for something."""
        return any(appointment.holds_end for appointment in self._due)

    def instants_ns(self) -> list[int]:
        """Return all instants at which something is due, in no order."""
        return [appointment.t_ns for appointment in self._due]

    def pop_due(self, now_ns: int) -> Callable[[], None] | None:
        """Take off what is due first, if it is due by now."""
        if self._due and self._due[0].t_ns <= now_ns:
            return heapq.heappop(self._due).act
        return None
