import math
import random
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comms.bursts import KEPT_EDGES, Bursts
from comms.channel import Medium, Seat, airtime_ns, turn_ns
from comms.faults import Faults, Luck, flipped_bits, with_flips
from comms.timebase import NS
from comms.traces import Trace

quick = settings(max_examples=60, deadline=None)


def rng(seed=1):
    return np.random.default_rng(seed)


# --- bursts ---------------------------------------------------------------------------------


def state_at(bursts, t_ns):
    return bursts.meets(t_ns, t_ns)


def test_the_share_of_bad_time_and_the_lengths_of_spells_are_as_stated():
    good_ns, bad_ns, step_ns, count = 300_000, 100_000, 1000, 400_000
    bursts = Bursts(rng(), good_ns, bad_ns)
    states = np.array([state_at(bursts, n * step_ns) for n in range(count)])
    spells = count * step_ns / (good_ns + bad_ns)
    assert abs(states.mean() - 0.25) < 4 * 0.25 / math.sqrt(spells)
    begun = np.count_nonzero(~states[:-1] & states[1:])
    assert begun == pytest.approx(spells, rel=0.1)
    assert states.sum() * step_ns / begun == pytest.approx(bad_ns, rel=0.1)
    assert (~states).sum() * step_ns / begun == pytest.approx(good_ns, rel=0.1)


def test_the_first_state_has_the_probability_of_the_long_run():
    bad = sum(state_at(Bursts(rng(seed), 3 * NS, NS), 0) for seed in range(2000))
    assert abs(bad - 500) < 4 * math.sqrt(2000 * 0.25 * 0.75)


@quick
@given(st.integers(0, 99), st.lists(st.integers(0, 10**6), max_size=40), st.integers(0, 5000))
def test_spells_do_not_depend_on_who_asked_what_before(seed, asked_ns, length_ns):
    whole, now_and_then = (Bursts(rng(seed), 20_000, 5000) for _ in range(2))
    expected = {t: whole.meets(t, t + length_ns) for t in sorted(asked_ns)}
    random.Random(seed).shuffle(asked_ns)
    assert {t: now_and_then.meets(t, t + length_ns) for t in asked_ns} == expected


@quick
@given(st.integers(0, 99), st.integers(0, 10**5), st.integers(1, 300))
def test_a_span_is_bad_if_any_of_its_instants_is(seed, start_ns, length_ns):
    bursts = Bursts(rng(seed), 200, 50)
    instants = [state_at(bursts, t) for t in range(start_ns, start_ns + length_ns)]
    assert bursts.meets(start_ns, start_ns + length_ns) == any(instants)


def test_what_is_remembered_of_spells_is_bounded():
    bursts = Bursts(rng(), 10, 10)
    for n in range(40):
        bursts.meets(n * 10**5, n * 10**5 + 5)
        assert len(bursts._edges) <= 2 * KEPT_EDGES + 64
    fresh = Bursts(rng(), 10, 10)
    fresh.meets(39 * 10**5, 39 * 10**5)
    t_ns = range(39 * 10**5 - 1000, 39 * 10**5)
    assert [state_at(bursts, t) for t in t_ns] == [state_at(fresh, t) for t in t_ns]


# --- outages and traces ---------------------------------------------------------------------

ratios = st.sampled_from([0.0, 0.25, 0.5, 1.0])
rows = st.lists(st.tuples(st.integers(1, 20), ratios), min_size=1, max_size=8)


def slow_ratio(t_ns, values, loop, at_ns):
    """Return the ratio at an instant, row by row."""
    if loop and len(t_ns) > 1:
        period_ns = t_ns[-1] - t_ns[0] + t_ns[-1] - t_ns[-2]
        at_ns = (at_ns - t_ns[0]) % period_ns + t_ns[0]
    held = values[0]
    for begin_ns, value in zip(t_ns, values, strict=True):
        if begin_ns <= at_ns:
            held = value
    return held


@quick
@given(st.integers(0, 400), st.integers(0, 99), st.integers(0, 50))
def test_before_it_begins_a_link_is_as_it_is_at_first(start_ns, longer_ns, seed):
    asked_early, asked_late = (Bursts(rng(seed), 60, 40, since_ns=500) for _ in range(2))
    early = asked_early.meets(start_ns, start_ns + longer_ns)
    asked_late.meets(5000, 5001)
    assert early == asked_late.meets(500, 500)


