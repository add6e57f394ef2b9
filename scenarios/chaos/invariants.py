"""What must hold of every run, whatever went wrong in it: checked from its records, by name.

An invariant takes the evidence of a run and returns one sentence for each thing that breaks it.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from agents.geometry import Floats
from agents.layers import Anchor
from agents.maps.elevation import UNIFORM
from agents.store import AnchorKey
from comms.faults import Verdict
from comms.profiles import resolve
from scenarios.chaos.trial import Evidence
from scenarios.records.tables import DELIVERED, NOT_YET_ARRIVED, RECEIVER_DOWN, SENDER_DIED, MapRow

SURE = 1e-3
"""Maps are told in single precision; so much more than was measured is nothing."""
REFUSALS = ("damaged", "bad-version", "replayed", "old-incarnation")
"""Why a frame of the team's own is not believed (a flipped bit of its version comes first)."""
LATE_S = 1e-6


@dataclass(frozen=True)
class Violation:
    """Something that must never be."""

    invariant: str
    sentence: str

    def __str__(self) -> str:
        """Tell it in one line."""
        return f"{self.invariant}: {self.sentence}"


def violations(evidence: Evidence) -> list[Violation]:
    """Return all that a run did wrong; nothing where all holds."""
    return [
        Violation(name, sentence)
        for name, holds in INVARIANTS.items()
        for sentence in holds(evidence)
    ]


# --- maps -------------------------------------------------------------------------------------


def no_cell_lost(evidence: Evidence) -> list[str]:
    """No life of a robot ever knows less than before; a next one knows what was on its disk."""
    broken: list[str] = []
    for name, rows in _map_rows(evidence).items():
        births_s = _births_s(evidence, name)
        careless = _careless(evidence, name)
        for before, row in pairwise(rows):
            reborn = any(before.t_s < birth_s <= row.t_s + 1e-6 for birth_s in births_s)
            # What a full disk refused, or a slow computer had not written yet, is told as such.
            had = before.team_cells
            if reborn:
                seen = _seen(evidence, name, before.t_s, row.t_s)
                had = 0 if careless else max(before.own_cells, seen)
            if row.team_cells < had:
                broken.append(f"{name} knew {had} cells at {before.t_s:g} s, and {row.team_cells}"
                              f" at {row.t_s:g} s")  # fmt: skip
    return broken


def nothing_counted_twice(evidence: Evidence) -> list[str]:
    """No map is surer of a cell than all that was ever measured there makes it."""
    broken: list[str] = []
    for final in evidence.finals:
        if final.sigma_m is None or final.state != "alive":
            continue
        most = _most_information(evidence, final.moved)
        information = 1.0 / np.maximum(final.sigma_m.astype(np.float64), 1e-9) ** 2
        information[~np.isfinite(final.sigma_m)] = 0.0
        excess = information - most * (1 + SURE)
        if (excess > SURE).any():
            row, col = (int(i) for i in np.unravel_index(int(np.argmax(excess)), most.shape))
            broken.append(
                f"{final.name} is sure of {np.count_nonzero(excess > SURE)} cells beyond all"
                f" measurements: of row {row}, column {col} it has {information[row, col]:.4g}"
                f" 1/m^2, where {most[row, col]:.4g} can be had"
            )
    return broken


def _most_information(evidence: Evidence, moved: Mapping[AnchorKey, Anchor]) -> Floats:
    """Return the most information (rows, cols), 1/m^2, that a map of the team may claim.

    `moved` are the submaps that it lays elsewhere than they were drawn. Robots measure
    independently: theirs adds up. Of one robot's measurements each life's part may have been sent
    by itself, with the codec's error added to it.
    """
    scenario = evidence.scenario
    exact = scenario.sharing.policy not in ("value", "latest-first")
    codec_m2 = 0.0 if exact else scenario.map.max_error_m**2 * UNIFORM
    most = 0.0
    for actor in evidence.actors:
        measured = evidence.ledger.laid(actor.name, moved)
        lives = max(1, actor.lives)
        most = most + lives * measured / (lives + codec_m2 * measured)
    return np.asarray(most, dtype=np.float64)


