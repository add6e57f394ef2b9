"""What is kept of a radio's frames: a record of each, and sums."""

from dataclasses import dataclass
from typing import Protocol

from comms.frames import Kind


class RadioLog(Protocol):
    """Keeps the record of one robot's frames."""

    def on_tx(
        self,
        *,
        number: int,
        kind: Kind,
        charged_bytes: int,
        chosen_ns: int,
        start_ns: int,
        end_ns: int,
    ) -> None:
        """Note that a frame's transmission begins, and when it will end."""
        ...

    def on_cut(self, number: int) -> None:
        """Note that a frame was cut short: nobody gets it."""
        ...

    def on_rx(self, sender: str, number: int, arrive_ns: int, verdict: str) -> None:
        """Note what became of a frame: a `Verdict`, or a `FrameError`'s reason."""
        ...


@dataclass
class Traffic:
    """What a radio has sent and heard so far."""

    sent_frames: int = 0
    sent_bytes: int = 0
    """Charged: the modem's overhead included, frames that were cut short too."""
    airtime_ns: int = 0
    received_frames: int = 0
    received_bytes: int = 0
    """Frames that were delivered and opened, envelope included."""
