"""What a robot says of itself and of what it saw: its status, fixes, and the map by its policy."""

import asyncio

from agents.briefing import ACTIVITIES, AgentSettings, RobotLog
from agents.disk import Disk, DiskError
from agents.geometry import Floats, Pose, wrap_angle
from agents.member.interest import SILENT_S
from agents.member.keeper import Keeper
from agents.messages import Fix, Status, pack_fix, pack_status
from agents.ports import Hardware
from agents.pose.localising import origin_of
from agents.sharing import Free
from comms.frames import Kind
from comms.radio import Outgoing

KEEP_ALIVE_S = 60.0
"""A robot of which nothing changes says so this often."""
TOLD_M = 0.3
TOLD_RAD = 0.2
"""A robot that has moved or turned less than this need not say so."""


class Teller(Keeper):
    """A keeper that answers its link: what goes out next?"""

    def __init__(
        self, settings: AgentSettings, hardware: Hardware, disk: Disk, log: RobotLog
    ) -> None:
        """Have nothing told yet."""
        super().__init__(settings, hardware, disk, log)
        self.origin: int | None = None
        """Whose pose the team's frame hangs on, as far as this robot can hear."""
        self.activity = "starting"
        self.claim: tuple[float, float, float] | None = None
        self.finished = False
        self._status_due = True
        self._told: Status | None = None
        self._told_s = 0.0
        self._fixes: dict[int, Fix] = {}

    def settle(self, pose: Pose, covariance: Floats, by: str) -> None:
        """Learn for the first time where it is in the team frame, and all that it mapped so far."""
        self.filter.settle(pose, covariance)
        self.located = True
        self.log.event("located", by)
        self.correct_anchors()
        self.tell_status()

    def set_activity(self, activity: str) -> None:
        """Say what it is doing; team-mates hear of it."""
        assert activity in ACTIVITIES
        if activity != self.activity:
            self.activity = activity
            self.log.event("activity", activity)
            self.tell_status()

    def tell_status(self) -> None:
        """Have the status sent next."""
        self._status_due = True
        self.kick()

    def tell_fix(self, fix: Fix) -> None:
        """Have a team-mate told where it was seen."""
        self._fixes[fix.robot] = fix
        self.kick()

    def choose_frame(self, now_ns: int, payload_bytes: int) -> Outgoing | None:
        """Answer the link, which is free: what goes out next?"""
        if not self.may_speak:
            return None
        if self._fixes:
            index = min(self._fixes)
            return Outgoing(Kind.FIX, pack_fix(self._fixes.pop(index)))
        if self._status_due:
            self._status_due = False
            self._told, self._told_s = self._status(), now_ns / 1e9
            return Outgoing(Kind.STATUS, pack_status(self._told))
        try:
            seq = 0 if self.radio is None else self.radio.next_seq
            free = Free(now_ns / 1e9, payload_bytes, self.rate_bps(), seq)
            chosen = self.sharing.choose(free)
        except DiskError as error:
            self.durable.tell(error)
            return None
        return None if chosen is None else Outgoing(*chosen)

    def _status(self) -> Status:
        winch = self.hardware.winch
        return Status(
            self.pose,
            self.said_variance,
            ACTIVITIES.index(self.activity),
            self.claim,
            winch.length_m if winch is not None else 0.0,
            self.store.mark,
            self.sharing.settled(),
        )

    def look_for_origin(self, now_s: float) -> None:
        """Find out whose pose the team's frame hangs on now; say so where it is this robot's."""
        before, me = self.origin, self.settings.index
        self.origin = origin_of(
            self.settings, self.mates, heard_since_s=now_s - SILENT_S, located=self.located
        )
        if self.origin == me and before not in (me, None):
            self.log.event("origin", f"in place of {self.settings.roster[before]}")

    async def heartbeat(self) -> None:
        """Tell the team now and then where it is; looks whether a digest is due as well."""
        while True:
            self.look_for_origin(self.now_s)
            told, overdue = self._told, self.now_s >= self._told_s + KEEP_ALIVE_S
            if told is None or overdue or _differs(self._status(), told):
                self.tell_status()
            if self.interest.moves_to(self.pose):
                self.sharing.look_again()
            self.kick()
            await asyncio.sleep(self.settings.sharing.status_s)

    @property
    def settled(self) -> bool:
        """Whether its work is done and nothing that is worth its bytes is left to send."""
        return self.finished and not self._fixes and self.sharing.settled()


def _differs(status: Status, told: Status) -> bool:
    """Say whether a status tells team-mates something that they would act on."""
    moved_m = status.pose.distance_m(told.pose)
    turned_rad = abs(wrap_angle(status.pose.yaw_rad - told.pose.yaw_rad))
    return (
        moved_m > TOLD_M
        or turned_rad > TOLD_RAD
        or abs(status.tether_m - told.tether_m) > TOLD_M
        or (status.activity, status.claim) != (told.activity, told.claim)
    )