def survivors_equal(evidence: Evidence) -> list[str]:
    """All that run at the end, and can hear each other, hold the same store."""
    links, changes = evidence.scenario.links, evidence.scenario.link_changes()
    alive = [final for final in evidence.finals if final.state == "alive"]
    broken: list[str] = []
    for index, one in enumerate(alive):
        for other in alive[index + 1 :]:
            ways = ((one.name, other.name), (other.name, one.name))
            heard = all(resolve(links, *way, changes).carries for way in ways)
            if heard and one.digest != other.digest:
                broken.append(f"{one.name} and {other.name} hold different maps at the end"
                              f" ({one.digest[:8]}, {other.digest[:8]})")  # fmt: skip
    if evidence.ending == "limit" and not broken:
        busy = [a.name for a in evidence.actors if _is_busy(evidence, a.name)]
        broken += [f"{name} was not done at {evidence.simulated_s:g} s" for name in busy]
    return broken


def _is_busy(evidence: Evidence, name: str) -> bool:
    actor = next(actor for actor in evidence.actors if actor.name == name)
    return actor.state == "alive" and not actor.status.get("settled")


# --- frames -----------------------------------------------------------------------------------


def frames_accounted_for(evidence: Evidence) -> list[str]:
    """Each frame has one fate at each team-mate, with a reason that the records bear out."""
    broken: list[str] = []
    known = {v.value for v in Verdict} | set(REFUSALS)
    latency_s = _longest_way_s(evidence)
    dropped: dict[str, Counter[str]] = defaultdict(Counter)
    for row in evidence.records.frame_rows():
        sender, receiver, kind, _, _, _, end_s, arrive_s, verdict = row
        assert isinstance(end_s, float)
        frame = f"{kind} of {sender} at {end_s:g} s to {receiver}"
        if verdict == RECEIVER_DOWN:
            # What has arrived is read when the robot next acts, at its heartbeat at the latest.
            until_s = end_s + latency_s + evidence.scenario.sharing.status_s
            fine = _is_down(evidence, str(receiver), end_s, until_s)
        elif verdict == SENDER_DIED:
            fine = _is_down(evidence, str(sender), 0.0, end_s + LATE_S)
        elif verdict == NOT_YET_ARRIVED:
            fine = end_s + latency_s >= evidence.simulated_s
        else:
            fine = verdict in known
            born_s = max([0.0, *_births_s(evidence, str(receiver))])
            if isinstance(arrive_s, float) and arrive_s >= born_s and verdict != DELIVERED:
                dropped[str(receiver)][str(verdict)] += 1
        if not fine:
            broken.append(f"{frame}: {verdict}, which nothing explains")
    return broken + _counts(evidence, dropped)


def _counts(evidence: Evidence, dropped: dict[str, Counter[str]]) -> list[str]:
    """Hold what robots counted themselves against the records: no drop without a count."""
    broken: list[str] = []
    for final in evidence.finals:
        if final.state != "alive":
            continue
        for reason, number in sorted(dropped[final.name].items()):
            told = final.dropped_frames.get(reason, 0)
            # A doubled frame has one row: its second arrival is counted by its receiver alone.
            if told < number:
                broken.append(f"{final.name} counted {told} frames {reason}, the records {number}")
    return broken


def _longest_way_s(evidence: Evidence) -> float:
    """Return the longest time that any frame may be under way after its last bit was sent."""
    links = [evidence.scenario.links, *(c.settings for c in evidence.scenario.link_changes())]
    latencies = [link.latency_s or 0.06 for link in links]
    jitters = [link.jitter_s or 0.0 for link in links]
    held = [link.reordering_s or 1.0 for link in links if link.reordering]
    return 2 * max(latencies) + max(jitters) + max(held, default=0.0)


def _is_down(evidence: Evidence, name: str, from_s: float, to_s: float) -> bool:
    spans = [span for span in evidence.records.downtimes if span.robot == name]
    return any(span.start_s <= to_s and span.end_s >= from_s for span in spans)


# --- tethers ----------------------------------------------------------------------------------


