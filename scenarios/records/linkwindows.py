"""What crossed each link of a run, window of time after window, by `frames.csv`."""

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from comms.timebase import from_s
from scenarios.errors import StudyError
from scenarios.records.tables import DELIVERED

WINDOW_S = 10.0
"""Length of a window, in simulated seconds; of a long run a 500th, if that is more."""


class FramesError(StudyError):
    """A `frames.csv` that can't be read."""


@dataclass
class LinkWindow:
    """One directed link in one window; a frame counts where its transmission began."""

    sender: str
    receiver: str
    end_ns: int
    length_s: float
    frames: int = 0
    bytes: int = 0
    """Charged, the modem's overhead included."""
    delivered_frames: int = 0
    delivered_bytes: int = 0
    drops: dict[str, int] = field(default_factory=dict[str, int])
    """Frames that did not arrive or were not believed, by reason."""
    busy_s: float = 0.0
    """On the air."""
    queue_delays_s: list[float] = field(default_factory=list[float])
    """From the choice of each frame to the beginning of its transmission."""
    latencies_s: list[float] = field(default_factory=list[float])
    """From the choice of each delivered frame to its arrival."""

    def add(self, row: Mapping[str, str]) -> None:
        """Count a row of `frames.csv`."""
        size, chosen_s, start_s = int(row["bytes"]), float(row["chosen_s"]), float(row["start_s"])
        self.frames += 1
        self.bytes += size
        self.busy_s += float(row["end_s"]) - start_s
        self.queue_delays_s.append(start_s - chosen_s)
        if row["verdict"] == DELIVERED:
            self.delivered_frames += 1
            self.delivered_bytes += size
            self.latencies_s.append(float(row["arrive_s"]) - chosen_s)
        else:
            self.drops[row["verdict"]] = self.drops.get(row["verdict"], 0) + 1


def windows(rows: Iterable[Mapping[str, str]], until_s: float) -> list[LinkWindow]:
    """Return the windows in which something was sent, by end, sender and receiver."""
    length_s = max(WINDOW_S, until_s / 500)
    found: dict[tuple[int, str, str], LinkWindow] = {}
    for row in rows:
        number = int(float(row["start_s"]) // length_s)
        key = (number, row["from"], row["to"])
        if key not in found:
            end_ns = from_s((number + 1) * length_s)
            found[key] = LinkWindow(row["from"], row["to"], end_ns, length_s)
        found[key].add(row)
    return [found[key] for key in sorted(found)]


def windows_of(run: Path, until_s: float) -> list[LinkWindow]:
    """Return the windows of a run's folder; none where it has no frames.csv.

    Raises:
        FramesError: it has one that can't be read.

    """
    path = run / "frames.csv"
    if not path.is_file():
        return []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return windows(csv.DictReader(file), until_s)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise FramesError(f"{path}: can't be read as a run's frames ({error})") from error
