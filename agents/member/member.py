"""What a robot makes of what it hears; what cannot be understood is told and changes nothing."""

import numpy as np

from agents.briefing import ACTIVITIES, AgentSettings, Inbox, Mate, RobotLog
from agents.disk import Disk
from agents.errors import AgentError
from agents.layers import UNLOCATED_M2
from agents.member.teller import Teller
from agents.messages import (
    Fix,
    unpack_anchor,
    unpack_chunks,
    unpack_fix,
    unpack_status,
    unpack_tethers,
)
from agents.ports import Hardware
from agents.pose.localising import GATE
from agents.pose.stops import Stops
from agents.sharing import Heard, Mark
from agents.sharing.reports import unpack_report
from agents.store import Chunk, Origin
from comms.errors import CommsError
from comms.frames import Frame, Kind


class Member(Teller):
    """A robot as a member of its team, in one incarnation: what it keeps, tells and hears.

    It knows nothing of wheels and cameras; `agents.robot.Robot` adds these.
    """

    def __init__(
        self, settings: AgentSettings, hardware: Hardware, disk: Disk, log: RobotLog
    ) -> None:
        """Put a member together; on a disk that holds a former life (`Disk.begin`), take it up."""
        super().__init__(settings, hardware, disk, log)
        self.inbox = Inbox()
        self.stands_since_s = 0.0
        """Since when it has not moved; inf while it moves."""
        self.stops = Stops()
        self._lives: dict[int, int] = {}
        """Incarnation last heard, by robot."""

    def on_frame(self, frame: Frame, arrive_ns: int) -> None:
        """Take in a team-mate's frame; what cannot be understood is told and changes nothing."""
        try:
            self._take(frame, arrive_ns / 1e9)
        except (AgentError, CommsError) as error:
            sender = self.settings.roster[frame.sender]
            self.log.event("refused", f"{frame.kind.name} of {sender}: {error}")

    def _take(self, frame: Frame, now_s: float) -> None:
        heard = Heard(Origin(frame.sender, frame.incarnation), frame.seq, now_s)
        if self._lives.get(frame.sender) != frame.incarnation:
            self._lives[frame.sender] = frame.incarnation
            self.sharing.newcomer(frame.sender)
            self.kick()
        self.sharing.heard_frame(heard)
        match frame.kind:
            case Kind.MAP:
                self._take_map(frame.payload, heard)
            case Kind.ANCHOR:
                key, anchor = unpack_anchor(frame.payload)
                mine = self.store.anchors.get(key)
                self._check_writer(Origin(*key[:2]), anchor.version, mine and mine.version)
                if self.store.offer_anchor(key, anchor):
                    self.team.anchor_changed(key)
                    self.map_changed_s = now_s
                self.sharing.heard_anchor(heard, key, anchor.version)
            case Kind.DIGEST:
                self.sharing.heard_report(heard, unpack_report(frame.payload))
                self.kick()
            case Kind.STATUS:
                status = unpack_status(frame.payload)
                if status.activity >= len(ACTIVITIES):
                    allowed = f"0 to {len(ACTIVITIES) - 1} are known"
                    raise AgentError(f"activity {status.activity}; {allowed}")
                self.mates[frame.sender] = Mate(status, now_s)
                self.look_for_origin(now_s)
                self.sharing.heard_mark(heard, Mark(status.store_mark, status.settled))
            case Kind.FIX:
                fix = unpack_fix(frame.payload)
                if fix.robot == self.settings.index:
                    self._take_fix(fix, self.settings.roster[frame.sender])
            case Kind.TETHER:
                self.inbox.tethers.extend(
                    c for c in unpack_tethers(frame.payload) if c.robot == self.settings.index
                )
                self.inbox.arrived.set()
            case Kind.STOP:
                self.inbox.arrived.set()

    def _take_fix(self, fix: Fix, sender: str) -> None:
        covariance = np.diag(fix.variance)
        if self.located:
            stop = self.stops.at(fix.t_s)
            if fix.t_s >= self.stands_since_s:
                self.filter.fix(fix.pose, covariance, gate=GATE)
            elif stop is not None:
                self.filter.fix_former(stop, fix.pose, covariance, gate=GATE)
            self.correct_anchors()
        elif max(fix.variance[:2]) < UNLOCATED_M2 and fix.t_s >= self.stands_since_s:
            # Where it was seen before it moved on says nothing of where it is.
            self.settle(fix.pose, covariance, f"seen by {sender}")

    def _take_map(self, payload: bytes, heard: Heard) -> None:
        taken: list[tuple[Chunk, bool]] = []
        try:
            self._take_chunks(unpack_chunks(payload, heard.sender), heard, taken)
        finally:
            self.sharing.heard_chunks(heard, taken)

    def _take_chunks(
        self, chunks: list[Chunk], heard: Heard, taken: list[tuple[Chunk, bool]]
    ) -> None:
        for chunk in chunks:
            self._check(chunk)
        for chunk in chunks:
            if not self.grid.holds(chunk.key.tile):
                continue  # of ground that this robot does not keep
            changed = self.store.offer(chunk)
            if changed:
                self.team.tile_changed(chunk.key)
                self.map_changed_s = heard.now_s
            taken.append((chunk, changed))

    def _check(self, chunk: Chunk) -> None:
        if chunk.key.tile >= self.grid.count:
            raise AgentError(
                f"tile {chunk.key.tile}: the team's map has tiles 0 to {self.grid.count - 1}"
            )
        mine = self.store.newest(chunk.key)
        self._check_writer(chunk.key.origin, chunk.version, mine and mine.number)

    def _check_writer(self, origin: Origin, version: int, newest: int | None) -> None:
        """Refuse what is of nobody's, and what claims to be this robot's own and news to it."""
        if origin.robot >= len(self.settings.roster):
            last = len(self.settings.roster) - 1
            raise AgentError(f"a map of robot {origin.robot}; the team has robots 0 to {last}")
        if origin == self.me and (newest is None or version > newest):
            raise AgentError(
                f"version {version} of this robot's own map; it has published up to {newest}"
            )
