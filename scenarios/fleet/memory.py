"""What a robot of a fleet has in place of a disk and of records."""

from collections import Counter
from pathlib import Path

from agents.ports import Exposure
from comms.frames import Kind


class MemoryFiles:
    """A robot's disk in memory (`agents.files.Files`)."""

    def __init__(self) -> None:
        """Start empty."""
        self._files: dict[Path, bytes] = {}

    def read(self, path: Path) -> bytes | None:
        """Return what a file holds, or None where there is none."""
        return self._files.get(path)

    def append(self, path: Path, data: bytes) -> None:
        """Write behind what a file holds."""
        self._files[path] = self._files.get(path, b"") + data

    def replace(self, path: Path, data: bytes, *, durable: bool = False) -> None:
        """Write a file whole."""
        del durable
        self._files[path] = data

    def cut(self, path: Path, length_bytes: int) -> None:
        """Shorten a file."""
        self._files[path] = self._files[path][:length_bytes]


class Sums:
    """Keeps sums instead of records (`RobotLog` and `RadioLog`)."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.looks = 0
        self.bytes: Counter[str] = Counter()
        self.frames: Counter[str] = Counter()
        self.events: Counter[str] = Counter()

    def look(self, exposure: Exposure, **facts: float) -> None:
        """Count a look."""
        del exposure, facts
        self.looks += 1

    def event(self, what: str, detail: str = "") -> None:
        """Count an event."""
        del detail
        self.events[what] += 1

    def on_tx(self, *, kind: Kind, charged_bytes: int, **times: int) -> None:
        """Count a frame that is sent."""
        del times
        self.bytes[kind.name.lower()] += charged_bytes
        self.frames[kind.name.lower()] += 1

    def on_cut(self, number: int) -> None:
        """Count nothing: no robot of a fleet dies."""
        del number

    def on_rx(self, sender: str, number: int, arrive_ns: int, verdict: str) -> None:
        """Count nothing: what is sent is counted."""
        del sender, number, arrive_ns, verdict
