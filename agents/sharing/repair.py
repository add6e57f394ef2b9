"""How stores become equal though frames get lost: what is believed of team-mates, and put right.

A frame that was sent counts as heard by all. Three things say otherwise, each in few bytes:

- numbers: who hears frame 19 after 17 names 18, and whoever sent or heard 18 offers again what was
  in it;
- marks: every status carries a short hash of the sender's store. Where two robots have nothing left
  to send each other and their marks differ, both say what they have;
- a newcomer, or one that comes back, says first of all what it has.

So a team that loses nothing spends nothing on it but the marks.
"""

import hashlib
import struct
from dataclasses import dataclass

from agents.settings import SharingSettings
from agents.sharing.beliefs import GUARD_S, Beliefs, Part, Stretch, members, prefix_of
from agents.sharing.frames import SETTLING_S, Ears, FrameLog, Logged
from agents.sharing.reports import Acks, Report, pack_report
from agents.sharing.teller import Teller
from agents.store import AnchorKey, Origin, Store, TileKey, Version

FIRST_WAIT_S = 30.0
LONGEST_WAIT_S = 480.0
"""How long a robot waits before it says again what it has, where that did not help."""
NEWS_S = 10.0
"""A lost frame may wait so long to be named, for others to be named with it."""
NEAR_S = 600.0
"""Where only those near by count: who was not heard for so long is near no more."""
YOUNG_FRAMES = 8
"""Who has sent more was there before this robot, if this robot never heard of it."""
DEAF_FRAMES = 3
"""Who has heard none of so many frames of a sender does not hear it."""


@dataclass(frozen=True)
class Mark:
    """What a status says of its sender's store."""

    store: int
    """`Store.mark`."""
    settled: bool
    """Nothing is left to send."""


class ReportClock:
    """When the next report is due: what it may cost is bounded, what it waits for is not."""

    def __init__(self, settings: SharingSettings, team_size: int) -> None:
        """Start with a report at once: a newcomer says what it has."""
        self._settings = settings
        self.share_among(team_size)
        self._due_s: float | None = -1.0
        self._free_s = -1.0

    def share_among(self, robots: int) -> None:
        """Take one robot's part of what the reports of so many may take together."""
        self._share = max(self._settings.digest_share, 1e-6) / robots

    def want(self, at_s: float) -> None:
        """Have a report sent at a time, or as soon after it as the link's share allows."""
        self._due_s = at_s if self._due_s is None else min(self._due_s, at_s)

    def due(self, now_s: float) -> bool:
        """Say whether a report is due."""
        return self._due_s is not None and now_s >= max(self._due_s, self._free_s)

    def sent(self, now_s: float, size_bytes: int, rate_bps: float) -> None:
        """Note that a report was sent.

        The next comes no sooner than the share of the link allows that all robots' reports may
        take together.
        """
        self._due_s = None
        self._free_s = now_s + max(1.0, 8 * size_bytes / rate_bps / self._share)


