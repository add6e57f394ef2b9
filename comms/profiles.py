"""What a link is: named radios, and how settings for a team, a robot or a pair change them.

Settings are laid over each other: team, then the sending robot, then the directed pair, then the
changes of the running scenario in the order of their instants. A layer that names a profile
replaces the radio (rate, latency, jitter, frame and overhead bytes) of the layers below it. All
else (`up`, range, loss and the other faults, the channel) is circumstance: it stays until a later
layer sets it. A robot's settings are its transmitter's, but for `up` (a radio that is off neither
sends nor hears) and the height of its antenna.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from comms.channel import ONE_EACH, Shared, airtime_ns
from comms.errors import CommsError
from comms.faults import NO_FAULTS, Faults
from comms.linksettings import (
    ALL,
    DEFAULT_PROFILE,
    MIN_FRAME_BYTES,
    LinkChange,
    LinkSettings,
    ProfileName,
    TeamLinks,
    pair_of,
)
from comms.timebase import from_s


class LinkError(CommsError):
    """Link settings name something that the team doesn't have."""


@dataclass(frozen=True)
class LinkProfile:
    """One directed link, all settled."""

    name: str
    rate_bps: float
    """Bits a second on air; infinite: frames take no time; 0: nothing passes."""
    latency_ns: int
    """From the end of a frame's transmission to its arrival, at least."""
    frame_bytes: int
    """Longest frame that the modem takes, envelope included."""
    overhead_bytes: int
    """Charged for every frame on top: preamble, sync, the modem's own header and checksum."""
    jitter_ns: int = 0
    """A frame arrives up to this much later, evenly distributed."""
    loss: float = 0.0
    """Probability that a frame is not heard, each for itself."""
    up: bool = True
    range_m: float | None = None
    """Nothing is heard from farther off; None: range doesn't matter."""
    faults: Faults = NO_FAULTS
    """What else may go wrong."""
    shared: Shared = ONE_EACH
    """Who may speak when; the same for all links of a team."""
    antenna_m: float = 1.0
    """Height of the sender's antenna over the ground."""
    mate_antenna_m: float = 1.0
    """Height of the receiver's."""

    @property
    def carries(self) -> bool:
        """Say whether anything passes at all."""
        return self.up and self.rate_bps > 0


PROFILES: dict[ProfileName, LinkProfile] = {
    # Sujan & Meggiolaro, section 2.4: 2400 bps effective. Its modem took frames of 256 bytes, each
    # with 6 bytes of sync, number and CRC; keying the transmitter is the latency.
    "sojourner": LinkProfile("sojourner", 2400.0, 50_000_000, 256, 6),
    # The same kind of modem at its rate on air, with AX.25 framing: two flags, addresses, control,
    # protocol and checksum.
    "uhf-9600": LinkProfile("uhf-9600", 9600.0, 30_000_000, 256, 20),
    # Rates of the Mars Exploration Rovers to Earth (section 2.4), as rates between robots: minutes
    # of light time are left out. CCSDS transfer frames: sync marker 4, header 6, checksum 2.
    "mer-low": LinkProfile("mer-low", 3000.0, 50_000_000, 256, 12),
    "mer-high": LinkProfile("mer-high", 12_000.0, 50_000_000, 512, 12),
    # Rover to orbiter at 128 kbps, Proximity-1 framing: sync marker 3, header 5, checksum 4.
    "orbiter": LinkProfile("orbiter", 128_000.0, 50_000_000, 1024, 12),
    # For comparison: what a team could do if bytes were free. News still takes a moment.
    "unlimited": LinkProfile("unlimited", math.inf, 20_000_000, 1024, 0),
}
_CIRCUMSTANCES = (
    "loss",
    "range_m",
    "faults",
    "shared",
    "antenna_m",
    "mate_antenna_m",
)
_PLAIN = (
    "rate_bps",
    "latency_ns",
    "jitter_ns",
    "frame_bytes",
    "overhead_bytes",
    "loss",
    "range_m",
    "antenna_m",
)
_FAULTS = tuple(f.name for f in fields(Faults))
_SHARED = {"kind": "channel", "slot_ns": "slot_ns", "backoff_ns": "backoff_ns"}


