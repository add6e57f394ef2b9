import math
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comms.channel import Medium, Seat, Shared, airtime_ns
from comms.ears import DOUBLED_FATES, OpenSpace, Passing
from comms.faults import Faults, Verdict
from comms.link import Receiver, Transmitter
from comms.profiles import PROFILES, LinkProfile
from comms.timebase import NS

quick = settings(max_examples=60, deadline=None)
UHF = PROFILES["uhf-9600"]
rates_bps = st.sampled_from([2400.0, 9600.0, 1333.3, 128000.0, math.inf]) | st.floats(1, 1e9)
profiles = st.builds(
    LinkProfile,
    name=st.just("any"),
    rate_bps=rates_bps,
    latency_ns=st.integers(1_000_000, 10**9),
    frame_bytes=st.integers(256, 1024),
    overhead_bytes=st.integers(0, 64),
    jitter_ns=st.integers(0, 10**8),
)


def rng(seed=1):
    return np.random.default_rng(seed)


@pytest.mark.parametrize(
    ("name", "frame_bytes", "seconds"),
    [
        ("sojourner", 94, "1/3"),  # (94 + 6) * 8 / 2400
        ("uhf-9600", 100, "1/10"),  # (100 + 20) * 8 / 9600
        ("mer-low", 138, "2/5"),  # (138 + 12) * 8 / 3000
        ("mer-high", 138, "1/10"),  # (138 + 12) * 8 / 12000
        ("orbiter", 988, "1/16"),  # (988 + 12) * 8 / 128000
        ("unlimited", 1000, "0"),
    ],
)
def test_a_frame_takes_eight_bits_a_byte_over_the_rate(name, frame_bytes, seconds):
    sent = Transmitter({"b": PROFILES[name]}, rng()).begin(7, frame_bytes)
    assert sent.end_ns - 7 == math.ceil(Fraction(seconds) * 10**9)
    assert sent.charged_bytes == frame_bytes + PROFILES[name].overhead_bytes
    assert sent.arrivals == (("b", sent.end_ns + PROFILES[name].latency_ns),)


@quick
@given(st.integers(1, 5000), st.floats(1, 1e9))
def test_airtime_is_exact_to_the_nanosecond(charged_bytes, rate_bps):
    taken_ns = airtime_ns(charged_bytes, rate_bps)
    bits_ns = 8 * 10**9 * charged_bytes
    assert (taken_ns - 1) * Fraction(rate_bps) < bits_ns <= taken_ns * Fraction(rate_bps)


@quick
@given(
    st.dictionaries(st.sampled_from("bcd"), profiles, min_size=1),
    st.lists(st.tuples(st.integers(0, 10**9), st.integers(20, 256)), min_size=1, max_size=30),
)
def test_transmissions_never_overlap_and_arrivals_keep_their_order(links, asked):
    transmitter, now_ns, sent = Transmitter(links, rng()), 0, []
    for wait_ns, frame_bytes in asked:
        now_ns += wait_ns
        sent.append(transmitter.begin(now_ns, frame_bytes))
        assert sent[-1].start_ns >= now_ns
    slowest = Fraction(min(p.rate_bps for p in links.values())) if finite(links) else None
    for frame in sent:
        if slowest is not None:
            assert (frame.end_ns - frame.start_ns) * slowest >= 8 * 10**9 * frame.charged_bytes
        for name, arrive_ns in frame.arrivals:
            assert arrive_ns >= frame.end_ns + links[name].latency_ns
    for before, after in pairwise(sent):
        assert after.start_ns >= before.end_ns
        assert after.number == before.number + 1
        for (name, first_ns), (same, second_ns) in zip(
            before.arrivals, after.arrivals, strict=True
        ):
            assert name == same
            assert second_ns >= first_ns


def finite(links):
    return any(not math.isinf(p.rate_bps) for p in links.values())


def test_no_credit_is_saved_while_the_link_is_idle():
    transmitter = Transmitter({"b": UHF}, rng())
    hour_ns = 3600 * 10**9
    ends_ns = [transmitter.begin(hour_ns, 100).end_ns for _ in range(3)]
    assert ends_ns == [hour_ns + 100_000_000 * n for n in (1, 2, 3)]


