import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from comms.profiles import (
    MIN_FRAME_BYTES,
    PROFILES,
    LinkChange,
    LinkError,
    LinkSettings,
    TeamLinks,
    check_names,
    least_latency_ns,
    pair_of,
    resolve,
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
    return LinkChange(target, LinkSettings.model_validate(fields))


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
