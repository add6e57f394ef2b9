import asyncio
import random
from dataclasses import dataclass, field, replace
from itertools import pairwise

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_air import MemoryAir, post_on

from comms.air import Packet, PacketError
from comms.channel import Seat, Shared
from comms.ears import OpenSpace
from comms.faults import Faults
from comms.frames import Kind, Opener, Sealer
from comms.link import Receiver, Transmitter
from comms.profiles import PROFILES
from comms.radio import BURST_FRAMES, BURST_PAUSE_NS, Outgoing, Radio, RadioError
from comms.timebase import NS, now_ns, sleep_until_ns
from comms.urgent import URGENT_BYTES, URGENT_SLOTS, UrgentError, UrgentQueue
from sim.clock import VirtualLoop

KEY = b"a key of a team!"
UHF = PROFILES["uhf-9600"]
DOWN = replace(UHF, up=False)
ROSTER = ("recon", "cliffbot", "anchor")
SENSE_NS = UHF.latency_ns
quick = settings(max_examples=40, deadline=None)


class JumpingLoop(asyncio.SelectorEventLoop):
    """A loop whose clock stands still while there is work and jumps to the next timer."""

    def __init__(self):
        super().__init__()
        self._t_s = 0.0
        self._clock_resolution = 1e-10
        real = self._selector.select
        self._selector.select = lambda timeout=None: self._jump(timeout) or real(0)

    def time(self):
        return self._t_s

    def _jump(self, timeout):
        if timeout is None:
            raise RuntimeError("nothing will ever happen again")
        if timeout > 0:
            self._t_s = max(self._t_s, self._scheduled[0]._when)


def run(coroutine):
    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        return runner.run(coroutine)


@dataclass
class Log:
    tx: list = field(default_factory=list)
    cut: list = field(default_factory=list)
    rx: list = field(default_factory=list)

    def on_tx(self, **row):
        self.tx.append(row)

    def on_cut(self, number):
        self.cut.append(number)

    def on_rx(self, sender, number, arrive_ns, verdict):
        assert arrive_ns <= now_ns()
        self.rx.append((sender, number, arrive_ns, verdict))


class Robot:
    """A robot that says what is in `script`, and remembers what it hears."""

    def __init__(
        self, hub, name, profile=UHF, *, key=KEY, roster=ROSTER, post=None, world=None, **options
    ):
        me, mates = roster.index(name), [n for n in roster if n != name]
        links = dict.fromkeys(mates, profile)
        seat = Seat(me, len(roster), SENSE_NS)
        self.script, self.heard, self.log, self.asked = [], [], Log(), []
        self.put_ns = []
        air = hub.endpoint(name, post or post_on(asyncio.get_running_loop()))
        put = air.put
        air.put = lambda packet: (self.put_ns.append(now_ns()), put(packet))
        self.radio = Radio(
            name,
            air,
            sealer=Sealer(key, me, 0),
            opener=Opener(key, len(roster), me),
            transmitter=Transmitter(links, np.random.default_rng(me), 0, seat),
            receiver=Receiver(links, {n: np.random.default_rng(7) for n in mates}, world),
            choose=self.choose,
            on_frame=lambda frame, arrive_ns: self.heard.append((frame, arrive_ns)),
            log=self.log,
            **options,
        )
        self.task = asyncio.create_task(self.radio.run())

    def choose(self, t_ns, payload_bytes):
        self.asked.append((t_ns, payload_bytes))
        return self.script.pop(0) if self.script else None

    def say(self, *payloads, kind=Kind.MAP):
        self.script += [Outgoing(kind, payload) for payload in payloads]
        self.radio.kick()

    def payloads(self):
        return [frame.payload for frame, _ in self.heard]


def team(profile=UHF, **options):
    hub = MemoryAir(ROSTER)
    return [Robot(hub, name, profile, **options) for name in ROSTER]