def test_all_must_be_able_to_follow_a_broadcast():
    slow = LinkProfile("slow", 1000.0, 10**8, 128, 5)
    wide = LinkProfile("wide", 8000.0, 10**7, 512, 25)
    transmitter = Transmitter({"b": slow, "c": wide}, rng())
    assert transmitter.frame_bytes == 128
    sent = transmitter.begin(0, 100)
    assert (sent.charged_bytes, sent.end_ns) == (125, 10**9)
    assert sent.arrivals == (("b", 10**9 + 10**8), ("c", 10**9 + 10**7))


def test_a_link_that_is_down_holds_nobody_up_but_is_told():
    slow = LinkProfile("slow", 1000.0, 10**8, 128, 5, up=False)
    wide = LinkProfile("wide", 8000.0, 10**7, 512, 25)
    transmitter = Transmitter({"b": slow, "c": wide}, rng())
    assert transmitter.frame_bytes == 512
    sent = transmitter.begin(0, 475)
    assert sent.end_ns == 500_000_000
    assert [name for name, _ in sent.arrivals] == ["b", "c"]


def test_nobody_to_hear_means_nothing_to_send():
    transmitter = Transmitter({"b": replace(UHF, up=False), "c": replace(UHF, rate_bps=0.0)}, rng())
    assert not transmitter.can_send()
    assert transmitter.frame_bytes == 0
    transmitter.set_profile("c", UHF)
    assert transmitter.can_send()
    assert not Transmitter({}, rng()).can_send()


def test_a_change_of_profile_counts_from_the_next_frame():
    transmitter = Transmitter({"b": UHF}, rng())
    first = transmitter.begin(0, 100)
    transmitter.set_profile("b", PROFILES["sojourner"])
    second = transmitter.begin(first.start_ns, 94)
    assert first.end_ns == 100_000_000
    assert second.end_ns == first.end_ns + 333_333_334


def test_jitter_spreads_over_its_span_and_no_farther():
    span_ns = 40_000_000
    transmitter = Transmitter({"b": replace(UHF, jitter_ns=span_ns)}, rng())
    late_ns = []
    for n in range(2000):
        sent = transmitter.begin(n * 10**9, 100)
        late_ns.append(sent.arrivals[0][1] - sent.end_ns - UHF.latency_ns)
    assert 0 <= min(late_ns) < 0.01 * span_ns
    assert 0.99 * span_ns < max(late_ns) <= span_ns
    assert np.mean(late_ns) == pytest.approx(span_ns / 2, rel=0.05)


def test_one_links_settings_do_not_shift_anothers_luck():
    jittery = replace(UHF, jitter_ns=10**7)
    plain = Transmitter({"b": UHF, "c": jittery}, rng(3))
    other = Transmitter({"b": replace(jittery, up=False), "c": jittery}, rng(3))
    for n in range(20):
        assert plain.begin(n * 10**9, 50).arrivals[1] == other.begin(n * 10**9, 50).arrivals[1]


def ears(profile, seed=5, **others):
    return Receiver({"a": profile}, {"a": rng(seed)}, **others)


def frame(number=0, start_ns=0, end_ns=None, sender="a", at_ns=None, size=100):
    end_ns = start_ns + 10**8 if end_ns is None else end_ns
    return Passing(sender, number, start_ns, end_ns, at_ns or (end_ns + UHF.latency_ns,), size)


def verdict(receiver, *args, **kwargs):
    return receiver.fate(frame(*args, **kwargs)).verdict


def faulty(**faults):
    return replace(UHF, faults=Faults(**faults))


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.5, 1.0])
def test_loss_is_as_frequent_as_stated(loss):
    count = 4000
    receiver = ears(replace(UHF, loss=loss))
    heard = [verdict(receiver, n, n * 10**8) for n in range(count)]
    lost = heard.count(Verdict.LOST)
    assert set(heard) <= {Verdict.LOST, Verdict.DELIVERED}
    assert abs(lost - loss * count) <= 4 * math.sqrt(count * loss * (1 - loss))


def test_a_fate_says_when_a_frame_is_handed_over_or_why_never():
    heard, lost = (ears(replace(UHF, loss=p)).fate(frame(at_ns=(7, 9))) for p in (0.0, 1.0))
    assert (heard.verdict, heard.at_ns) == (Verdict.DELIVERED, (7, 9))
    assert (lost.verdict, lost.at_ns) == (Verdict.LOST, ())


