import math
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comms.link import Receiver, Transmitter, Verdict, airtime_ns
from comms.profiles import PROFILES, LinkProfile

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


def ears(profile, seed=5):
    return Receiver({"a": profile}, {"a": rng(seed)})


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.5, 1.0])
def test_loss_is_as_frequent_as_stated(loss):
    count = 4000
    receiver = ears(replace(UHF, loss=loss))
    heard = [receiver.verdict("a", n, n * 10**8) for n in range(count)]
    lost = heard.count(Verdict.LOST)
    assert set(heard) <= {Verdict.LOST, Verdict.DELIVERED}
    assert abs(lost - loss * count) <= 4 * math.sqrt(count * loss * (1 - loss))


@quick
@given(st.permutations(range(30)), st.integers(0, 29))
def test_luck_depends_on_the_frame_and_not_on_what_came_before(order, slept):
    lossy = replace(UHF, loss=0.5)
    awake, shuffled = ears(lossy), ears(lossy)
    expected = [awake.verdict("a", n, 0) for n in range(30)]
    heard = {n: shuffled.verdict("a", n, 0) for n in order if n >= slept}
    assert all(heard[n] is expected[n] for n in heard)
    assert {Verdict.LOST, Verdict.DELIVERED} == set(expected)


def test_links_have_luck_of_their_own():
    lossy = replace(UHF, loss=0.5)
    receiver = Receiver({"a": lossy, "b": lossy}, {"a": rng(1), "b": rng(2)})
    fates = {name: [receiver.verdict(name, n, 0) for n in range(64)] for name in "ab"}
    assert fates["a"] != fates["b"]


def test_nothing_is_heard_over_a_link_that_was_down_for_part_of_a_frame():
    receiver = ears(UHF)
    assert receiver.verdict("a", 0, 100) is Verdict.DELIVERED
    receiver.set_profile("a", replace(UHF, up=False), 200)
    assert receiver.verdict("a", 1, 150) is Verdict.DOWN
    receiver.set_profile("a", UHF, 300)
    assert receiver.verdict("a", 2, 299) is Verdict.DOWN
    assert receiver.verdict("a", 3, 300) is Verdict.DELIVERED
    receiver.set_profile("a", replace(UHF, rate_bps=2400.0), 400)
    assert receiver.verdict("a", 4, 350) is Verdict.DELIVERED
    assert ears(replace(UHF, rate_bps=0.0)).verdict("a", 0, 0) is Verdict.DOWN


def test_range_is_a_limit_where_the_distance_is_known():
    receiver = ears(replace(UHF, range_m=50.0))
    assert receiver.verdict("a", 0, 0, 50.0) is Verdict.DELIVERED
    assert receiver.verdict("a", 1, 0, 50.1) is Verdict.FAR
    assert receiver.verdict("a", 2, 0, None) is Verdict.DELIVERED
    assert ears(UHF).verdict("a", 3, 0, 1e6) is Verdict.DELIVERED


def test_a_receiver_knows_its_team_mates():
    assert ears(UHF).knows("a")
    assert not ears(UHF).knows("x")