def test_a_frame_comes_to_all_at_its_end_plus_latency():
    async def story():
        recon, cliffbot, anchor = team()
        recon.say(bytes(90))
        await asyncio.sleep(1)
        return recon, cliffbot, anchor

    recon, cliffbot, anchor = run(story())
    # 10 bytes of envelope, 20 of overhead: 120 bytes are 0.1 s at 9600 bps, and 30 ms latency.
    assert recon.log.tx == [
        {
            "number": 0,
            "kind": Kind.MAP,
            "charged_bytes": 120,
            "chosen_ns": 0,
            "start_ns": 0,
            "end_ns": 100_000_000,
        }
    ]
    assert cliffbot.log.rx == anchor.log.rx == [("recon", 0, 130_000_000, "delivered")]
    assert cliffbot.payloads() == [bytes(90)]
    traffic, heard = recon.radio.traffic, cliffbot.radio.traffic
    assert (traffic.sent_frames, traffic.sent_bytes, traffic.airtime_ns) == (1, 120, NS // 10)
    assert (heard.received_frames, heard.received_bytes) == (1, 100)


@quick
@given(
    st.sampled_from(["sojourner", "uhf-9600", "mer-high", "orbiter", "unlimited"]),
    st.lists(st.integers(0, 200), min_size=1, max_size=12),
)
def test_no_frame_is_early_and_none_overlap(name, lengths):
    async def story():
        recon, cliffbot, _ = team(PROFILES[name])
        recon.say(*map(bytes, lengths))
        await asyncio.sleep(60)
        return recon, cliffbot

    recon, cliffbot = run(story())
    profile, free_ns = PROFILES[name], 0
    assert [len(p) for p in cliffbot.payloads()] == lengths
    for row, (_, arrive_ns) in zip(recon.log.tx, cliffbot.heard, strict=True):
        assert row["start_ns"] >= free_ns
        assert row["chosen_ns"] == row["start_ns"]
        taken_s = 8 * row["charged_bytes"] / profile.rate_bps
        assert arrive_ns >= row["start_ns"] + taken_s * NS + profile.latency_ns
        assert arrive_ns == row["end_ns"] + profile.latency_ns
        free_ns = row["end_ns"]


def test_the_link_asks_when_it_falls_free_and_not_before():
    async def story():
        recon, cliffbot, _ = team()
        newest = [b"old"]
        recon.radio._choose = lambda t_ns, room: Outgoing(Kind.MAP, newest[0]) if newest else None
        recon.radio.kick()
        await asyncio.sleep(0.01)
        newest[0] = b"newer"  # while the first frame is on air
        await asyncio.sleep(0.01)
        newest[0] = b"newest"
        await asyncio.sleep(0.02)
        newest.clear()
        await asyncio.sleep(1)
        return cliffbot.payloads()

    assert run(story()) == [b"old", b"newest"]


def test_urgent_goes_next_and_only_the_newest_of_its_kind_and_key():
    async def story():
        recon, cliffbot, _ = team()
        recon.say(b"map 1" * 20, b"map 2" * 20)
        await asyncio.sleep(0.01)
        recon.radio.send_urgent(Kind.TETHER, b"old", "left")
        recon.radio.send_urgent(Kind.TETHER, b"right", "right")
        recon.radio.send_urgent(Kind.TETHER, b"new", "left")
        recon.radio.send_urgent(Kind.STOP, b"stale", "all", until_ns=now_ns() + 1000)
        await asyncio.sleep(2)
        return [(f.kind, f.payload[:5]) for f, _ in cliffbot.heard]

    assert run(story()) == [
        (Kind.MAP, b"map 1"),
        (Kind.TETHER, b"new"),
        (Kind.TETHER, b"right"),
        (Kind.MAP, b"map 2"),
    ]


def test_an_urgent_frame_wakes_an_idle_radio():
    async def story():
        recon, cliffbot, _ = team()
        await asyncio.sleep(5)
        recon.radio.send_urgent(Kind.STOP, b"", "all")
        await asyncio.sleep(1)
        return cliffbot.heard[0]

    frame, arrive_ns = run(story())
    assert frame.kind is Kind.STOP
    assert arrive_ns == 5 * NS + 25_000_000 + 30_000_000  # 30 bytes at 9600 bps


def test_only_urgent_packets_wake():
    woken = []

    def post(arrive_ns, source_index, number, callback, wake):
        woken.append(wake)

    async def story():
        hub = MemoryAir(ROSTER)
        recon = Robot(hub, "recon")
        hub.endpoint("anchor", post)
        recon.say(b"map")
        recon.radio.send_urgent(Kind.TETHER, b"", "left")
        await asyncio.sleep(1)

    run(story())
    assert woken == [True, False]


def test_a_hung_robot_cuts_its_frame():
    async def story(late_tolerance_ns):
        recon, cliffbot, _ = team(late_tolerance_ns=late_tolerance_ns)
        recon.say(bytes(90), b"after")
        await asyncio.sleep(0.05)
        asyncio.get_running_loop()._t_s += 0.2  # hangs over the frame's end at 0.1 s
        await asyncio.sleep(1)
        return recon.log, cliffbot.payloads()

    log, heard = run(story(0))
    assert (log.cut, heard) == ([0], [b"after"])
    assert [row["start_ns"] for row in log.tx] == [0, 250_000_000]
    log, heard = run(story(150_000_000))
    assert (log.cut, heard) == ([], [bytes(90), b"after"])


def test_a_robot_that_dies_in_mid_frame_never_sent_it():
    async def story():
        recon, cliffbot, _ = team()
        recon.say(bytes(90))
        await asyncio.sleep(0.09)
        recon.task.cancel()
        await asyncio.sleep(1)
        return recon.log.tx, cliffbot.log.rx

    sent, heard = run(story())
    assert len(sent) == 1
    assert heard == []


def test_a_radio_without_links_asks_nothing_until_one_comes_up():
    async def story():
        recon, cliffbot, _ = team(DOWN)
        recon.say(b"map")
        await asyncio.sleep(100)
        assert (recon.asked, recon.log.tx, cliffbot.log.rx) == ([], [], [])
        for robot in (recon, cliffbot):
            robot.radio.set_link("recon", "cliffbot", UHF)
        await asyncio.sleep(1)
        return recon, cliffbot

    recon, cliffbot = run(story())
    assert recon.asked[0] == (100 * NS, UHF.frame_bytes - 12)
    assert cliffbot.payloads() == [b"map"]


def test_a_link_that_fails_under_way_drops_the_frame_and_says_so():
    async def story():
        recon, cliffbot, anchor = team()
        recon.say(bytes(90))
        await asyncio.sleep(0.11)
        for robot in (recon, cliffbot):
            robot.radio.set_link("recon", "cliffbot", DOWN)
        await asyncio.sleep(1)
        return cliffbot, anchor

    cliffbot, anchor = run(story())
    assert cliffbot.log.rx == [("recon", 0, 130_000_000, "link down")]
    assert cliffbot.radio.dropped == {"link down": 1}
    assert anchor.payloads() == [bytes(90)]


class FarFrom(OpenSpace):
    def __init__(self, far_m):
        self.far_m, self.asked_ns = far_m, []

    def distance_m(self, sender, t_ns):
        self.asked_ns.append(t_ns)
        return self.far_m.get(sender)


def test_distance_comes_from_the_propagation_port():
    async def story():
        world = FarFrom({"recon": 100.0, "anchor": 10.0})
        recon, cliffbot, anchor = team(replace(UHF, range_m=50.0), world=world)
        recon.say(b"far")
        anchor.say(b"near")
        await asyncio.sleep(1)
        return cliffbot

    cliffbot = run(story())
    assert cliffbot.radio.dropped == {"out of range": 1}
    assert cliffbot.payloads() == [b"near"]


def test_flipped_bits_are_found_by_the_code_and_the_frame_is_dropped():
    async def story():
        harsh = replace(UHF, faults=Faults(bit_errors=0.002))
        recon, cliffbot, _ = team(harsh)
        recon.say(*(bytes([n]) * 60 for n in range(200)))
        await asyncio.sleep(60)
        return cliffbot

    cliffbot = run(story())
    assert {f.payload for f, _ in cliffbot.heard} <= {bytes([n]) * 60 for n in range(200)}
    # The version stands outside the code's reach: four bits of every frame.
    assert cliffbot.radio.dropped.keys() <= {"damaged", "bad-version"}
    assert cliffbot.radio.dropped["damaged"] > 80
    assert len(cliffbot.heard) + sum(cliffbot.radio.dropped.values()) == 200


def test_a_copy_is_dropped_as_replayed_and_an_overtaken_frame_still_taken():
    async def story():
        faults = Faults(duplication=0.3, reordering=0.3, reordering_ns=NS)
        recon, cliffbot, _ = team(replace(UHF, faults=faults))
        recon.say(*(bytes([n]) for n in range(100)))
        await asyncio.sleep(60)
        return cliffbot

    cliffbot = run(story())
    assert sorted(cliffbot.payloads()) == [bytes([n]) for n in range(100)]
    assert cliffbot.payloads() != sorted(cliffbot.payloads())
    assert 10 < cliffbot.radio.dropped["replayed"] < 60
    copies = len(cliffbot.log.rx) - 100
    assert cliffbot.radio.dropped == {"replayed": copies}


def test_two_who_speak_at_once_on_half_duplex_do_not_hear_each_other():
    async def story():
        recon, cliffbot, anchor = team(replace(UHF, faults=Faults(half_duplex=True)))
        recon.say(bytes(90))
        cliffbot.say(bytes(60))
        await asyncio.sleep(1)
        cliffbot.say(b"later")
        await asyncio.sleep(1)
        return recon, cliffbot, anchor

    recon, cliffbot, anchor = run(story())
    assert recon.radio.dropped == cliffbot.radio.dropped == {"receiver sending": 1}
    assert recon.payloads() == [b"later"]
    assert anchor.payloads() == [bytes(60), bytes(90), b"later"]


def chatter(shared, seconds, world=None):
    """Have three robots speak all the time; return them."""

    async def story():
        robots = team(replace(UHF, shared=shared), world=world)
        for robot in robots:
            robot.radio._choose = lambda t_ns, room: Outgoing(Kind.MAP, bytes(min(room, 100)))
            robot.radio.kick()
        await asyncio.sleep(seconds)
        for robot in robots:
            robot.task.cancel()
        await asyncio.sleep(1)
        return robots

    return run(story())


def spans_of(robots):
    return sorted(
        (row["start_ns"], row["end_ns"], robot.radio.name, row["number"])
        for robot in robots
        for row in robot.log.tx
    )


def test_robots_that_listen_first_share_a_channel_and_what_meets_on_air_is_lost():
    robots = chatter(Shared("csma", backoff_ns=NS), 300)
    spans = spans_of(robots)
    met = {
        (name, number)
        for start_ns, end_ns, name, number in spans
        for other_ns, other_end_ns, other, _ in spans
        if other != name and start_ns < other_end_ns and other_ns < end_ns
    }
    assert met, "two may begin within one sensing delay"
    assert len(met) < 0.2 * len(spans)
    words = {"delivered": 0, "clash": 0, "receiver sending": 0}
    for robot in robots:
        for sender, number, _, word in robot.log.rx:
            words[word] += 1
            assert (word != "delivered") == ((sender, number) in met)
    assert words["delivered"] > 300
    assert words["clash"] > 0
    for robot in robots:
        mine = [row for row in robot.log.tx if row["end_ns"] <= 300 * NS]
        assert 0.2 < len(mine) / len(spans) < 0.5, "nobody keeps the channel for itself"
    for (start_ns, *_), (other_ns, *_) in pairwise(spans):
        later = [s for s, *_ in spans if start_ns + SENSE_NS <= s < start_ns + 10**8]
        assert other_ns <= start_ns + 1.3 * NS, "a free channel is taken"
        assert not later, "who could sense a carrier began all the same"


@pytest.mark.parametrize("apart_m", [10.0, 100.0])
def test_who_is_out_of_reach_is_not_sensed(apart_m):
    """Two who don't sense each other speak at once; who hears both understands neither."""

    async def story():
        hub, profile = MemoryAir(ROSTER), replace(UHF, shared=Shared("csma"), range_m=50.0)
        worlds = [FarFrom({"cliffbot": apart_m}), FarFrom({"recon": apart_m}), FarFrom({})]
        recon, cliffbot, anchor = (
            Robot(hub, name, profile, world=world)
            for name, world in zip(ROSTER, worlds, strict=True)
        )
        recon.radio.send_urgent(Kind.STOP, b"", "a")
        await asyncio.sleep(1)
        for _ in range(20):
            recon.say(bytes(240))
            cliffbot.say(bytes(240))
        await asyncio.sleep(60)
        return anchor

    anchor = run(story())
    clashes = anchor.radio.dropped.get("clash", 0)
    assert clashes > 20 if apart_m > 50 else clashes < 16
    assert clashes + len(anchor.heard) == 41


def test_robots_that_take_turns_never_speak_at_once():
    shared = Shared("tdma", slot_ns=NS)
    robots = chatter(shared, 60)
    spans = spans_of(robots)
    for (_, end_ns, *_), (start_ns, *_) in pairwise(spans):
        assert start_ns >= end_ns
    for start_ns, end_ns, name, _ in spans:
        slot = start_ns // NS
        assert slot % 3 == ROSTER.index(name)
        assert end_ns <= (slot + 1) * NS
    for robot in robots:
        on_air = sum(row["end_ns"] - row["start_ns"] for row in robot.log.tx)
        assert on_air > 0.9 * 20 * NS
        assert {word for *_, word in robot.log.rx} == {"delivered"}


def test_an_idle_robot_waits_for_its_turn_only_when_there_is_something_to_say():
    async def story():
        recon, cliffbot, _ = team(replace(UHF, shared=Shared("tdma", slot_ns=NS)))
        await asyncio.sleep(11.5)
        assert [t_ns for t_ns, _ in cliffbot.asked] == [NS], "its first turn, and no other"
        cliffbot.radio.send_urgent(Kind.STOP, b"", "all")
        await asyncio.sleep(5)
        return recon, cliffbot

    recon, cliffbot = run(story())
    assert [f.kind for f, _ in recon.heard] == [Kind.STOP]
    assert cliffbot.log.tx[0]["start_ns"] == 13 * NS


def test_what_does_not_fit_the_rest_of_a_turn_is_sent_in_the_next():
    async def story():
        recon, cliffbot, _ = team(replace(UHF, shared=Shared("tdma", slot_ns=NS)))
        big = [Outgoing(Kind.MAP, bytes(240))]
        await asyncio.sleep(0.85)
        recon.radio._choose = lambda t_ns, room: big.pop() if room >= 240 and big else None
        recon.radio.kick()
        await asyncio.sleep(9)
        return recon, cliffbot

    recon, cliffbot = run(story())
    assert [row["start_ns"] for row in recon.log.tx] == [3 * NS]
    assert len(cliffbot.heard) == 1


def test_what_is_no_frame_is_counted_by_reason_and_changes_nothing():
    async def story():
        hub = MemoryAir(ROSTER)
        cliffbot = Robot(hub, "cliffbot")
        good = Sealer(KEY, 0, 0).seal(Kind.MAP, b"good")
        junk = [
            good,
            good,
            good[:-1] + bytes((good[-1] ^ 1,)),
            b"",
            b"\x11" * 30,
            bytes(5000),
            Sealer(b"the key of others", 0, 0).seal(Kind.MAP, b"forged"),
            Sealer(KEY, 9, 0).seal(Kind.MAP, b"who?"),
        ]
        for number, data in enumerate(junk):
            arrivals = (("cliffbot", NS + number),)
            hub.carry(Packet("recon", number, 0, 0, arrivals, False, data))
        await asyncio.sleep(2)
        return cliffbot

    cliffbot = run(story())
    assert cliffbot.radio.dropped == {
        "replayed": 1,
        "damaged": 3,
        "bad-version": 1,
        "oversized": 1,
        "stranger": 1,
    }
    assert cliffbot.payloads() == [b"good"]
    assert [verdict for *_, verdict in cliffbot.log.rx][:2] == ["delivered", "replayed"]


def test_a_sender_outside_the_roster_is_a_stranger():
    async def story():
        hub = MemoryAir((*ROSTER, "ghost"))
        cliffbot = Robot(hub, "cliffbot")
        data = Sealer(KEY, 0, 0).seal(Kind.MAP, b"")
        hub.carry(Packet("ghost", 0, 0, 0, (("cliffbot", NS),), False, data))
        await asyncio.sleep(2)
        return cliffbot.radio.dropped, cliffbot.heard

    assert run(story()) == ({"stranger": 1}, [])


def test_a_payload_that_does_not_fit_is_the_choosers_fault():
    async def story():
        recon, *_ = team()
        recon.say(bytes(245))
        with pytest.raises(RadioError, match="MAP payload has 245 bytes; the link takes 244"):
            await recon.task

    run(story())


def test_an_unlimited_link_does_not_stop_the_clock():
    async def story():
        recon, *_ = team(PROFILES["unlimited"])
        recon.radio._choose = lambda t_ns, room: Outgoing(Kind.MAP, b"")
        recon.radio.kick()
        await asyncio.sleep(0.0015)
        recon.task.cancel()
        return [row["start_ns"] for row in recon.log.tx]

    starts_ns = run(story())
    assert starts_ns == [0] * BURST_FRAMES + [BURST_PAUSE_NS] * BURST_FRAMES


def test_urgent_queue_is_bounded_and_refuses_what_is_not_urgent():
    queue = UrgentQueue()
    for n in range(URGENT_SLOTS):
        queue.put(Kind.TETHER, bytes((n,)), f"anchor-{n}")
    with pytest.raises(UrgentError, match="32 urgent payloads wait"):
        queue.put(Kind.STOP, b"", "all")
    queue.put(Kind.TETHER, b"new", "anchor-1")
    assert [queue.take(0) for _ in range(3)] == [
        (Kind.TETHER, b"\x00"),
        (Kind.TETHER, b"new"),
        (Kind.TETHER, b"\x02"),
    ]
    with pytest.raises(UrgentError, match="MAP is not urgent; TETHER, STOP are"):
        queue.put(Kind.MAP, b"", "")
    with pytest.raises(UrgentError, match="52 bytes; 51 fit every link"):
        queue.put(Kind.STOP, bytes(URGENT_BYTES + 1), "all")


# The memory air


@quick
@given(st.lists(st.tuples(st.integers(1, 3), st.sampled_from("abc")), max_size=30), st.randoms())
def test_memory_air_hands_over_by_arrival_then_roster_then_number(plan, shuffler: random.Random):
    async def story():
        hub, heard = MemoryAir(("a", "b", "c", "me")), []
        ear = hub.endpoint("me", post_on(asyncio.get_running_loop()))
        ear.listen(lambda p, arrive_ns: heard.append((arrive_ns, p.sender, p.number, now_ns())))
        packets = [
            Packet(sender, n, 0, 0, (("me", at * NS),), False, b"")
            for n, (at, sender) in enumerate(plan)
        ]
        shuffler.shuffle(packets)
        for packet in packets:
            hub.carry(packet)
        await asyncio.sleep(5)
        return heard

    heard = run(story())
    assert len(heard) == len(plan)
    assert heard == sorted(heard)
    assert all(arrive_ns == at_ns for arrive_ns, _, _, at_ns in heard)


def test_a_robot_that_left_the_air_hears_nothing_and_its_next_life_only_what_is_sent_to_it():
    async def story():
        hub, lives = MemoryAir(("a", "me")), ([], [])
        for number, life in enumerate(lives):
            ear = hub.endpoint("me", post_on(asyncio.get_running_loop()))
            ear.listen(lambda p, _, life=life: life.append(p.number))
            hub.carry(Packet("a", number, 0, 0, (("me", now_ns() + NS),), False, b""))
        await asyncio.sleep(2)
        hub.remove("me")
        hub.carry(Packet("a", 99, 0, 0, (("me", now_ns() + NS),), False, b""))
        await asyncio.sleep(2)
        return lives

    assert run(story()) == ([], [1])


# Packets between processes

packets = st.builds(
    Packet,
    st.text(max_size=12),
    st.integers(0, 2**40),
    st.integers(0, 2**62),
    st.integers(0, 2**62),
    st.lists(st.tuples(st.text(max_size=12), st.integers(0, 2**62)), max_size=5).map(tuple),
    st.booleans(),
    st.binary(max_size=300),
)


@quick
@given(packets)
def test_packets_cross_the_wire_unchanged(packet):
    assert Packet.from_wire(packet.to_wire()) == packet


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=60) | st.lists(st.integers() | st.none()).map(str).map(str.encode))
def test_noise_is_no_packet(wire):
    with pytest.raises(PacketError):
        Packet.from_wire(wire)