@quick
@given(st.permutations(range(30)), st.integers(0, 29))
def test_luck_depends_on_the_frame_and_not_on_what_came_before(order, slept):
    lossy = replace(faulty(burst_ns=NS, burst_gap_ns=NS, bit_errors=1e-3), loss=0.3)
    awake, shuffled = ears(lossy), ears(lossy)
    expected = [awake.fate(frame(n, n * 10**8)) for n in range(30)]
    heard = {n: shuffled.fate(frame(n, n * 10**8)) for n in order if n >= slept}
    assert all(heard[n] == expected[n] for n in heard)
    assert {Verdict.LOST, Verdict.DELIVERED} == {fate.verdict for fate in expected}


def test_links_have_luck_of_their_own():
    lossy = replace(UHF, loss=0.5)
    receiver = Receiver({"a": lossy, "b": lossy}, {"a": rng(1), "b": rng(2)})
    fates = {name: [verdict(receiver, n, 0, sender=name) for n in range(64)] for name in "ab"}
    assert fates["a"] != fates["b"]


def test_nothing_is_heard_over_a_link_that_was_down_for_part_of_a_frame():
    receiver = ears(UHF)
    assert verdict(receiver, 0, 100) is Verdict.DELIVERED
    receiver.set_profile("a", replace(UHF, up=False), 200)
    assert verdict(receiver, 1, 150) is Verdict.DOWN
    receiver.set_profile("a", UHF, 300)
    assert verdict(receiver, 2, 299) is Verdict.DOWN
    assert verdict(receiver, 3, 300) is Verdict.DELIVERED
    receiver.set_profile("a", replace(UHF, rate_bps=2400.0), 400)
    assert verdict(receiver, 4, 350) is Verdict.DELIVERED
    assert verdict(ears(replace(UHF, rate_bps=0.0))) is Verdict.DOWN


class World(OpenSpace):
    """Says where team-mates are, and remembers what it was asked."""

    def __init__(self, far_m=None, hidden=()):
        self.far_m, self.hidden, self.asked = far_m or {}, hidden, []

    def distance_m(self, sender, t_ns):
        self.asked.append(t_ns)
        return self.far_m.get(sender)

    def hides(self, sender, t_ns, antenna_m, mate_antenna_m):
        self.asked.append((t_ns, antenna_m, mate_antenna_m))
        return sender in self.hidden


@pytest.mark.parametrize(
    ("range_m", "far_m", "said"),
    [(50.0, 50.0, "delivered"), (50.0, 50.1, "out of range"), (50.0, None, "delivered")],
)
def test_range_is_a_limit_where_the_distance_is_known(range_m, far_m, said):
    receiver = ears(replace(UHF, range_m=range_m), propagation=World({"a": far_m}))
    assert verdict(receiver) == said


def test_who_is_hidden_is_not_heard_where_sight_matters():
    seeing = replace(faulty(line_of_sight=True), antenna_m=3.0, mate_antenna_m=0.5)
    world = World(hidden=("a",))
    assert verdict(ears(seeing, propagation=world), at_ns=(900, 1000)) == "out of sight"
    assert world.asked == [(900, 3.0, 0.5)], "asked as of the first arrival"
    assert verdict(ears(UHF, propagation=world)) is Verdict.DELIVERED
    assert len(world.asked) == 1, "a link without such limits asks nothing of the world"


def test_a_receiver_knows_its_team_mates():
    assert ears(UHF).knows("a")
    assert not ears(UHF).knows("x")


# --- outages, bursts ------------------------------------------------------------------------


def test_an_outage_takes_every_frame_that_it_touches_and_no_other():
    receiver = ears(faulty(outages_ns=((1000, 2000), (2000, 2500), (4000, 5000))))
    spans = {(0, 1000): "delivered", (0, 1001): "outage", (1500, 1600): "outage"}
    spans |= {(1999, 2001): "outage", (2499, 2600): "outage", (2500, 4000): "delivered"}
    spans |= {(2500, 6000): "outage", (5000, 9000): "delivered"}
    for number, (span, said) in enumerate(spans.items()):
        assert verdict(receiver, number, *span) == said, span


