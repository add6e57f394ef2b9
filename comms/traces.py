"""How well a link did in time, as somebody recorded it, or as a schedule of outages says.

A trace is a CSV file with a header. `t_s` (s, rising) and one of two columns are read, others are
left alone: `up` (1 or 0), or `delivery_ratio` (0 to 1, the share of frames that came through). The
first row is the start of the run, whatever its `t_s`; each row holds until the next.
"""

import csv
import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path

from comms.errors import CommsError
from comms.timebase import from_s

MAX_FILE_BYTES = 64_000_000
MAX_ROWS = 2_000_000
TIME, UP, RATIO = "t_s", "up", "delivery_ratio"


class TraceError(CommsError):
    """A trace that can't be read; says the file, the line, the value and what is allowed."""


class Trace:
    """Delivery ratio over time, constant between its rows."""

    def __init__(self, t_ns: Sequence[int], ratios: Sequence[float], *, loop: bool = False) -> None:
        """Take rows: when they begin, rising, and the ratios (0 to 1) that hold from there on.

        With `loop` the trace begins anew when its last row has held as long as the one before it.
        """
        assert len(t_ns) == len(ratios) > 0
        self._t_ns, self._ratios = t_ns, ratios
        self._least = min(ratios)
        self._period_ns = 2 * t_ns[-1] - t_ns[-2] - t_ns[0] if loop and len(t_ns) > 1 else 0

    @staticmethod
    def of_outages(outages_ns: Iterable[tuple[int, int]]) -> "Trace":
        """Return the trace of a link that lets nothing through in these spans, in order."""
        rows = {-1: 1.0}
        for from_ns, to_ns in outages_ns:
            rows[from_ns], rows[to_ns] = 0.0, 1.0
        return Trace(list(rows), list(rows.values()))

    def least(self, start_ns: int, end_ns: int) -> float:
        """Return the least ratio in a span of time (in ns of the run)."""
        if not self._period_ns:
            return self._least_once(start_ns, end_ns)
        if end_ns - start_ns >= self._period_ns:
            return self._least
        first_ns = self._t_ns[0]
        from_ns = (start_ns - first_ns) % self._period_ns + first_ns
        to_ns = from_ns + end_ns - start_ns
        over_ns = to_ns - self._period_ns
        rest = self._least_once(first_ns, over_ns) if over_ns > first_ns else 1.0
        return min(self._least_once(from_ns, to_ns), rest)

    def _least_once(self, start_ns: int, end_ns: int) -> float:
        first = max(bisect_right(self._t_ns, start_ns) - 1, 0)
        behind = max(bisect_left(self._t_ns, end_ns), first + 1)
        return min(self._ratios[first:behind])


def read_trace(path: str, *, loop: bool = False) -> Trace:
    """Return the trace in a file.

    Raises:
        TraceError: it can't be read, or it is no trace.

    """
    try:
        facts = Path(path).stat()
    except OSError as error:
        raise TraceError(f"{path}: can't be read: {error.strerror}") from error
    if facts.st_size > MAX_FILE_BYTES:
        raise TraceError(f"{path}: has {facts.st_size} bytes; {MAX_FILE_BYTES} are allowed")
    return Trace(*_rows(path, facts.st_mtime_ns), loop=loop)


@lru_cache(maxsize=16)
def _rows(path: str, written_ns: int) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return (when rows begin, their ratios); once for all links that follow the same file."""
    del written_ns
    lines = csv.reader(_text(path).splitlines())
    header = [name.strip() for name in next(lines, [])]
    value_name = _value_column(path, header)
    at = header.index(TIME), header.index(value_name)
    t_ns: list[int] = []
    ratios: list[float] = []
    for row in lines:
        if not row:
            continue
        if len(row) != len(header):
            raise _wrong(path, lines.line_num, f"{len(row)} values", f"{len(header)} are allowed")
        t_s, ratio = _row(path, lines.line_num, row[at[0]], value_name, row[at[1]])
        t_ns.append(from_s(t_s))
        ratios.append(ratio)
        if len(t_ns) > 1 and t_ns[-1] <= t_ns[-2]:
            said = f"{TIME} = {row[at[0]]}"
            raise _wrong(path, lines.line_num, said, "must be above that of the row before")
        if len(t_ns) > MAX_ROWS:
            raise _wrong(path, lines.line_num, "one more row", f"at most {MAX_ROWS} are allowed")
    if not t_ns:
        raise TraceError(f"{path}: has no row below its header; at least one is needed")
    return tuple(t - t_ns[0] for t in t_ns), tuple(ratios)


def _text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise TraceError(f"{path}: can't be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise TraceError(f"{path}: is no text in UTF-8 (byte {error.start})") from error


def _value_column(path: str, header: list[str]) -> str:
    found = [name for name in (UP, RATIO) if name in header]
    if TIME not in header or len(found) != 1:
        names = ",".join(header)
        shown = names if len(names) <= 60 else names[:57] + "..."
        raise TraceError(
            f"{path}, line 1: the header is {shown!r}; it must name {TIME}, and either {UP}"
            f" or {RATIO}"
        )
    return found[0]


def _row(path: str, line: int, t_s: str, name: str, value: str) -> tuple[float, float]:
    time = _number(t_s)
    if not math.isfinite(time) or abs(time) > 1e10:
        raise _wrong(path, line, f"{TIME} = {t_s.strip()!r}", "must be a number of seconds")
    ratio = _number(value)
    if name == UP and ratio not in (0.0, 1.0):
        raise _wrong(path, line, f"{UP} = {value.strip()!r}", "must be 1 or 0")
    if not 0.0 <= ratio <= 1.0:
        raise _wrong(path, line, f"{RATIO} = {value.strip()!r}", "must be from 0 to 1")
    return time, ratio


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _wrong(path: str, line: int, what: str, allowed: str) -> TraceError:
    return TraceError(f"{path}, line {line}: {what[:80]}; {allowed}")
