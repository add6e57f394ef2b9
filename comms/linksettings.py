"""What can be said about links in a scenario, and what is refused.

Settings come in layers (team, robot, pair, events); a key that is left out stays as the layers
below have it. `comms.profiles` lays them over each other.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, field_validator

from comms.channel import ChannelKind
from comms.faults import TraceEnd
from comms.frames import MAX_FRAME_BYTES
from comms.settings import Settings

ProfileName = Literal["sojourner", "uhf-9600", "mer-low", "mer-high", "orbiter", "unlimited"]
DEFAULT_PROFILE: ProfileName = "uhf-9600"
ALL = "all"
"""Target of a change that concerns every link."""
MIN_FRAME_BYTES = 64
"""Every link takes frames of this length: what is urgent can be built to fit any of them."""
MIN_SPELL_S = 0.01

Share = Annotated[float, Field(ge=0, le=1)]
Seconds = Annotated[float, Field(ge=0, le=1e7)]


class LinkSettings(Settings):
    """What can be said about a directed link."""

    profile: ProfileName | None = None
    """The radio to start from."""
    rate_bps: Annotated[float, Field(ge=0, le=1e9)] | None = None
    """Bits a second on air, at least 1; 0 means that nothing passes."""
    latency_s: Annotated[float, Field(ge=0.001, le=3600)] | None = None
    """From the end of a frame's transmission to its arrival."""
    jitter_s: Annotated[float, Field(ge=0, le=3600)] | None = None
    """Up to this much is added to a frame's latency; frames keep their order."""
    frame_bytes: Annotated[int, Field(ge=MIN_FRAME_BYTES, le=MAX_FRAME_BYTES)] | None = None
    """Longest frame, envelope included."""
    overhead_bytes: Annotated[int, Field(ge=0, le=1024)] | None = None
    """Charged for every frame on top of its own bytes."""
    up: bool | None = None
    """False: switched off."""
    range_m: Annotated[float, Field(gt=0)] | None = None
    """Nothing is heard from farther off."""
    line_of_sight: bool | None = None
    """True: nothing is heard where ground stands between the two antennas."""
    loss: Share | None = None
    """Probability that a frame is not heard, each for itself."""
    burst_s: Seconds | None = None
    """Mean length of a bad spell (Gilbert and Elliott), at least 0.01; 0: there are none."""
    burst_gap_s: Annotated[float, Field(ge=MIN_SPELL_S, le=1e7)] | None = None
    """Mean length of the good time between two bad spells; left out: 60."""
    burst_loss: Share | None = None
    """Instead of `loss`, of a frame that meets a bad spell; left out: 1."""
    outages_s: tuple[Annotated[tuple[Seconds, Seconds], Field(strict=False)], ...] | None = Field(
        default=None, strict=False
    )
    """Spans [from, to] of the run, in order, in which nothing passes; [] ends them."""
    trace_file: str | None = None
    """CSV file with `t_s` and `up` or `delivery_ratio`, read from its first row on; "": none."""
    trace_end: TraceEnd | None = None
    """After a trace's last row: begin anew, or hold that row; left out: hold."""
    half_duplex: bool | None = None
    """True: a robot that sends hears nothing meanwhile."""
    bit_errors: Annotated[float, Field(ge=0, le=0.5)] | None = None
    """Probability of each bit of a frame to arrive flipped; such frames are dropped as damaged."""
    duplication: Share | None = None
    """Probability that a frame arrives twice; the copy follows within one more latency."""
    reordering: Share | None = None
    """Probability that a frame is held back, so that later ones overtake it."""
    reordering_s: Annotated[float, Field(gt=0, le=3600)] | None = None
    """A frame is held back up to this long; left out: 1."""

    @field_validator("rate_bps")
    @classmethod
    def _whole_bits(cls, rate_bps: float | None) -> float | None:
        if rate_bps is not None and 0 < rate_bps < 1:
            raise ValueError(f"rate_bps is {rate_bps:g}; 0 (nothing passes) or at least 1 allowed")
        return rate_bps

    @field_validator("burst_s")
    @classmethod
    def _no_flicker(cls, burst_s: float | None) -> float | None:
        if burst_s is not None and 0 < burst_s < MIN_SPELL_S:
            raise ValueError(f"burst_s is {burst_s:g}; 0 (none) or at least {MIN_SPELL_S} allowed")
        return burst_s

    @field_validator("outages_s")
    @classmethod
    def _in_order(
        cls, outages_s: tuple[tuple[float, float], ...] | None
    ) -> tuple[tuple[float, float], ...] | None:
        free_s = 0.0
        for number, (from_s, to_s) in enumerate(outages_s or ()):
            if not free_s <= from_s < to_s:
                raise ValueError(
                    f"outage {number} is [{from_s:g}, {to_s:g}]; it must end after it begins, and"
                    f" begin at {free_s:g} or later, when those before it are over"
                )
            free_s = to_s
        return outages_s