def test_a_frame_that_meets_a_bad_spell_has_its_loss():
    """P(all of a frame of length T in a good spell) = good / (good + bad) * exp(-T / good)."""
    good_s, bad_s, frame_s, count = 3.0, 1.0, 0.5, 6000
    receiver = ears(faulty(burst_ns=round(bad_s * NS), burst_gap_ns=round(good_s * NS)))
    starts_ns = [n * 20 * NS for n in range(count)]  # far enough apart to be independent
    spans = [(t, t + round(frame_s * NS)) for t in starts_ns]
    heard = [verdict(receiver, n, a, b) for n, (a, b) in enumerate(spans)]
    good = good_s / (good_s + bad_s) * math.exp(-frame_s / good_s)
    sigma = math.sqrt(count * good * (1 - good))
    assert abs(heard.count(Verdict.DELIVERED) - good * count) < 4 * sigma
    assert heard.count(Verdict.LOST) == count - heard.count(Verdict.DELIVERED)


def test_good_and_bad_spells_have_losses_of_their_own():
    profile = replace(faulty(burst_ns=NS, burst_gap_ns=NS, burst_loss=0.0), loss=1.0)
    sure = replace(faulty(burst_ns=NS, burst_gap_ns=NS, burst_loss=1.0), loss=0.0)
    bad, good = ears(profile), ears(sure)
    for number in range(300):
        one, other = (verdict(r, number, number * 10**8) for r in (bad, good))
        assert {one, other} == {Verdict.DELIVERED, Verdict.LOST}, "the same spells, turned round"


def test_a_change_of_other_settings_leaves_the_spells_as_they_are():
    bursty = faulty(burst_ns=NS, burst_gap_ns=2 * NS)
    changed = replace(bursty, faults=replace(bursty.faults, half_duplex=True), rate_bps=2400.0)
    steady, turned = ears(bursty), ears(bursty)
    turned.set_profile("a", changed, 5 * NS)
    frames = [frame(n, 5 * NS + n * 10**8) for n in range(200)]
    fates = [[r.fate(f).verdict for f in frames] for r in (steady, turned)]
    assert fates[0] == fates[1]
    assert len(set(fates[0])) == 2


# --- half duplex, a shared channel ----------------------------------------------------------


def test_who_sends_hears_nothing_meanwhile_on_half_duplex():
    half, full = ears(faulty(half_duplex=True)), ears(UHF)
    for receiver in (half, full):
        receiver.medium.sends(1000, 2000)
    spans = {(0, 1000): "delivered", (0, 1001): "receiver sending", (1500, 1600): None}
    spans |= {(1999, 3000): "receiver sending", (2000, 3000): "delivered"}
    for number, (span, said) in enumerate(spans.items()):
        assert verdict(half, number, *span) == (said or "receiver sending"), span
        assert verdict(full, number, *span) is Verdict.DELIVERED


CSMA = replace(UHF, shared=Shared("csma", backoff_ns=10**8))
TDMA = replace(UHF, shared=Shared("tdma", slot_ns=10**9))


def test_frames_clash_where_their_times_meet_and_both_are_in_reach():
    profile = replace(CSMA, range_m=50.0)
    names = ("a", "b", "far")
    world = World({"far": 90.0})
    receiver = Receiver(dict.fromkeys(names, profile), dict.fromkeys(names, rng()), world)
    receiver.sense("a", 1000, 2000, 1500)
    assert verdict(receiver, 0, 1000, 2000) is Verdict.DELIVERED, "its own carrier is no clash"
    receiver.sense("far", 1000, 2000, 1500)
    assert verdict(receiver, 1, 1000, 2000) is Verdict.DELIVERED, "too far to disturb"
    receiver.sense("b", 1999, 3000, 2500)
    assert verdict(receiver, 2, 1000, 2000) is Verdict.CLASH
    assert verdict(receiver, 0, 1999, 3000, sender="b") is Verdict.CLASH
    assert verdict(receiver, 3, 3000, 4000) is Verdict.DELIVERED
    receiver.sense("nobody", 0, 10**9, 2500)  # a stranger's carrier changes nothing
    assert verdict(receiver, 4, 3000, 4000) is Verdict.DELIVERED
    receiver.medium.sends(5000, 6000)
    assert verdict(receiver, 5, 5500, 5600) is Verdict.SENDING, "one channel: half duplex"