class Repair:
    """What one robot believes of its team-mates' stores, what it says of its own, and when."""

    def __init__(
        self, settings: SharingSettings, me: Origin, team_size: int, store: Store, tile_count: int
    ) -> None:
        """Begin with team-mates that have nothing; `store` is the robot's own."""
        self.me = me
        self._near_only = settings.horizon_m is not None
        """Whether only team-mates count that were heard lately."""
        everybody = () if self._near_only else range(team_size)
        self.beliefs = Beliefs(robot for robot in everybody if robot != me.robot)
        self.clock = ReportClock(settings, 2 if self._near_only else team_size)
        self._heard_s: dict[int, float] = {}
        self._deaf_to: dict[int, int] = {}
        """By sender, the team-mates (a bit each) that said that they hear nothing of it."""
        self._store = store
        self._ears = Ears()
        self._log = FrameLog()
        self._teller = Teller(store, tile_count)
        self._says_all = True
        self._changed_s = -1e9
        self._new_lives: set[int] = set()
        """Team-mates whose present life has not yet said what it has."""
        self._began_s: dict[int, float] = {}
        """When each team-mate's present life was first heard: frames before were not for it."""
        self._differing: dict[int, tuple[float, float]] = {}
        """By team-mate whose mark differed: not before when all is said again, and then how long
        to wait."""
        self._acked: dict[int, tuple[int, float]] = {}
        """(upto, when) of what each team-mate last said of this robot's own frames."""

    @property
    def peers(self) -> list[int]:
        """The team-mates that count."""
        return self.beliefs.peers

    # --- what happens -----------------------------------------------------------------------

    def _is_near(self, robot: int, now_s: float) -> None:
        """Note that a team-mate can be heard, and forget those that could not for long."""
        self._heard_s[robot] = now_s
        if self.beliefs.everybody >> robot & 1:
            return
        gone = [mate for mate, t_s in self._heard_s.items() if now_s - t_s > NEAR_S]
        for mate in gone:
            del self._heard_s[mate]
            self.beliefs.leave(mate)
            self._ears.forget(mate)
            self._log.forget(mate)
        self.beliefs.join(robot)
        self.clock.share_among(self.beliefs.everybody.bit_count() + 1)

    def changed(self, key: TileKey, now_s: float) -> None:
        """Note that more of a tile is here."""
        self._teller.changed(key)
        self._changed_s = max(self._changed_s, now_s)

    def goes_out(self, stretch: Stretch, now_s: float) -> None:
        """Note what is in the frame that is being filled: all are believed to hear it."""
        self.beliefs.have(self.beliefs.everybody, stretch, now_s, sent=True)

    def sent(self, seq: int, now_s: float, stretches: tuple[Stretch, ...]) -> None:
        """Note which of this robot's frames held it."""
        self._log.note(*self.me, Logged(seq, now_s, stretches))

    def sent_anchor(self, seq: int, now_s: float, key: AnchorKey, version: int) -> None:
        """Note that an anchor went out in one of this robot's frames."""
        self._log.note(*self.me, Logged(seq, now_s, (), (key, version)))
        self.beliefs.have_anchor(self.beliefs.everybody, key, version)

    def heard(self, sender: Origin, seq: int, now_s: float) -> bool:
        """Note that a frame was heard, whatever was in it; return whether its sender is new."""
        if self._near_only:
            self._is_near(sender.robot, now_s)
        is_new = self._ears.hear(*sender, seq, now_s)
        if is_new:
            # A life of which nothing was heard before: it may have heard nothing either. Unless it
            # is this robot that has only come.
            if sender.robot in self._began_s or seq < YOUNG_FRAMES:
                self.beliefs.forget(sender.robot)
            # What its former life did not hear says nothing of this one's ears.
            self._acked.pop(sender.robot, None)
            self._deaf_to = {
                robot: deaf & ~(1 << sender.robot) for robot, deaf in self._deaf_to.items()
            }
            self._new_lives.add(sender.robot)
            self._began_s[sender.robot] = now_s
        elif self._ears.lost_since_s() is not None:
            self.clock.want(now_s + NEWS_S)
        return is_new

    def heard_stretches(
        self, sender: Origin, seq: int, now_s: float, stretches: tuple[Stretch, ...]
    ) -> None:
        """Note what was in a team-mate's frame: it has it, and who hears it heard it too."""
        self._log.note(*sender, Logged(seq, now_s, stretches))
        heard_by = self._hearing(sender.robot)
        for stretch in stretches:
            self.beliefs.have(heard_by, stretch, now_s)

    def heard_anchor(
        self, sender: Origin, seq: int, now_s: float, key: AnchorKey, version: int
    ) -> None:
        """Note that an anchor was in a team-mate's frame."""
        self._log.note(*sender, Logged(seq, now_s, (), (key, version)))
        self.beliefs.have_anchor(self._hearing(sender.robot), key, version)

    def _hearing(self, sender: int) -> int:
        """Return a team-mate and all who hear it, or may."""
        deaf = self._deaf_to.get(sender, 0) & ~(1 << sender)
        return self.beliefs.everybody & ~deaf

    def heard_mark(self, sender: int, mark: Mark, mine: Mark, now_s: float) -> None:
        """Compare a team-mate's store with this robot's; what differs is said, if all was sent."""
        if mark.store == mine.store:
            self._differing.pop(sender, None)
            self._ears.forgive(sender)
        elif mark.settled and mine.settled and now_s - self._changed_s > GUARD_S:
            not_before_s, wait_s = self._differing.get(sender, (now_s, FIRST_WAIT_S))
            if now_s >= not_before_s:
                self._want_all(now_s)
                self._differing[sender] = (now_s + wait_s, min(2 * wait_s, LONGEST_WAIT_S))

    def heard_report(self, sender: int, report: Report, now_s: float) -> list[TileKey]:
        """Believe what a team-mate says; return the tiles of which the belief changed."""
        changed: list[TileKey] = []
        if report.holdings is not None:
            if sender in self._new_lives and report.holdings.anchors:
                self._want_all(now_s)  # it came back with things: some are known here already
            self._new_lives.discard(sender)
            changed += self.beliefs.take(sender, report.holdings, now_s)
        for acks in report.acks:
            changed += self._take_acks(sender, acks, now_s)
        return changed

    def _take_acks(self, listener: int, acks: Acks, now_s: float) -> list[TileKey]:
        changed: list[TileKey] = []
        unheard: list[Logged] = []
        for frame in self._log.missed(acks, now_s):
            if frame.seq >= acks.upto:
                unheard.append(frame)
            if frame.denied >> listener & 1:
                continue
            frame.denied |= 1 << listener
            changed += [s.key for s in frame.stretches if self.beliefs.lacks(listener, s)]
            if frame.anchor is not None:
                self.beliefs.lacks_anchor(listener, *frame.anchor)
        if acks.robot == self.me.robot:
            # Had it heard any of what was sent since it last spoke of these frames?
            upto, since_s = self._acked.get(listener, (-1, now_s))
            self._acked[listener] = (acks.upto, now_s)
            unheard = [f for f in unheard if f.t_s > since_s and upto == acks.upto]
        else:
            unheard = [f for f in unheard if f.t_s > self._began_s.get(listener, -1.0)]
        deaf = self._deaf_to.get(acks.robot, 0)
        if (len(unheard) >= DEAF_FRAMES) != bool(deaf >> listener & 1):
            self._deaf_to[acks.robot] = deaf ^ 1 << listener
            changed += self._store.keys()  # also those of which it is believed to have nothing
        return changed

    @property
    def listeners(self) -> int:
        """Those team-mates, a bit each, that hear this robot, or may."""
        return self.beliefs.everybody & ~self._deaf_to.get(self.me.robot, 0)

    def heard_of(self, key: TileKey) -> list[tuple[Part, int]]:
        """Return what the listeners have of a tile, and who has which part."""
        return self.beliefs.parts_of(key, self.listeners)

    def before_me(self, key: TileKey, version: Version) -> int:
        """Count the team-mates whose turn it is to send a tile before it is this robot's.

        Whoever holds as much of it, and is heard by all who lack some, could send it just as well;
        a hash that is other for each tile says who begins with which (rendezvous hashing; Thaler
        and Ravishankar, 1998). So many holders catch one listener up together, without a word.
        """
        holding = lacking = 0
        for part, those in self.beliefs.parts_of(key, self.beliefs.everybody):
            if prefix_of(part, version) < version.prefix_bytes:
                lacking |= those
            else:
                holding |= those
        could = [peer for peer in members(holding) if not self._deaf_to.get(peer, 0) & lacking]
        if not could:
            return 0
        mine = _lot(self.me.robot, key)
        return sum(_lot(peer, key) < mine for peer in could)

    # --- what is said -----------------------------------------------------------------------

    def _want_all(self, now_s: float) -> None:
        if not self._says_all:
            self._says_all = True
            self.clock.want(now_s)

    def next_report(self, now_s: float, payload_bytes: int, rate_bps: float) -> bytes | None:
        """Return the payload of the report that is due, if any."""
        if not self.clock.due(now_s):
            return None
        everybody = self.peers if self._says_all else ()
        acks = _fitting(self._ears.acks(now_s, everybody), payload_bytes // 2)
        if self._says_all:
            payload = self._teller.next_payload(acks, payload_bytes)
        elif acks:
            payload = pack_report(Report(acks))
        else:
            self.clock.sent(now_s, 0, rate_bps)  # what was missed has come after all
            return None
        self._ears.told(acks)
        self.clock.sent(now_s, len(payload), rate_bps)
        if self._says_all and self._teller.has_more:
            self.clock.want(now_s)
        else:
            self._says_all = False
        if self._ears.lost_since_s() is not None:
            self.clock.want(now_s + SETTLING_S)
        return payload


def _lot(robot: int, key: TileKey) -> int:
    """Return the lot of a robot for a tile: the lowest goes first."""
    packed = struct.pack("<5q", robot, *key)
    return int.from_bytes(hashlib.blake2s(packed, digest_size=8).digest(), "little")


def _fitting(acks: tuple[Acks, ...], room_bytes: int) -> tuple[Acks, ...]:
    """Leave out what does not fit, from the end."""
    while acks and len(pack_report(Report(acks))) > room_bytes:
        acks = acks[:-1]
    return acks