@dataclass
class _Switches:
    """Whether a link is up: its pair's switch if it has one, else both radios, else the team's.

    Switching a robot leaves a pair alone that was switched off for itself; switching all ends all
    exceptions.
    """

    team: bool = True
    radios: dict[str, bool] = field(default_factory=dict[str, bool])
    pair: bool | None = None

    def set(self, target: str, up: bool) -> None:
        if ">" in target:
            self.pair = up
            return
        if target == ALL:
            self.team = up
            self.radios.clear()
        else:
            self.radios[target] = up
        if target == ALL or self.pair:
            self.pair = None

    def up(self, sender: str, receiver: str) -> bool:
        if self.pair is not None:
            return self.pair
        return self.radios.get(sender, self.team) and self.radios.get(receiver, True)


def _said(layer: LinkSettings, name: str) -> Any:
    """Return what a layer says of a link's field, in that field's unit; None: nothing."""
    if not name.endswith("_ns"):
        return getattr(layer, name, None)
    value_s = getattr(layer, f"{name[:-3]}_s", None)
    if name == "outages_ns":
        return None if value_s is None else tuple((from_s(a), from_s(b)) for a, b in value_s)
    return None if value_s is None else from_s(value_s)


def _news(layer: LinkSettings, names: Iterable[str]) -> dict[str, Any]:
    said = {f"{key[:-2]}_ns" if key.endswith("_s") else key for key in layer.model_fields_set}
    told = {name: _said(layer, name) for name in names if name in said}
    return {name: value for name, value in told.items() if value is not None}


def _laid(below: LinkProfile, layer: LinkSettings) -> LinkProfile:
    """Return the link with one more layer of settings (all but `up`) laid over it."""
    if layer.model_fields_set == {"up"}:
        return below
    if layer.profile is not None:
        kept = {name: getattr(below, name) for name in _CIRCUMSTANCES}
        below = replace(PROFILES[layer.profile], **kept)
    news = _news(layer, _PLAIN)
    if faults := _news(layer, _FAULTS):
        news["faults"] = replace(below.faults, **faults)
    shared = {name: _said(layer, key) for name, key in _SHARED.items()}
    if shared := {name: value for name, value in shared.items() if value is not None}:
        news["shared"] = replace(below.shared, **shared)
    return replace(below, **news)


def _layers(
    links: TeamLinks, sender: str, receiver: str, changes: Iterable[LinkChange]
) -> Iterable[tuple[str, LinkSettings]]:
    """Yield (target, settings) of all that concerns a link, in the order of laying."""
    yield ALL, links
    for name in (receiver, sender):
        if name in links.robots:
            yield name, links.robots[name]
    for key, settings in links.pairs.items():
        if pair_of(key) == (sender, receiver):
            yield key, settings
    for change in changes:
        if concerns(change, sender, receiver):
            yield change.target, change.settings


def concerns(change: LinkChange, sender: str, receiver: str) -> bool:
    """Say whether a change may alter the link from `sender` to `receiver`."""
    if ">" in change.target:
        return pair_of(change.target) == (sender, receiver)
    return change.target in (ALL, sender, receiver)


class Standing:
    """One directed link as layer upon layer of settings makes it."""

    def __init__(self, sender: str, receiver: str) -> None:
        """Begin with the default profile."""
        self._sender, self._receiver = sender, receiver
        self._profile = PROFILES[DEFAULT_PROFILE]
        self._switches = _Switches()

    def lay(self, target: str, settings: LinkSettings) -> None:
        """Lay settings over it that are said of a target which concerns it."""
        if settings.up is not None:
            self._switches.set(target, settings.up)
        if target != self._receiver:
            self._profile = _laid(self._profile, settings)
        height_m = _said(settings, "antenna_m")
        if target in (ALL, self._receiver) and height_m is not None:
            self._profile = replace(self._profile, mate_antenna_m=height_m)

    def profile(self) -> LinkProfile:
        """Return the link as it is now."""
        return replace(self._profile, up=self._switches.up(self._sender, self._receiver))


