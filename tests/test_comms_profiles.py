import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from comms.channel import ONE_EACH, Shared
from comms.faults import NO_FAULTS, Faults
from comms.linksettings import (
    MIN_FRAME_BYTES,
    AllLinks,
    LinkChange,
    TeamLinks,
    check_target,
    pair_of,
)
from comms.profiles import (
    PROFILES,
    LinkError,
    check_names,
    least_latency_ns,
    resolve,
    tightest_turn_ns,
)

NAMES = ("recon", "cliffbot", "anchor-left")
quick = settings(max_examples=60, deadline=None)


def links(**fields):
    return TeamLinks.model_validate(fields)


@pytest.mark.parametrize(
    ("name", "rate_bps"),
    [
        ("sojourner", 2400.0),
        ("uhf-9600", 9600.0),
        ("mer-low", 3000.0),
        ("mer-high", 12000.0),
        ("orbiter", 128000.0),
        ("unlimited", math.inf),
    ],
)
def test_profiles_have_the_rates_of_the_paper(name, rate_bps):
    profile = PROFILES[name]
    assert (profile.name, profile.rate_bps) == (name, rate_bps)
    assert profile.latency_ns >= 20_000_000
    assert profile.frame_bytes >= MIN_FRAME_BYTES
    assert profile.carries


def test_default_is_uhf():
    assert resolve(links(), "recon", "cliffbot") == PROFILES["uhf-9600"]


def test_pair_beats_robot_beats_team():
    team = links(
        rate_bps=5000,
        latency_s=0.1,
        loss=0.1,
        robots={"recon": {"rate_bps": 4000, "latency_s": 0.2}},
        pairs={"recon>cliffbot": {"rate_bps": 3000.5}},
    )
    pair = resolve(team, "recon", "cliffbot")
    assert (pair.rate_bps, pair.latency_ns, pair.loss) == (3000.5, 200_000_000, 0.1)
    assert resolve(team, "recon", "anchor-left").rate_bps == 4000
    back = resolve(team, "cliffbot", "recon")
    assert (back.rate_bps, back.latency_ns) == (5000, 100_000_000)


def test_a_nearer_profile_replaces_the_radio_but_not_the_circumstances():
    team = links(
        rate_bps=5000,
        overhead_bytes=3,
        loss=0.25,
        range_m=40.0,
        robots={"recon": {"profile": "sojourner", "frame_bytes": 128}},
    )
    link = resolve(team, "recon", "cliffbot")
    assert (link.name, link.rate_bps, link.overhead_bytes) == ("sojourner", 2400.0, 6)
    assert (link.frame_bytes, link.loss, link.range_m) == (128, 0.25, 40.0)


def test_a_radio_that_is_off_neither_sends_nor_hears():
    team = links(robots={"recon": {"up": False}})
    assert not resolve(team, "recon", "cliffbot").up
    assert not resolve(team, "cliffbot", "recon").up
    assert resolve(team, "cliffbot", "anchor-left").up


def test_a_robots_rate_is_its_transmitters_alone():
    team = links(robots={"recon": {"rate_bps": 1200.0}})
    assert resolve(team, "cliffbot", "recon").rate_bps == 9600.0


def test_all_off_but_one_pair():
    team = links(up=False, pairs={"recon>cliffbot": {"up": True}})
    assert resolve(team, "recon", "cliffbot").carries
    assert not resolve(team, "cliffbot", "recon").carries


def change(target, **fields):
    return LinkChange(target, AllLinks.model_validate(fields))


def test_changes_apply_in_their_order_and_the_last_one_counts():
    off, on = change("recon", up=False), change("recon", up=True)
    thin = change("all", profile="sojourner")
    team = links(rate_bps=5000, pairs={"recon>cliffbot": {"rate_bps": 1000}})
    assert resolve(team, "recon", "cliffbot").rate_bps == 1000
    assert resolve(team, "recon", "cliffbot", [thin]).rate_bps == 2400
    assert not resolve(team, "cliffbot", "recon", [thin, off]).up
    assert resolve(team, "cliffbot", "recon", [off, thin, on]).up
    all_off = change("all", up=False)
    assert not resolve(team, "recon", "cliffbot", [on, all_off]).up
    pair_on = change("recon>cliffbot", up=True)
    assert resolve(team, "recon", "cliffbot", [all_off, pair_on]).up
    assert not resolve(team, "cliffbot", "recon", [all_off, pair_on]).up


def test_switching_a_robot_on_leaves_a_pair_that_is_off_for_itself():
    team = links(pairs={"recon>cliffbot": {"up": False}})
    toggled = [change("recon", up=False), change("recon", up=True)]
    assert not resolve(team, "recon", "cliffbot", toggled).up
    assert resolve(team, "recon", "anchor-left", toggled).up
    assert resolve(team, "recon", "cliffbot", [change("all", up=True)]).up


