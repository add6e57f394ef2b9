"""A link test on a terminal: short, with what was measured beside what was expected."""

import math

from rich.console import Console
from rich.table import Table
from rich.text import Text

from comms.faults import NO_FAULTS
from comms.profiles import LinkProfile
from scenarios.linktest.figures import Figures, Spread
from scenarios.linktest.transfer import LinkTest

NOTE = (
    "Charged is what is on air: payload, envelope, the modem's declared overhead.\n"
    "What Zenoh and TCP carry below a frame on this computer is not."
)

EXACT_S = 1e-9
"""Times are whole nanoseconds, a frame's end is rounded up to one."""


def show(
    test: LinkTest, clock: str, found: Figures, said: str = "", console: Console | None = None
) -> None:
    """Print a test's figures; `said` are its settings in words, where there are any."""
    console = Console(highlight=False) if console is None else console
    head = f"{test.profile.name}: {test.payload_bytes:,} bytes, {clock} clock"
    console.print(Text(head, style="bold"))
    console.print(Text("\n".join(filter(None, (link_words(test.profile), said, " ")))))
    console.print(_measured(test.profile, found))
    console.print(_told(test.profile, found))
    console.print(Text(NOTE, style="dim"))


def _measured(profile: LinkProfile, found: Figures) -> Table:
    page = Table.grid(padding=(0, 3))
    page.add_column(min_width=11)
    page.add_column(justify="right", min_width=14)
    page.add_column(justify="right")
    page.add_row("", Text("expected", style="dim"), Text("measured", style="dim"))
    for name, expected, measured in measured_rows(profile, found):
        page.add_row(name, Text(expected), Text(measured, style="bold"))
    return page


def measured_rows(profile: LinkProfile, found: Figures) -> list[tuple[str, str, str]]:
    """Return (what, expected, measured)."""
    lost = found.lost_frames / (found.frames + found.cut_frames)
    # What other faults cost depends on the frames' times: nothing simple can be expected.
    loss = f"{100 * profile.loss:.1f} %" if profile.faults == NO_FAULTS else ""
    return [
        ("rate", _bps(found.configured_bps), _bps(found.measured_bps, ",.3f")),
        ("all sent", _s(found.expected_s), _s(found.measured_s)),
        ("first byte", _s(found.first_byte_expected_s), _s(found.first_byte_s)),
        ("last byte", _s(found.last_byte_expected_s), _s(found.last_byte_s)),
        ("lost", loss, f"{100 * lost:.1f} %"),
    ]


def _told(profile: LinkProfile, found: Figures) -> Table:
    page = Table.grid(padding=(0, 3))
    page.add_column(min_width=11)
    page.add_column()
    for name, words in told_rows(profile, found):
        page.add_row(name, Text(words))
    return page


def told_rows(profile: LinkProfile, found: Figures) -> list[tuple[str, str]]:
    """Return (what, in words)."""
    rows = [("frame ends", _late(found.end_late))]
    if profile.shared.kind == "own":
        rows.append(("drift", f"{_ms(found.drift_s)} at the last of {found.frames:,} frames"))
    else:
        rows.append(("waited", f"{_s(found.drift_s)} in all for the channel, which two share"))
    if found.handed_late is not None:
        rows.append(("arrivals", _late(found.handed_late)))
    rows.append(("charged", f"{found.charged_bytes:,} bytes: {_shares(found)}"))
    rows.append(("goodput", _goodput(found)))
    if found.dropped or found.cut_frames:
        rows.append(("dropped", _dropped(found)))
    return rows


def link_words(profile: LinkProfile) -> str:
    """Say in a line what a link is."""
    latency = f"{profile.latency_ns / 1e6:g} ms"
    if profile.jitter_ns:
        latency += f" to {(profile.latency_ns + profile.jitter_ns) / 1e6:g} ms"
    rate = None if math.isinf(profile.rate_bps) else profile.rate_bps
    return (
        f"{_bps(rate)}, latency {latency}, frames of at most {profile.frame_bytes} bytes "
        f"+ {profile.overhead_bytes} overhead"
    )


def _shares(found: Figures) -> str:
    parts = {
        "payload": found.payload_bytes,
        "envelope": found.envelope_bytes,
        "overhead": found.overhead_bytes,
    }
    return ", ".join(f"{name} {100 * n / found.charged_bytes:.1f} %" for name, n in parts.items())


def _goodput(found: Figures) -> str:
    if found.goodput_bps is None:
        return "none"
    return f"{found.goodput_bps:,.0f} bps of payload until the last byte was there"


def _dropped(found: Figures) -> str:
    reasons = [f"{reason} {count:,}" for reason, count in sorted(found.dropped.items())]
    if found.cut_frames:
        reasons.append(f"cut short by this computer {found.cut_frames:,}")
    return f"{', '.join(reasons)}; {found.lost_bytes:,} bytes of payload did not come"


def _bps(rate_bps: float | None, form: str = ",.10g") -> str:
    return "unlimited" if rate_bps is None else f"{rate_bps:{form}} bps"


def _s(t_s: float | None) -> str:
    return "never" if t_s is None else f"{t_s:,.3f} s"


def _ms(t_s: float) -> str:
    return f"{1000 * t_s:.3f} ms"


def _late(values: Spread) -> str:
    if values.max_s <= EXACT_S:
        return "on time, to the nanosecond"
    return (
        f"late by {_ms(values.median_s)} median, {_ms(values.p95_s)} p95, {_ms(values.max_s)} max"
    )
