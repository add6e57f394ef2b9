"""What a fleet's robots send and keep, counted over a span of time."""

from collections import Counter
from dataclasses import dataclass

from agents.sharing.value import Value
from scenarios.fleet.fleet import Fleet


@dataclass(frozen=True)
class Account:
    """What a fleet's robots sent and kept, on average for each, over a span of time."""

    robots: int
    looks: float
    bytes_per_min: dict[str, float]
    """Charged bytes, by kind of frame."""
    digest_bytes: float
    """Mean length of a digest frame, as charged."""
    mates: float
    """Team-mates that count for a robot."""
    tiles: float
    """Tiles in its store."""
    payload_bytes: float
    beliefs: float
    """Parts of tiles that it remembers as what some of its team-mates have."""

    @property
    def all_bytes_per_min(self) -> float:
        """Bytes of all kinds."""
        return sum(self.bytes_per_min.values())


def account(fleet: Fleet, begin_s: float, until_s: float) -> Account:
    """Run a fleet and count what happens between two times."""
    fleet.run(begin_s)
    members = list(fleet.members.values())
    before = [(Counter(m.log.bytes), Counter(m.log.frames), m.log.looks) for m in members]
    fleet.run(until_s)
    minutes, count = (until_s - begin_s) / 60.0, len(members)
    sent: Counter[str] = Counter()
    frames: Counter[str] = Counter()
    looks = 0
    for member, (sent_then, frames_then, looks_then) in zip(members, before, strict=True):
        sent.update(member.log.bytes - sent_then)
        frames.update(member.log.frames - frames_then)
        looks += member.log.looks - looks_then
    policies = [m.robot.sharing for m in members]
    repairs = [policy.repair for policy in policies if isinstance(policy, Value)]
    return Account(
        robots=count,
        looks=looks / count,
        bytes_per_min={kind: n / minutes / count for kind, n in sorted(sent.items())},
        digest_bytes=sent["digest"] / max(1, frames["digest"]),
        mates=sum(len(r.peers) for r in repairs) / count,
        tiles=sum(len(m.robot.store.keys()) for m in members) / count,
        payload_bytes=sum(m.robot.store.payload_bytes for m in members) / count,
        beliefs=sum(r.beliefs.parts for r in repairs) / count,
    )