def test_a_carrier_is_sensed_one_least_latency_after_it_began():
    seat = Seat(0, 3, sense_ns=20_000_000)
    sent = Transmitter({"b": CSMA, "c": CSMA}, rng(), seat=seat).begin(5, 100)
    assert sent.sensed == (("b", 20_000_005), ("c", 20_000_005))
    assert all(t_ns < min(at for _, at in sent.arrivals) for _, t_ns in sent.sensed)
    assert Transmitter({"b": UHF}, rng(), seat=seat).begin(5, 100).sensed == ()
    unlimited = replace(PROFILES["unlimited"], shared=CSMA.shared)
    assert Transmitter({"b": unlimited}, rng(), seat=seat).begin(5, 100).sensed == ()


def test_who_listens_first_waits_for_the_channel_and_a_while_more():
    sense_ns, medium = 20_000_000, Medium()
    one, other = (Transmitter({"b": CSMA}, rng(n), seat=Seat(n, 2, sense_ns)) for n in (0, 1))
    medium.senses("c", 0, 10**9)
    waits_ns = [t.opening_ns(5, medium) - (10**9 + sense_ns) for t in (one, other)]
    assert all(0 <= wait_ns < CSMA.shared.backoff_ns for wait_ns in waits_ns)
    assert waits_ns[0] != waits_ns[1]
    assert one.opening_ns(2 * 10**9, medium) >= 2 * 10**9
    spread_ns = [one.opening_ns(n * 10**9, Medium()) - n * 10**9 for n in range(400)]
    assert np.mean(spread_ns) == pytest.approx(CSMA.shared.backoff_ns / 2, rel=0.1)


@quick
@given(
    st.integers(1, 5),
    st.integers(0, 10**11),
    st.integers(10, 256),
    st.sampled_from(["sojourner", "uhf-9600", "mer-high"]),
)
def test_frames_in_turns_stay_inside_their_turn(team, t_ns, wanted_bytes, name):
    shared = Shared("tdma", slot_ns=10**9)
    profile = replace(PROFILES[name], shared=shared)
    spans = []
    for index in range(team):
        transmitter = Transmitter({"x": profile}, rng(), seat=Seat(index, team))
        begin_ns = transmitter.opening_ns(t_ns, Medium())
        assert t_ns <= begin_ns <= t_ns + team * shared.slot_ns
        size = min(wanted_bytes, transmitter.room_bytes(begin_ns))
        sent = transmitter.begin(begin_ns, size)
        slot = begin_ns // shared.slot_ns
        assert slot % team == index
        assert sent.end_ns <= (slot + 1) * shared.slot_ns
        spans.append((sent.start_ns, sent.end_ns))
    for (_, end_ns), (start_ns, _) in pairwise(sorted(spans)):
        assert end_ns <= start_ns


def test_what_is_left_of_a_turn_sets_the_length_of_a_frame():
    transmitter = Transmitter({"b": TDMA}, rng(), seat=Seat(0, 2))
    assert transmitter.frame_bytes == 256
    assert transmitter.room_bytes(800_000_000) == 220  # 0.2 s are 240 bytes, 20 of them overhead
    assert transmitter.next_turn_ns(800_000_000) == 2 * 10**9
    assert transmitter.room_bytes(0) == 256
    assert transmitter.next_turn_ns(0) is None
    assert transmitter.opening_ns(930_000_000, Medium()) == 930_000_000  # 84 bytes: 0.07 s
    assert transmitter.opening_ns(930_000_001, Medium()) == 2 * 10**9
    assert transmitter.rate_bps == 4800
    short = replace(TDMA, shared=Shared("tdma", slot_ns=10**8))
    assert Transmitter({"b": short}, rng()).frame_bytes == 100


# --- doubled, held back, harmed -------------------------------------------------------------


def arrivals_of(profile, count=400, every_ns=10**9, seed=2):
    transmitter = Transmitter({"b": profile}, rng(seed))
    return [transmitter.begin(n * every_ns, 100) for n in range(count)]


def test_some_frames_come_twice_never_at_the_same_instant():
    frames = arrivals_of(faulty(duplication=0.25))
    twice = [sent for sent in frames if len(sent.arrivals) == 2]
    assert abs(len(twice) - 100) < 4 * math.sqrt(400 * 0.25 * 0.75)
    for sent in frames:
        times_ns = [at_ns for _, at_ns in sent.arrivals]
        assert times_ns[0] == sent.end_ns + UHF.latency_ns
        assert all(0 < b - a <= UHF.latency_ns for a, b in pairwise(times_ns))