def tethers_safe(evidence: Evidence) -> list[str]:
    """No drum runs but on command, nor for longer than a command lasts, nor beyond its rope."""
    settings = evidence.scenario.tether
    broken: list[str] = []
    for name, segments in sorted(evidence.tethers.items()):
        orders_s = _orders_s(evidence, name)
        resumed_s = [
            e.t_s for e in evidence.records.events if (e.robot, e.what) == (name, "resume")
        ]
        for segment in segments:
            start_s, end_s = segment.start_ns / 1e9, segment.end_ns / 1e9
            start_m, end_m = segment.tether_at(segment.start_ns), segment.tether_at(segment.end_ns)
            if not -1e-9 <= end_m <= settings.max_length_m + 1e-9:
                broken.append(f"{name} has {end_m:.3g} m of tether out at {end_s:g} s")
            if start_m == end_m:
                continue
            if end_s - start_s > settings.command_timeout_s + LATE_S:
                broken.append(f"{name}'s drum runs from {start_s:g} to {end_s:g} s on one command")
            if not any(abs(start_s - t_s) < LATE_S for t_s in orders_s + resumed_s):
                broken.append(f"{name}'s drum runs at {start_s:g} s without a command")
    slides = [e for e in evidence.records.events if e.what == "halted" and e.detail == "slid"]
    return broken + [f"{e.robot} slid at {e.t_s:g} s" for e in slides]


def _orders_s(evidence: Evidence, anchor: str) -> list[float]:
    deliveries = evidence.records.deliveries()
    return [rx.arrive_s for tx, rx in deliveries if tx.kind == "tether" and rx.receiver == anchor]


# --- the end ----------------------------------------------------------------------------------


def ends_in_order(evidence: Evidence) -> list[str]:
    """Nobody's program fails, nobody dies but by the scenario, and the run says how it ended."""
    broken = [f"{a.name}'s program failed: {_last_line(a.fault)}"
              for a in evidence.actors if a.fault]  # fmt: skip
    broken += [f"{a.name} died: {a.death}" for a in evidence.actors if a.death]
    if evidence.ending not in ("settled", "limit", "nobody left", "fault"):
        broken.append(f"the run broke off: {evidence.ending or 'nobody knows why'}")
    alive = [final for final in evidence.finals if final.state == "alive"]
    silent = [final.name for final in alive if final.sigma_m is None]
    if evidence.ending != "fault":
        broken += [f"{name} gave no last report" for name in silent]
    return broken


def _last_line(trace: str) -> str:
    return trace.strip().splitlines()[-1]


def no_orphan(evidence: Evidence) -> list[str]:
    """No process outlives the run."""
    return [f"{orphan} was left behind" for orphan in evidence.orphans]


INVARIANTS: dict[str, Callable[[Evidence], list[str]]] = {
    "no cell lost": no_cell_lost,
    "nothing counted twice": nothing_counted_twice,
    "survivors equal": survivors_equal,
    "frames accounted for": frames_accounted_for,
    "tethers safe": tethers_safe,
    "ends in order": ends_in_order,
    "no orphan": no_orphan,
}


# --- lives ------------------------------------------------------------------------------------


def _map_rows(evidence: Evidence) -> dict[str, list[MapRow]]:
    rows: dict[str, list[MapRow]] = defaultdict(list)
    for row in evidence.records.maps:
        rows[row.robot].append(row)
    return {name: sorted(rows[name], key=lambda row: row.t_s) for name in sorted(rows)}


def _births_s(evidence: Evidence, name: str) -> list[float]:
    """Return when a robot's later lives began: by its own word, and by what was planned.

    A life that finds nothing on its disk says no word of a former one.
    """
    told_s = [
        event.t_s
        for event in evidence.records.events
        if event.robot == name
        and event.what == "restart"
        and event.detail.startswith("incarnation")
    ]
    planned_s = [
        event.at_s + event.after_s
        for event in evidence.scenario.events
        if event.kind == "restart" and event.target == name and event.after_s is not None
    ]
    return sorted({*told_s, *planned_s})


def _seen(evidence: Evidence, name: str, from_s: float, to_s: float) -> int:
    """Return how many cells the best look of a robot in a span showed: it has at least these."""
    looks = [x for x in evidence.records.looks if x.robot == name and from_s <= x.t_s < to_s]
    return max((look.obtained_cells for look in looks), default=0)


def _careless(evidence: Evidence, name: str) -> bool:
    """Say whether a robot's disk was full or its computer slow at any time."""
    events = evidence.scenario.events
    return any(e.kind in ("full", "slow") and e.target == name for e in events)
