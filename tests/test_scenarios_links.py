"""Faulty links from the scenario file to the records."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_helpers import Ran, records_of, run_of, small

from scenarios import cli
from scenarios.errors import ScenarioError
from scenarios.schema import dump, load, parse

TRACE = "t_s,delivery_ratio\n0,1\n30,0.5\n45,0\n50,1\n"


def problem(*sets: str, name: str = "cliff") -> str:
    with pytest.raises(ScenarioError) as caught:
        load(name, sets)
    (one,) = caught.value.problems
    return one


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("links.loss=2", "links.loss = 2: must be a number of at least 0 and at most 1"),
        ("links.outages_s=[[9, 3]]", "outage 0 is [9, 3]; it must end after it begins"),
        ("links.outages_s=[[1, 3], [2, 9]]", "outage 1 is [2, 9]"),
        ("links.outages_s=[3]", "must be a list of 2 values, each a number of at least 0"),
        ("links.burst_s=0.001", "burst_s is 0.001; 0 (none) or at least 0.01 allowed"),
        ("links.bit_errors=0.9", "links.bit_errors = 0.9: must be a number of at least 0"),
        ("links.channel=aloha", 'links.channel = "aloha": must be one of own, tdma, csma'),
        ("links.half_duplex=1", "links.half_duplex = 1: must be true or false"),
        ("links.trace_end=stop", "must be one of hold, loop"),
        ("links.robots.recon.channel=tdma", "there is no such key"),
        ("links.pairs.recon>cliffbot.antenna_m=3", "there is no such key"),
        ("links.trace_file=nowhere.csv", 'links.trace_file = "nowhere.csv": no such file (from '),
        ("links.robots.recon.trace_file=nowhere.csv", "links.robots.recon.trace_file = "),
        (
            "links.pairs.recon>cliffbot.trace_file=nowhere.csv",
            "links.pairs.recon>cliffbot.trace_file = ",
        ),
        ("events=[{at_s=9,link='all',trace_file='nowhere.csv'}]", "events.0.trace_file = "),
        ("events=[{at_s=9,link='recon',slot_s=3}]", "only link = all may have it"),
        ("events=[{at_s=9,link='recon>cliffbot',antenna_m=3}]", "a robot or all may have it"),
    ],
)
def test_a_refusal_names_the_key_the_value_and_what_is_allowed(setting: str, words: str) -> None:
    sentence = problem(setting)
    assert words in sentence, sentence
    assert "\n" not in sentence


def test_a_turn_must_hold_a_frame_at_every_stage() -> None:
    turns = ("links.channel=tdma", "links.slot_s=0.2")
    assert load("cliff", turns).links.slot_s == 0.2
    slow = "events=[{at_s=9,link='recon',profile='sojourner'}]"
    with pytest.raises(ScenarioError) as caught:
        load("cliff", [*turns, slow])
    assert "links.slot_s = 0.2: the shortest frame takes 0.233333 s" in str(caught.value)


def test_a_trace_is_found_beside_its_scenario_or_from_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        (folder / "t.csv").write_text(TRACE)
    mine = there / "mine.toml"
    mine.write_text(
        'name="mine"\nlimit_s=90\nrobots.count=2\nlinks.trace_file="t.csv"\n'
        'links.robots.explorer-1.trace_file="t.csv"\n'
        'links.pairs."explorer-1>explorer-2".trace_file="t.csv"\n'
        '[[events]]\nat_s=3\nlink="all"\ntrace_file="t.csv"\n'
        '[[events]]\nat_s=4\nlink="all"\ntrace_file=""\n'
    )
    monkeypatch.chdir(here)
    found, beside = load(str(mine)), str(there / "t.csv")
    assert found.links.trace_file == found.links.robots["explorer-1"].trace_file == beside
    assert found.links.pairs["explorer-1>explorer-2"].trace_file == beside
    assert [event.trace_file for event in found.events] == [beside, ""]
    asked = load(str(mine), ["links.trace_file=t.csv"]).links
    assert asked.trace_file == str(here / "t.csv")
    assert asked.robots["explorer-1"].trace_file == beside
    left = tmp_path / "scenario.toml"
    left.write_text(dump(found))
    monkeypatch.chdir("/")
    assert load(str(left)) == found


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t_s,up\n0,maybe\n", "line 2: up = 'maybe'; must be 1 or 0"),
        ("seconds,up\n0,1\n", "line 1: the header is 'seconds,up'; it must name t_s"),
    ],
)
def test_a_trace_that_is_none_is_bad_input(
    text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    assert (
        cli.main(["run", "cliff", "--set", f"links.trace_file={path}", "--out", str(tmp_path)]) == 2
    )
    told = capsys.readouterr().err
    assert words in told
    assert str(path) in told
    assert told.count("\n") == 1


def test_what_is_dumped_loads_back_equal() -> None:
    sets = ["links.outages_s=[[1, 2.5], [3, 4]]", "links.channel=csma", "links.antenna_m=2.5"]
    event = "events=[{at_s=5, link='all', outages_s=[], half_duplex=true}]"
    scenario = load("pair", [*sets, event])
    import tomllib  # noqa: PLC0415  (once)

    assert parse(tomllib.loads(dump(scenario)), "dumped") == scenario


# --- whole runs -----------------------------------------------------------------------------

FAULTS = (
    "robots.count=3",
    "limit_s=240",
    "links.duplication=0.2",
    "links.reordering=0.2",
    "links.half_duplex=true",
    "links.jitter_s=0.1",
    "links.line_of_sight=true",
    "links.antenna_m=0.3",
    "links.range_m=14",
    "links.outages_s=[[20, 25], [60, 61]]",
    "links.trace_end=loop",
)
EVENTS: list[dict[str, Any]] = [
    {"at_s": 50.0, "link": "explorer-1", "bit_errors": 2e-4, "burst_s": 2.0, "burst_gap_s": 10.0},
    {"at_s": 70.0, "link": "all", "channel": "tdma", "slot_s": 1.5},
    {"at_s": 90.0, "restart": "explorer-2", "after_s": 10.0},
    {"at_s": 110.0, "link": "all", "channel": "csma", "backoff_s": 0.02},
]


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> list[Ran]:
    folder = tmp_path_factory.mktemp("faulty")
    trace = folder / "trace.csv"
    trace.write_text(TRACE)
    return [
        run_of(
            small("pair", *FAULTS, f"links.trace_file={trace}", f"air={air}", events=EVENTS),
            folder / air,
        )
        for air in ("memory", "zenoh")
    ]


def test_every_fault_does_the_same_in_one_process_and_in_many(faulty: list[Ran]) -> None:
    one, many = faulty
    assert records_of(one) == records_of(many)


def test_every_fault_is_counted_by_its_own_word(faulty: list[Ran]) -> None:
    frames = faulty[0].table("frames")
    words = Counter(frame["verdict"] for frame in frames)
    assert words.keys() >= {"delivered", "lost", "outage", "receiver sending", "damaged", "clash"}
    heard_not = {"lost", "outage", "receiver sending", "clash", "out of range", "out of sight"}
    for frame in frames:
        assert (frame["arrive_s"] is None) or frame["verdict"] not in heard_not
        if any(a < frame["end_s"] and frame["start_s"] < b for a, b in ((20, 25), (60, 61))):
            assert frame["verdict"] == "outage"
    for name, told in faulty[0].summary["robots"].items():
        counted = Counter(f["verdict"] for f in frames if f["to"] == name)
        for word, count in told["dropped_frames"].items():
            assert word == "replayed" or word in counted
            if name != "explorer-2":  # what it counted in its first life went with it
                assert word == "replayed" or counted[word] == count
        assert told["received_frames"] == counted["delivered"]


def test_turns_hold_in_a_whole_run(faulty: list[Ran]) -> None:
    names = list(faulty[0].summary["robots"])
    turns = [f for f in faulty[0].frames() if 70.0 < f["start_s"] < 110.0]
    for frame in turns:
        slot = int(frame["start_s"] // 1.5)
        assert names[slot % 3] == frame["from"]
        assert frame["end_s"] <= (slot + 1) * 1.5 + 1e-9
    assert len(turns) > 5


def test_a_ridge_between_two_robots_hides_them_until_their_antennas_stand_out(
    tmp_path: Path,
) -> None:
    elevation_m = np.zeros((160, 200))
    elevation_m[:, 98:102] = 4.0
    np.savez(tmp_path / "ridge.npz", elevation=elevation_m, cell_size=0.1)
    sets = (
        f"world.terrain.file={tmp_path / 'ridge.npz'}",
        "robots.explorer-1.start=[5, 7, 0]",
        "robots.explorer-2.start=[15, 7, 180]",
        "world.window_m=[19.8, 15.8]",
        "links.line_of_sight=true",
        "limit_s=120",
    )
    event = {"at_s": 60.0, "link": "all", "antenna_m": 5.0}
    ran = run_of(small("pair", *sets, events=[event]), tmp_path / "ridge")
    frames = ran.table("frames")
    before = Counter(f["verdict"] for f in frames if f["end_s"] < 59)
    after = Counter(f["verdict"] for f in frames if f["start_s"] > 60)
    assert before.keys() == {"out of sight"}
    assert after.keys() <= {"delivered", "not yet arrived"}
    assert before["out of sight"] > 5
    assert after["delivered"] > 5