def test_copies_share_the_fate_of_the_first():
    receiver = ears(replace(UHF, loss=0.5))
    frames = [frame(n, at_ns=(n, n + 5)) for n in range(50)]
    firsts = [receiver.fate(f) for f in frames]
    receiver.set_profile("a", replace(UHF, loss=0.0), 60)
    assert [receiver.fate(f) for f in frames] == firsts
    assert {f.verdict for f in firsts} == {Verdict.DELIVERED, Verdict.LOST}
    assert verdict(receiver, 3) is Verdict.DELIVERED, "what is done with is forgotten"


def test_fates_kept_for_copies_are_bounded():
    receiver = ears(UHF)
    for number in range(3 * DOUBLED_FATES):
        receiver.fate(frame(number, at_ns=(1, 2)))
    assert len(receiver._ears["a"]._doubled) == DOUBLED_FATES


def test_frames_that_are_held_back_are_overtaken_and_others_keep_their_order():
    held_ns = 10 * NS
    frames = arrivals_of(faulty(reordering=0.2, reordering_ns=held_ns))
    late_ns = [s.arrivals[0][1] - s.end_ns - UHF.latency_ns for s in frames]
    held = [late for late in late_ns if late]
    assert abs(len(held) - 80) < 4 * math.sqrt(400 * 0.2 * 0.8)
    assert 0.9 * held_ns < max(held) <= held_ns
    on_time = [s.arrivals[0][1] for s, late in zip(frames, late_ns, strict=True) if not late]
    assert on_time == sorted(on_time)
    all_ns = [s.arrivals[0][1] for s in frames]
    assert all_ns != sorted(all_ns)


@pytest.mark.parametrize("bit_errors", [0.0, 1e-4, 0.01])
def test_bits_are_flipped_as_often_as_stated(bit_errors):
    receiver, frames, size = ears(faulty(bit_errors=bit_errors)), 1500, 125
    flips = [receiver.fate(frame(n, n, size=size)).flipped_bits for n in range(frames)]
    assert all(0 <= bit < 8 * size for bits in flips for bit in bits)
    unharmed, expected = sum(not bits for bits in flips), (1 - bit_errors) ** (8 * size) * frames
    assert abs(unharmed - expected) <= 4 * math.sqrt(max(expected * (1 - expected / frames), 0))
    total, mean = sum(map(len, flips)), bit_errors * 8 * size * frames
    assert abs(total - mean) <= 4 * math.sqrt(mean)


def test_faults_of_one_link_do_not_shift_anothers_luck():
    wild = Faults(duplication=0.5, reordering=0.5, burst_ns=NS, bit_errors=0.01)
    jittery = replace(UHF, jitter_ns=10**7, loss=0.5)
    plain, other = (
        Transmitter({"b": replace(UHF, faults=faults), "c": jittery}, rng(3))
        for faults in (Faults(), wild)
    )
    ears_of = [
        Receiver({"b": replace(UHF, faults=faults), "c": jittery}, {"b": rng(1), "c": rng(2)})
        for faults in (Faults(), wild)
    ]
    for n in range(40):
        sent = [t.begin(n * 10**9, 50) for t in (plain, other)]
        to_c = [[at for name, at in s.arrivals if name == "c"] for s in sent]
        assert to_c[0] == to_c[1]
        assert len({verdict(r, n, n, sender="c") for r in ears_of}) == 1


# --- exactness ------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_bps", [2400, 3000, 9600, 12_000, 128_000])
def test_ten_thousand_frames_in_a_row_do_not_drift(rate_bps):
    """Each end is its start and 8 * bytes / rate, rounded up to a nanosecond; nothing adds up."""
    profile = LinkProfile("any", float(rate_bps), 50_000_000, 256, 6)
    transmitter, sizes = Transmitter({"b": profile}, rng()), rng(4).integers(20, 257, 10_000)
    bits, end_ns = 0, 0
    for size in sizes.tolist():
        sent = transmitter.begin(end_ns, size)
        assert sent.start_ns == end_ns
        assert sent.end_ns - sent.start_ns == -(-8 * (size + 6) * NS // rate_bps)
        assert sent.arrivals[0][1] >= sent.end_ns + 50_000_000
        bits, end_ns = bits + 8 * (size + 6), sent.end_ns
    assert 0 <= end_ns - Fraction(bits * NS, rate_bps) < 10_000