@pytest.mark.parametrize(
    "fields",
    [
        (),
        ("a", 1, 2, 3, (), False),
        ("a", 1, 2, 3, (("b",),), False, b""),
        ("a", 1, 2, 3, ("b",), False, b""),
        ("a", True, 2, 3, (), False, b""),
        {"sender": "a"},
        [{(1, 2): 3}],
    ],
)
def test_the_wrong_shape_is_no_packet(fields):
    with pytest.raises(PacketError):
        Packet.from_wire(msgpack.packb(fields))


# Time


def test_sleeping_ends_at_the_instant_itself():
    async def story():
        seen = []
        for t_ns in (0, 1, 333_333_334, 333_333_335, 7 * NS, 3_600_000_000_001):
            await sleep_until_ns(t_ns)
            seen.append(now_ns() - t_ns)
        return seen

    assert run(story()) == [0] * 6


@pytest.mark.parametrize("rate_bps", [2400, 3000, 9600, 12_000, 128_000])
def test_ten_thousand_frames_on_the_virtual_clock_leave_exactly_on_time(rate_bps):
    frames, loop = 10_000, VirtualLoop(0)
    profile = replace(UHF, rate_bps=float(rate_bps))
    sizes = np.random.default_rng(6).integers(1, 240, frames).tolist()
    put_ns, log, hub = [], Log(), MemoryAir(ROSTER)
    air = hub.endpoint("recon", loop.post)
    air.put = lambda packet: put_ns.append(loop.now_ns)
    radio = Radio(
        "recon",
        air,
        sealer=Sealer(KEY, 0, 0),
        opener=Opener(KEY, 3, 0),
        transmitter=Transmitter({"cliffbot": profile}, np.random.default_rng(1)),
        receiver=Receiver({}, {}),
        choose=lambda t_ns, room: Outgoing(Kind.MAP, bytes(sizes.pop())) if sizes else None,
        on_frame=lambda frame, arrive_ns: None,
        log=log,
    )
    loop.create_task(radio.run())
    loop.run_window(10**16)
    assert put_ns == [row["end_ns"] for row in log.tx]
    bits = 0
    for before, row in zip([{"end_ns": 0}, *log.tx], log.tx, strict=False):
        bits += 8 * row["charged_bytes"]
        assert row["start_ns"] == row["chosen_ns"] == before["end_ns"]
        assert row["end_ns"] == row["start_ns"] - (-8 * NS * row["charged_bytes"] // rate_bps)
    assert len(put_ns) == frames
    assert 0 <= put_ns[-1] * rate_bps - bits * NS < frames * rate_bps, (
        "a nanosecond a frame at most"
    )
    for task in asyncio.all_tasks(loop):
        task.cancel()
    loop.run_window(10**16)
    loop.close()


async def test_on_the_ordinary_loop_thousands_of_frames_do_not_drift():
    """Every timer is late by a little: what is begun at the end of a frame makes up for it."""
    frames, start_ns = 2000, now_ns()
    fast = replace(PROFILES["orbiter"], rate_bps=1_000_000.0, latency_ns=10**6)
    recon, cliffbot, _ = team(fast, late_tolerance_ns=NS)
    recon.say(*[bytes(200)] * frames)
    async with asyncio.timeout(30):
        while len(cliffbot.heard) < frames:
            await asyncio.sleep(0.05)
    for robot in (recon, cliffbot):
        robot.task.cancel()
    rows = recon.log.tx
    assert [a["end_ns"] for a in rows[:-1]] == [b["start_ns"] for b in rows[1:]]
    bits = sum(8 * row["charged_bytes"] for row in rows)
    assert rows[-1]["end_ns"] - rows[0]["start_ns"] - bits * 1000 < frames  # ns, by rounding up
    late_ns = np.array(recon.put_ns) - np.array([row["end_ns"] for row in rows])
    assert rows[0]["start_ns"] >= start_ns
    assert np.all(late_ns >= 0)
    # A busy machine makes many late; lateness that added up would leave none of the last on time.
    assert late_ns[-1000:].min() < 2_000_000, "lateness adds up"


async def test_on_the_ordinary_loop_frames_keep_their_times():
    start_ns = now_ns()
    recon, cliffbot, _ = team(PROFILES["orbiter"], late_tolerance_ns=NS)
    recon.say(bytes(300), bytes(300))
    async with asyncio.timeout(5):
        while len(cliffbot.heard) < 2:
            await asyncio.sleep(0.005)
    for robot in (recon, cliffbot):
        robot.task.cancel()
    for row, (_, arrive_ns) in zip(recon.log.tx, cliffbot.heard, strict=True):
        assert row["start_ns"] >= start_ns
        assert row["end_ns"] - row["start_ns"] == 8 * NS * 322 // 128_000
        assert arrive_ns == row["end_ns"] + 50_000_000