class RobotLinks(LinkSettings):
    """What can be said about a robot's radio: its transmitter's links, and its antenna."""

    antenna_m: Annotated[float, Field(ge=0.2, le=100)] | None = None
    """Height of the antenna over the ground, for `line_of_sight`; left out: 1. Not of a pair."""


class AllLinks(RobotLinks):
    """What can be said about all links at once: also who may speak when."""

    channel: ChannelKind | None = None
    """Own: each its own, nobody disturbs anybody; tdma: turns in the order of the team; csma: who
    finds the channel free speaks, and who speaks at once with others is not understood. Left out:
    own. For all robots only."""
    slot_s: Annotated[float, Field(gt=0, le=3600)] | None = None
    """Length of a turn (tdma); left out: 2. For all robots only."""
    backoff_s: Annotated[float, Field(gt=0, le=3600)] | None = None
    """Longest wait once the channel is free again (csma); left out: 0.5. For all robots only."""


class TeamLinks(AllLinks):
    """The links of a team: settings for all, for one robot, for one directed pair."""

    profile: ProfileName | None = DEFAULT_PROFILE
    robots: dict[str, RobotLinks] = Field(default_factory=dict[str, RobotLinks])
    """By robot: its transmitter; `up = false` also stops its receiver."""
    pairs: dict[str, LinkSettings] = Field(default_factory=dict[str, LinkSettings])
    """By directed pair, "sender>receiver"."""

    @field_validator("pairs")
    @classmethod
    def _directed(cls, pairs: dict[str, LinkSettings]) -> dict[str, LinkSettings]:
        for key in pairs:
            pair_of(key)
        return pairs


def keys_said(settings: AllLinks) -> list[str]:
    """Return the keys of links that are set."""
    return [key for key in AllLinks.model_fields if getattr(settings, key) is not None]


def check_target(target: str, keys: Iterable[str]) -> None:
    """Raise ValueError where a key of links can't be said of a target (all, a robot, a pair)."""
    kind = AllLinks if target == ALL else LinkSettings if ">" in target else RobotLinks
    strange = [key for key in keys if key not in kind.model_fields]
    if strange:
        allowed = "a robot or all" if strange[0] in RobotLinks.model_fields else "all"
        raise ValueError(f'has {strange[0]} for "{target}"; only link = {allowed} may have it')


@dataclass(frozen=True)
class LinkChange:
    """Something that happens to links while a scenario runs."""

    target: str
    """`"all"`, a robot's name, or "sender>receiver"."""
    settings: LinkSettings

    def __str__(self) -> str:
        """Name what changes."""
        keys = self.settings.model_dump(exclude_none=True)
        return ", ".join(f"{key} = {value}" for key, value in keys.items())


def pair_of(key: str) -> tuple[str, str]:
    """Return (sender, receiver) of "sender>receiver"; raise ValueError where it is none."""
    names = [name.strip() for name in key.split(">")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise ValueError(f'pair is "{key}"; two different robots as "sender>receiver" are allowed')
    return names[0], names[1]