def standing(
    links: TeamLinks, sender: str, receiver: str, changes: Iterable[LinkChange] = ()
) -> Standing:
    """Return the link from `sender` to `receiver` as it stands after changes; more may be laid."""
    return _stacked(_layers(links, sender, receiver, changes), sender, receiver)


def _stacked(layers: Iterable[tuple[str, LinkSettings]], sender: str, receiver: str) -> Standing:
    found = Standing(sender, receiver)
    for target, settings in layers:
        found.lay(target, settings)
    return found


def resolve(
    links: TeamLinks, sender: str, receiver: str, changes: Iterable[LinkChange] = ()
) -> LinkProfile:
    """Return the link from `sender` to `receiver` after the `changes` that have happened so far."""
    return standing(links, sender, receiver, changes).profile()


def _ever(
    links: TeamLinks, names: Sequence[str], changes: Sequence[LinkChange]
) -> Iterable[tuple[str, list[LinkProfile]]]:
    """Yield each robot with its links to all others, at every stage of the scenario.

    Links that the same layers make are made once: a large team has thousands of pairs, and few
    kinds of them.
    """
    known: dict[tuple[tuple[int, bool, bool], ...], LinkProfile] = {}

    def link(sender: str, receiver: str, count: int) -> LinkProfile:
        layers = list(_layers(links, sender, receiver, changes[:count]))
        kind = tuple((id(settings), t == sender, t == receiver) for t, settings in layers)
        if kind not in known:
            known[kind] = _stacked(layers, sender, receiver).profile()
        return known[kind]

    for count in range(len(changes) + 1):
        for name in names:
            yield name, [link(name, mate, count) for mate in names if mate != name]


def least_latency_ns(
    links: TeamLinks, names: Sequence[str], changes: Sequence[LinkChange] = ()
) -> int:
    """Return the least latency of any link at any stage of the scenario: its lookahead.

    Nothing that is sent inside a span of that length can arrive inside it. Links that are down
    count too: they may come up. A team of one has no links; it gets the longest latency there is.
    """
    of_latency = [c for c in changes if c.settings.latency_s or c.settings.profile]
    ever = _ever(links, names, of_latency)
    return min((p.latency_ns for _, mine in ever for p in mine), default=from_s(3600.0))


def tightest_turn_ns(
    links: TeamLinks, names: Sequence[str], changes: Sequence[LinkChange] = ()
) -> tuple[int, int] | None:
    """Return (length of a turn, airtime of the shortest frame) where that is tightest, ever.

    None where there never are turns (tdma) on links that carry anything.
    """
    said = (links, *(change.settings for change in changes))
    if not any(_said(layer, "channel") == "tdma" for layer in said):
        return None
    found: list[tuple[int, int]] = []
    for _, links_of_one in _ever(links, names, changes):
        mine = [p for p in links_of_one if p.carries and p.shared.kind == "tdma"]
        if mine:
            charged_bytes = MIN_FRAME_BYTES + max(p.overhead_bytes for p in mine)
            need_ns = airtime_ns(charged_bytes, min(p.rate_bps for p in mine))
            found.append((mine[0].shared.slot_ns, need_ns))
    return min(found, key=lambda pair: pair[0] - pair[1], default=None)


def check_names(links: TeamLinks, names: Sequence[str], changes: Iterable[LinkChange] = ()) -> None:
    """Raise LinkError where settings or changes name a robot that is not in the team."""
    keys = [*links.robots, *links.pairs, *(c.target for c in changes if c.target != ALL)]
    for key in keys:
        for name in pair_of(key) if ">" in key else (key,):
            if name not in names:
                allowed = ", ".join(names)
                raise LinkError(f'links name "{name}" (in "{key}"); the team has {allowed}')
