"""What a link test showed, in figures: measured beside expected.

The expectation is arithmetic of its own, in fractions: charged bits over the configured rate. The
link's own rounding is no part of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from comms.timebase import NS
from scenarios.linktest.transfer import HeardFrame, LinkTest, SentFrame, Trial


@dataclass(frozen=True)
class Spread:
    """How a number of seconds is spread over frames."""

    median_s: float
    p95_s: float
    max_s: float


@dataclass(frozen=True)
class Figures:
    """A trial in figures; seconds count from the start of the first frame."""

    frames: int
    charged_bytes: int
    """Of all frames: payload, envelope and the modem's overhead."""
    payload_bytes: int
    """Of the user's, in these frames."""
    envelope_bytes: int
    overhead_bytes: int
    configured_bps: float | None
    """None: unlimited."""
    measured_bps: float | None
    """Charged bits over the time until the last frame had left; None: it took no time."""
    expected_s: float
    measured_s: float
    end_late: Spread
    """How much later than its own start + bits / rate a frame was put on the air."""
    drift_s: float
    """How much later than the first start + all bits / rate the last frame was put on the air."""
    handed_late: Spread | None
    """How much later than their arrival frames were handed over; None: nothing was heard."""
    goodput_bps: float | None
    """Payload bits that came, over the time until the last came; None: nothing came, or at once."""
    first_byte_s: float | None
    """When the first frame that came was there."""
    first_byte_expected_s: float | None
    """The same by rate and least latency."""
    last_byte_s: float | None
    last_byte_expected_s: float | None
    cut_frames: int
    """Frames that were cut short because this computer hung over their end; also lost."""
    lost_frames: int
    lost_bytes: int
    """Of the user's payload: did not come."""
    dropped: dict[str, int]
    """What the receiver did not take in, by reason."""


def figures(trial: Trial) -> Figures:
    """Return a trial's figures; all bytes that came are checked against those sent."""
    sent, heard = trial.sent, trial.heard
    check_payload(trial)
    rate_bps = trial.test.profile.rate_bps
    charged = sum(frame.charged_bytes for frame in sent)
    pieces = sum(frame.piece_bytes for frame in sent)
    in_frames = sum(frame.frame_bytes for frame in sent)
    start_ns, end_ns = sent[0].start_ns, max(frame.put_ns for frame in sent)
    took_s = (end_ns - start_ns) / NS
    came_bytes = sum(len(frame.payload) for frame in heard)
    first, last = _first_and_last(trial)
    last_s = (last.heard_ns - start_ns) / NS if last else None
    return Figures(
        frames=len(sent),
        charged_bytes=charged,
        payload_bytes=pieces,
        envelope_bytes=in_frames - pieces,
        overhead_bytes=charged - in_frames,
        configured_bps=None if math.isinf(rate_bps) else rate_bps,
        measured_bps=8 * charged / took_s if took_s else None,
        expected_s=float(ideal_ns(trial.test, charged)) / NS,
        measured_s=took_s,
        end_late=spread([lateness_ns(trial.test, frame) / NS for frame in sent]),
        drift_s=float(end_ns - start_ns - ideal_ns(trial.test, charged)) / NS,
        handed_late=_handed_late(trial),
        goodput_bps=8 * came_bytes / last_s if last_s else None,
        first_byte_s=(first.heard_ns - start_ns) / NS if first else None,
        first_byte_expected_s=_expected_s(trial, first),
        last_byte_s=last_s,
        last_byte_expected_s=_expected_s(trial, last),
        cut_frames=trial.cut_frames,
        lost_frames=len(sent) + trial.cut_frames - len(heard),
        lost_bytes=trial.test.payload_bytes - came_bytes,
        dropped=dict(trial.dropped),
    )


def check_payload(trial: Trial) -> None:
    """Assert that every frame that was heard holds the very bytes that were sent in it."""
    payload = trial.test.payload()
    places = {frame.number: frame.payload_at for frame in trial.sent}
    for frame in trial.heard:
        place = places[frame.number]
        assert payload[place : place + len(frame.payload)] == frame.payload, frame.number


def ideal_ns(test: LinkTest, charged_bytes: int) -> Fraction:
    """Return 8 * bytes / rate, in nanoseconds."""
    if math.isinf(test.profile.rate_bps):
        return Fraction(0)
    return Fraction(8 * NS * charged_bytes) / Fraction(test.profile.rate_bps)


def lateness_ns(test: LinkTest, frame: SentFrame) -> float:
    """Return how much later than its start + 8 * bytes / rate a frame was put on the air."""
    return float(frame.put_ns - frame.start_ns - ideal_ns(test, frame.charged_bytes))


def spread(values_s: Sequence[float]) -> Spread:
    """Return the spread of at least one value."""
    median_s, p95_s, max_s = np.percentile(values_s, (50, 95, 100))
    return Spread(float(median_s), float(p95_s), float(max_s))


def _first_and_last(trial: Trial) -> tuple[HeardFrame | None, HeardFrame | None]:
    """Return the frames that came first and last."""
    by_time = sorted(trial.heard, key=lambda frame: frame.heard_ns)
    return (by_time[0], by_time[-1]) if by_time else (None, None)


def _expected_s(trial: Trial, heard: HeardFrame | None) -> float | None:
    """Return when a frame should have come, by the bytes up to it, the rate and the latency."""
    if heard is None:
        return None
    charged = sum(f.charged_bytes for f in trial.sent if f.number <= heard.number)
    return float(ideal_ns(trial.test, charged) + trial.test.profile.latency_ns) / NS


def _handed_late(trial: Trial) -> Spread | None:
    late_s = [(frame.heard_ns - frame.arrive_ns) / NS for frame in trial.heard]
    return spread(late_s) if late_s else None