def test_a_rate_of_zero_carries_nothing():
    link = resolve(links(rate_bps=0), "recon", "cliffbot")
    assert link.up
    assert not link.carries


ALL_FAULTS = {
    "line_of_sight": True,
    "burst_s": 2.0,
    "burst_gap_s": 9.0,
    "burst_loss": 0.8,
    "outages_s": [[1.0, 2.5], [2.5, 4.0]],
    "trace_file": "some.csv",
    "trace_end": "loop",
    "half_duplex": True,
    "bit_errors": 1e-4,
    "duplication": 0.1,
    "reordering": 0.2,
    "reordering_s": 3.0,
}


def test_every_fault_can_be_set_for_a_team_a_robot_a_pair_and_later():
    s = 1_000_000_000
    expected = Faults(
        line_of_sight=True,
        burst_ns=2 * s,
        burst_gap_ns=9 * s,
        burst_loss=0.8,
        outages_ns=((s, 5 * s // 2), (5 * s // 2, 4 * s)),
        trace_file="some.csv",
        trace_end="loop",
        half_duplex=True,
        bit_errors=1e-4,
        duplication=0.1,
        reordering=0.2,
        reordering_ns=3 * s,
    )
    for fields in (
        ALL_FAULTS,
        {"robots": {"recon": ALL_FAULTS}},
        {"pairs": {"recon>cliffbot": ALL_FAULTS}},
        {"robots": {"recon": {"profile": "sojourner"}}, **ALL_FAULTS},
    ):
        assert resolve(links(**fields), "recon", "cliffbot").faults == expected
    later = change("recon", **ALL_FAULTS)
    assert resolve(links(), "recon", "cliffbot", [later]).faults == expected
    assert resolve(links(), "cliffbot", "recon", [later]).faults is NO_FAULTS
    ended = change("all", outages_s=[], trace_file="", burst_s=0.0, half_duplex=False)
    left = resolve(links(), "recon", "cliffbot", [later, ended]).faults
    assert (left.outages_ns, left.trace_file, left.burst_ns, left.half_duplex) == ((), "", 0, False)
    assert left.duplication == 0.1


def test_a_link_without_faults_is_as_light_as_can_be():
    plain = resolve(links(loss=0.1, range_m=50.0, jitter_s=0.1), "recon", "cliffbot")
    assert plain.faults is NO_FAULTS
    assert plain.shared is ONE_EACH


def test_antennas_are_the_senders_and_the_receivers():
    team = links(antenna_m=2.0, robots={"recon": {"antenna_m": 5.0}})
    there, back = resolve(team, "recon", "cliffbot"), resolve(team, "cliffbot", "recon")
    assert (there.antenna_m, there.mate_antenna_m) == (5.0, 2.0)
    assert (back.antenna_m, back.mate_antenna_m) == (2.0, 5.0)
    raised = resolve(team, "recon", "cliffbot", [change("cliffbot", antenna_m=9.0)])
    assert (raised.antenna_m, raised.mate_antenna_m) == (5.0, 9.0)


def test_a_channel_is_for_all():
    team = links(channel="tdma", slot_s=1.5, robots={"recon": {"profile": "sojourner"}})
    shared = Shared("tdma", 1_500_000_000)
    assert resolve(team, "recon", "cliffbot").shared == shared
    assert resolve(team, "cliffbot", "recon").shared == shared
    csma = change("all", channel="csma", backoff_s=0.25)
    now = resolve(team, "recon", "cliffbot", [csma]).shared
    assert (now.kind, now.slot_ns, now.backoff_ns) == ("csma", 1_500_000_000, 250_000_000)
    for target, keys in (("recon", ["loss", "slot_s"]), ("a>b", ["channel"])):
        with pytest.raises(ValueError, match=f'has {keys[-1]} for "{target}"; only link = all'):
            check_target(target, keys)
    with pytest.raises(ValueError, match="only link = a robot or all may have it"):
        check_target("a>b", ["antenna_m"])
    check_target("all", AllLinks.model_fields)
    check_target("recon", ["antenna_m", "loss"])
    check_target("a>b", ["loss", "outages_s"])


def test_the_tightest_turn_of_a_scenario_is_found_at_any_stage():
    """64 bytes and the overhead: 20 at 9600 bps are 70 ms, 6 at 2400 bps 233 ms."""
    turns = links(channel="tdma", slot_s=0.5)
    assert tightest_turn_ns(links(), NAMES) is None
    assert tightest_turn_ns(turns, NAMES) == (500_000_000, 70_000_000)
    slow = change("recon", profile="sojourner")
    assert tightest_turn_ns(turns, NAMES, [slow]) == (500_000_000, 233_333_334)
    later = [slow, change("all", slot_s=0.2), change("recon", profile="uhf-9600")]
    assert tightest_turn_ns(turns, NAMES, later) == (200_000_000, 233_333_334)
    begun = [slow, change("all", channel="tdma")]
    assert tightest_turn_ns(links(), NAMES, begun) == (2 * 10**9, 233_333_334)


def test_a_change_says_what_changes():
    assert str(change("all", loss=0.5, up=False)) == "up = False, loss = 0.5"


latencies = st.floats(0.001, 10)


@quick
@given(
    latencies,
    st.dictionaries(st.sampled_from(NAMES), latencies, max_size=3),
    st.lists(st.tuples(st.sampled_from(("all", "recon", "recon>cliffbot")), latencies), max_size=4),
)
def test_lookahead_is_the_least_latency_that_ever_holds(team_s, robots_s, changes_s):
    team = links(latency_s=team_s, robots={n: {"latency_s": v} for n, v in robots_s.items()})
    changes = [change(target, latency_s=v) for target, v in changes_s]
    least_ns = least_latency_ns(team, NAMES, changes)
    seen_ns = [
        resolve(team, a, b, changes[:stage]).latency_ns
        for a in NAMES
        for b in NAMES
        if a != b
        for stage in range(len(changes) + 1)
    ]
    assert least_ns == min(seen_ns)
    assert least_ns > 0


def test_a_team_of_one_has_a_lookahead():
    assert least_latency_ns(links(), ["recon"]) > 0


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"rate_bps": -1}, "greater than or equal to 0"),
        ({"rate_bps": 0.5}, "rate_bps is 0.5; 0"),
        ({"rate_bps": math.inf}, "finite"),
        ({"rate_bps": "9600"}, "valid number"),
        ({"latency_s": 0}, "greater than or equal to 0.001"),
        ({"loss": 1.5}, "less than or equal to 1"),
        ({"frame_bytes": 20}, "greater than or equal to 64"),
        ({"frame_bytes": 100_000}, "less than or equal to 4096"),
        ({"profile": "wifi"}, "'sojourner'"),
        ({"range_m": 0}, "greater than 0"),
        ({"speed": 1}, "not permitted"),
        ({"pairs": {"recon": {}}}, 'pair is "recon"'),
        ({"pairs": {"recon>recon": {}}}, "two different robots"),
        ({"robots": {"recon": {"robots": {}}}}, "not permitted"),
        ({"robots": {"recon": {"channel": "tdma"}}}, "not permitted"),
        ({"pairs": {"a>b": {"antenna_m": 3.0}}}, "not permitted"),
        ({"channel": "aloha"}, "'tdma'"),
        ({"slot_s": 0}, "greater than 0"),
        ({"burst_s": 0.001}, "burst_s is 0.001; 0 .none. or at least 0.01"),
        ({"burst_gap_s": 0}, "greater than or equal to 0.01"),
        ({"outages_s": [[5, 4]]}, r"outage 0 is \[5, 4\]; it must end after it begins"),
        ({"outages_s": [[1, 3], [2, 4]]}, r"outage 1 is \[2, 4\].* begin at 3 or later"),
        ({"outages_s": [[-1, 4]]}, "greater than or equal to 0"),
        ({"outages_s": [[1]]}, "Field required"),
        ({"bit_errors": 0.6}, "less than or equal to 0.5"),
        ({"duplication": -0.1}, "greater than or equal to 0"),
        ({"reordering_s": 0}, "greater than 0"),
        ({"antenna_m": 0}, "greater than or equal to 0.2"),
        ({"trace_end": "stop"}, "'hold'"),
    ],
)
def test_impossible_settings_are_refused(fields, words):
    with pytest.raises(ValidationError, match=words):
        links(**fields)


def test_names_that_are_not_in_the_team_are_refused():
    check_names(links(robots={"recon": {}}, pairs={"recon > cliffbot": {}}), NAMES)
    with pytest.raises(LinkError, match='"reco"'):
        check_names(links(robots={"reco": {}}), NAMES)
    with pytest.raises(LinkError, match=r'"cliff" \(in "recon>cliff"\)'):
        check_names(links(pairs={"recon>cliff": {}}), NAMES)
    with pytest.raises(LinkError, match='"nobody"'):
        check_names(links(), NAMES, [change("all", up=False), change("nobody", up=False)])


def test_pairs_may_be_written_with_spaces():
    assert pair_of("a > b") == ("a", "b")
    team = links(pairs={"recon > cliffbot": {"up": False}})
    assert not resolve(team, "recon", "cliffbot").up
