"""What a link is: named radios, and the settings that change them for a team, a robot or a pair.

Settings are laid over each other: team, then the sending robot, then the directed pair, then the
changes of the running scenario in the order of their instants. A layer that names a profile
replaces the radio (rate, latency, jitter, frame and overhead bytes) of the layers below it. Loss,
range and `up` are circumstances: they stay until a later layer sets them. A robot's settings are
its transmitter's, but for `up`: a radio that is off neither sends nor hears.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import Annotated, Literal

from pydantic import Field, field_validator

from comms.errors import CommsError
from comms.frames import MAX_FRAME_BYTES
from comms.settings import Settings
from comms.timebase import from_s

ProfileName = Literal["sojourner", "uhf-9600", "mer-low", "mer-high", "orbiter", "unlimited"]
DEFAULT_PROFILE: ProfileName = "uhf-9600"
ALL = "all"
"""Target of a change that concerns every link."""
MIN_FRAME_BYTES = 64
"""Every link takes frames of this length: what is urgent can be built to fit any of them."""


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


class LinkSettings(Settings):
    """What can be said about a link; what is left out stays as the layers below have it."""

    profile: ProfileName | None = None
    """The radio to start from."""
    rate_bps: Annotated[float, Field(ge=0, le=1e9)] | None = None
    """Bits a second on air, at least 1; 0 means that nothing passes."""
    latency_s: Annotated[float, Field(ge=0.001, le=3600)] | None = None
    """From the end of a frame's transmission to its arrival."""
    jitter_s: Annotated[float, Field(ge=0, le=3600)] | None = None
    """Up to this much is added to a frame's latency."""
    loss: Annotated[float, Field(ge=0, le=1)] | None = None
    """Probability that a frame is not heard."""
    frame_bytes: Annotated[int, Field(ge=MIN_FRAME_BYTES, le=MAX_FRAME_BYTES)] | None = None
    """Longest frame, envelope included."""
    overhead_bytes: Annotated[int, Field(ge=0, le=1024)] | None = None
    """Charged for every frame on top of its own bytes."""
    up: bool | None = None
    """False: switched off."""
    range_m: Annotated[float, Field(gt=0)] | None = None
    """Nothing is heard from farther off."""

    @field_validator("rate_bps")
    @classmethod
    def _whole_bits(cls, rate_bps: float | None) -> float | None:
        if rate_bps is not None and 0 < rate_bps < 1:
            raise ValueError(f"rate_bps is {rate_bps:g}; 0 (nothing passes) or at least 1 allowed")
        return rate_bps


class TeamLinks(LinkSettings):
    """The links of a team: settings for all, for one robot, for one directed pair."""

    profile: ProfileName | None = DEFAULT_PROFILE
    robots: dict[str, LinkSettings] = Field(default_factory=dict[str, LinkSettings])
    """By robot: its transmitter; `up = false` also stops its receiver."""
    pairs: dict[str, LinkSettings] = Field(default_factory=dict[str, LinkSettings])
    """By directed pair, "sender>receiver"."""

    @field_validator("pairs")
    @classmethod
    def _directed(cls, pairs: dict[str, LinkSettings]) -> dict[str, LinkSettings]:
        for key in pairs:
            pair_of(key)
        return pairs


@dataclass(frozen=True)
class LinkChange:
    """Something that happens to links while a scenario runs."""

    target: str
    """`"all"`, a robot's name, or "sender>receiver"."""
    settings: LinkSettings


def pair_of(key: str) -> tuple[str, str]:
    """Return (sender, receiver) of "sender>receiver"; raise ValueError where it is none."""
    names = [name.strip() for name in key.split(">")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise ValueError(f'pair is "{key}"; two different robots as "sender>receiver" are allowed')
    return names[0], names[1]


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


def _laid(below: LinkProfile, layer: LinkSettings) -> LinkProfile:
    """Return the link with one more layer of settings (all but `up`) laid over it."""
    if layer.profile is not None:
        below = replace(PROFILES[layer.profile], loss=below.loss, range_m=below.range_m)
    latency_ns = below.latency_ns if layer.latency_s is None else from_s(layer.latency_s)
    jitter_ns = below.jitter_ns if layer.jitter_s is None else from_s(layer.jitter_s)
    plain = ("rate_bps", "loss", "frame_bytes", "overhead_bytes", "range_m")
    said = {name: getattr(layer, name) for name in plain if getattr(layer, name) is not None}
    return replace(below, latency_ns=latency_ns, jitter_ns=jitter_ns, **said)


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
        if ">" in change.target:
            concerned = pair_of(change.target) == (sender, receiver)
        else:
            concerned = change.target in (ALL, sender, receiver)
        if concerned:
            yield change.target, change.settings


def resolve(
    links: TeamLinks, sender: str, receiver: str, changes: Iterable[LinkChange] = ()
) -> LinkProfile:
    """Return the link from `sender` to `receiver` after the `changes` that have happened so far."""
    profile = PROFILES[DEFAULT_PROFILE]
    switches = _Switches()
    for target, settings in _layers(links, sender, receiver, changes):
        if settings.up is not None:
            switches.set(target, settings.up)
        if target != receiver:
            profile = _laid(profile, settings)
    return replace(profile, up=switches.up(sender, receiver))


def least_latency_ns(
    links: TeamLinks, names: Sequence[str], changes: Sequence[LinkChange] = ()
) -> int:
    """Return the least latency of any link at any stage of the scenario: its lookahead.

    Nothing that is sent inside a span of that length can arrive inside it. Links that are down
    count too: they may come up. A team of one has no links; it gets the longest latency there is.
    """
    stages = [changes[:count] for count in range(len(changes) + 1)]
    latencies = (
        resolve(links, sender, receiver, stage).latency_ns
        for sender, receiver in permutations(names, 2)
        for stage in stages
    )
    return min(latencies, default=from_s(3600.0))


def check_names(links: TeamLinks, names: Sequence[str], changes: Iterable[LinkChange] = ()) -> None:
    """Raise LinkError where settings or changes name a robot that is not in the team."""
    keys = [*links.robots, *links.pairs, *(c.target for c in changes if c.target != ALL)]
    for key in keys:
        for name in pair_of(key) if ">" in key else (key,):
            if name not in names:
                allowed = ", ".join(names)
                raise LinkError(f'links name "{name}" (in "{key}"); the team has {allowed}')
