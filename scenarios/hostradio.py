"""A simulated robot's radio: its links by the scenario, and its end of the air."""

import math
from collections.abc import Callable
from typing import Protocol

from comms.air import Handler, Packet
from comms.channel import Seat
from comms.frames import Frame, Opener, Sealer
from comms.link import Receiver, Transmitter
from comms.profiles import LinkProfile, concerns, standing
from comms.radio import Choose, Radio
from comms.timebase import NS, from_s, to_s
from comms.traffic import RadioLog
from scenarios.dice import dice, team_key
from scenarios.schema import Scenario
from scenarios.wire import Plan
from sim.clock import ScaledLoop, VirtualLoop
from sim.motion import Motions
from sim.propagation import Propagation


def lookahead_ns(scenario: Scenario) -> int:
    """Return the least latency of any link at any stage: nothing travels faster."""
    return scenario.lookahead_ns


class Outbox(Protocol):
    """Where a host's packets go."""

    def put(self, packet: Packet) -> None:
        """Carry a packet to the team."""
        ...


class HostAir:
    """The host's end of the air: what is sent goes to the outbox, what comes is handed in."""

    def __init__(self, outbox: Outbox, roster: list[str], me: str) -> None:
        """Join a team."""
        self.outbox = outbox
        self.roster = roster
        self.me = me
        self.sent = 0
        """Packets of this life."""
        self.urgent: list[tuple[str, int]] = []
        self.lags_s: list[float] = []
        """How long after their due time packets were handed over, in seconds of the run."""
        self._handler: Handler | None = None

    def put(self, packet: Packet) -> None:
        """Send a packet, and remember whom it wakes."""
        self.sent += 1
        if packet.urgent:
            self.urgent.extend(packet.arrivals)
        self.outbox.put(packet)

    def listen(self, handler: Handler) -> None:
        """Have packets handed to the radio."""
        self._handler = handler

    def deliver(self, loop: VirtualLoop | ScaledLoop, packet: Packet, after_ns: int = 0) -> None:
        """Post a packet on the loop for each of its arrivals here; those before `after_ns` not."""
        for name, arrive_ns in packet.arrivals:
            if name == self.me and arrive_ns >= after_ns:
                self._post(loop, packet, arrive_ns)

    def _post(self, loop: VirtualLoop | ScaledLoop, packet: Packet, arrive_ns: int) -> None:
        handler = self._handler
        if handler is None:
            return

        def arrive() -> None:
            if isinstance(loop, ScaledLoop):  # on the virtual clock nothing is late
                self.lags_s.append(loop.time() - to_s(arrive_ns))
            handler(packet, arrive_ns)

        source = self.roster.index(packet.sender)
        loop.post(arrive_ns, source, packet.number, arrive, packet.urgent)


class HostLinks:
    """The links from and to one robot, as the scenario and what has happened of it make them."""

    def __init__(self, scenario: Scenario, me: str, happened: tuple[int, ...]) -> None:
        """Take the scenario, and the link events (indices in its timeline) that are past."""
        self.me = me
        self.roster = list(scenario.robots)
        self.mates = [name for name in self.roster if name != me]
        self._timeline = scenario.timeline()
        changes = [self._timeline[index].link_change() for index in happened]
        ways = [(me, mate) for mate in self.mates] + [(mate, me) for mate in self.mates]
        self._standing = {way: standing(scenario.links, *way, changes) for way in ways}

    def from_me(self) -> dict[str, LinkProfile]:
        """Return the link to each team-mate, in roster order."""
        return {mate: self._standing[self.me, mate].profile() for mate in self.mates}

    def to_me(self) -> dict[str, LinkProfile]:
        """Return the link from each team-mate, in roster order."""
        return {mate: self._standing[mate, self.me].profile() for mate in self.mates}

    def learn(self, scenario: Scenario) -> None:
        """Take a scenario in which more is going to happen."""
        self._timeline = scenario.timeline()

    def change_ns(self, index: int) -> int:
        """Return when a link event of the timeline happens."""
        return from_s(self._timeline[index].at_s)

    def happen(self, index: int, radio: Radio) -> None:
        """Let a link event happen."""
        change = self._timeline[index].link_change()
        at_ns = self.change_ns(index)
        for (sender, receiver), link in self._standing.items():
            if concerns(change, sender, receiver):
                link.lay(change.target, change.settings)
                radio.set_link(sender, receiver, link.profile(), at_ns)


class HostRadio:
    """All that makes one robot's radio: air, links, transmitter, receiver."""

    def __init__(
        self,
        plan: Plan,
        life: int,
        *,
        loop: VirtualLoop | ScaledLoop,
        outbox: Outbox,
        motions: Motions,
        choose: Choose,
        on_frame: Callable[[Frame, int], None],
        log: RadioLog,
    ) -> None:
        """Put a radio together for a robot's incarnation `life`."""
        scenario, me = plan.scenario, plan.name
        self._loop = loop
        self._born_ns = plan.start_ns
        self.links = HostLinks(scenario, me, plan.link_events)
        roster = self.links.roster
        index, key, delay_ns = roster.index(me), team_key(scenario), lookahead_ns(scenario)
        luck = dice(scenario, me, "receiver", life).spawn(len(roster))
        self.air = HostAir(outbox, roster, me)
        self._transmitter = Transmitter(
            self.links.from_me(),
            dice(scenario, me, "transmitter", life),
            plan.first_number,
            Seat(index, len(roster), delay_ns),
        )
        receiver = Receiver(
            self.links.to_me(),
            {mate: luck[roster.index(mate)] for mate in self.links.mates},
            Propagation(me, motions, plan.terrain, delay_ns),
        )
        self.radio = Radio(
            me,
            self.air,
            sealer=Sealer(key, index, life),
            opener=Opener(key, len(roster), index),
            transmitter=self._transmitter,
            receiver=receiver,
            choose=choose,
            on_frame=on_frame,
            log=log,
            late_tolerance_ns=0 if isinstance(loop, VirtualLoop) else NS,
        )

    def rate_bps(self) -> float:
        """Return what the robot can send in the long run; infinite while nobody can hear it."""
        return self._transmitter.rate_bps if self._transmitter.can_send() else math.inf

    def deliver(self, packet: Packet) -> None:
        """Take a packet that was sent to the team."""
        self.air.deliver(self._loop, packet, self._born_ns)

    def change_link(self, index: int) -> None:
        """Let a link event of the timeline happen at its instant, in its turn among the frames.

        Those that came before are heard over the old link.
        """
        at_ns = self.links.change_ns(index)
        self._loop.post(at_ns, -1, index, lambda: self.links.happen(index, self.radio), False)