@settings(max_examples=100, deadline=None)
@given(rows, st.booleans(), st.integers(0, 200), st.integers(0, 120))
def test_a_trace_tells_the_least_ratio_of_a_span(steps, loop, start_ns, length_ns):
    t_ns = np.cumsum([step for step, _ in steps]).tolist()
    t_ns = [t - t_ns[0] for t in t_ns]
    values = [value for _, value in steps]
    told = Trace(t_ns, values, loop=loop).least(start_ns, start_ns + length_ns)
    instants = range(start_ns, start_ns + max(length_ns, 1))
    assert told == min(slow_ratio(t_ns, values, loop, t) for t in instants)


@quick
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(1, 9)), max_size=6), st.integers(0, 90))
def test_outages_are_a_trace_of_nothing(gaps, at_ns):
    spans, free_ns = [], 0
    for gap_ns, length_ns in gaps:
        spans.append((free_ns + gap_ns, free_ns + gap_ns + length_ns))
        free_ns = spans[-1][1]
    out = any(a <= at_ns < b for a, b in spans)
    assert Trace.of_outages(spans).least(at_ns, at_ns) == (0.0 if out else 1.0)


# --- bits -----------------------------------------------------------------------------------


@quick
@given(st.binary(min_size=1, max_size=40), st.data())
def test_flips_change_these_bits_and_no_others(data, draw):
    bits = draw.draw(st.sets(st.integers(0, 8 * len(data) - 1)))
    harmed = with_flips(data, tuple(sorted(bits)))
    assert len(harmed) == len(data)
    told = int.from_bytes(data, "little") ^ int.from_bytes(harmed, "little")
    assert {n for n in range(8 * len(data)) if told >> n & 1} == bits


def test_every_bit_is_as_likely_as_every_other():
    luck, hits = Luck(rng()), Counter()
    for number in range(3000):
        hits.update(flipped_bits(0.05, luck, number, 0, 4))
    assert sorted(hits) == list(range(32))
    assert all(abs(n - 150) < 4.5 * math.sqrt(150) for n in hits.values())


def test_the_same_luck_for_the_same_frame_and_purpose_and_another_else():
    one, same = Luck(rng(3)), Luck(rng(3))
    draws = [(n, t, what) for n in range(5) for t in range(5) for what in (b"", b"held")]
    assert [one.chance(*d) for d in draws] == [same.chance(*d) for d in draws]
    assert len({one.chance(*d) for d in draws}) == len(draws)
    assert one.chance(0, 0) != Luck(rng(4)).chance(0, 0)
    assert all(0 <= one.chance(*d) < 1 for d in draws)


def test_no_faults_are_the_default():
    assert Faults() == Faults(burst_ns=0, outages_ns=(), trace_file="", bit_errors=0.0)


# --- the channel ----------------------------------------------------------------------------


@quick
@given(st.integers(1, 6), st.integers(1, 50), st.integers(0, 2000), st.data())
def test_turns_are_the_earliest_that_are_long_enough(team, slot_ns, now_ns, data):
    index, need_ns = data.draw(st.integers(0, team - 1)), data.draw(st.integers(0, slot_ns))
    start_ns, end_ns = turn_ns(Seat(index, team), slot_ns, now_ns, need_ns)

    def mine(t_ns):
        return t_ns // slot_ns % team == index

    def fits(t_ns):
        return mine(t_ns) and t_ns % slot_ns + need_ns <= slot_ns

    slow_ns = next(t for t in range(now_ns, now_ns + 2 * team * slot_ns) if fits(t))
    assert (start_ns, end_ns) == (slow_ns, (slow_ns // slot_ns + 1) * slot_ns)


@quick
@given(
    st.lists(
        st.tuples(st.integers(0, 30), st.integers(1, 15), st.sampled_from("abc")), max_size=20
    ),
    st.integers(0, 60),
    st.integers(0, 15),
)
def test_a_medium_knows_who_was_on_air_together(told, start_ns, length_ns):
    medium, end_ns = Medium(), start_ns + length_ns
    told.sort()
    own, free_ns = [], 0
    for begin_ns, airtime, who in told:
        medium.senses(who, begin_ns, begin_ns + airtime)
        free_ns = max(free_ns, begin_ns) + airtime
        own.append((free_ns - airtime, free_ns))
        medium.sends(*own[-1])

    def meets(a, b):
        return a < end_ns and start_ns < b

    others = [(a, a + n) for a, n, who in told if who != "a"]
    assert medium.clashes("a", start_ns, end_ns) == any(meets(*span) for span in others)
    assert medium.was_sending(start_ns, end_ns) == any(meets(*span) for span in own)
    last_ns = max((b for _, b in own), default=None)
    assert medium.free_ns(7, 3) == (7 if last_ns is None else max(7, last_ns + 3))


def test_airtime_in_integers():
    assert airtime_ns(100, 9600.0) == 83_333_334
    assert airtime_ns(300, 2400.0) == NS
    assert airtime_ns(300, math.inf) == 0
