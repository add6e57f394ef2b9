import pickle
import random
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from comms.profiles import resolve
from scenarios.errors import ScenarioError
from scenarios.schema import Scenario, dump, load, parse
from scenarios.schema.overrides import Override
from scenarios.shelf import names

LIBRARY = names()


def problems(name: str, *sets: str) -> tuple[str, ...]:
    with pytest.raises(ScenarioError) as caught:
        load(name, sets)
    assert all("\n" not in one for one in caught.value.problems)
    return caught.value.problems


def problem(name: str, *sets: str) -> str:
    (one,) = problems(name, *sets)
    return one


def with_events(*events: dict[str, Any], name: str = "cliff", **keys: Any) -> Scenario:
    changes = [Override("events", ("events",), list(events))]
    changes += [Override(key, (key,), value) for key, value in keys.items()]
    return load(name, changes)


def refused(*events: dict[str, Any]) -> str:
    with pytest.raises(ScenarioError) as caught:
        with_events(*events)
    return str(caught.value)


def leaves(value: Any, path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], Any]]:
    if isinstance(value, dict):
        return [leaf for key, one in value.items() for leaf in leaves(one, (*path, key))]
    return [(path, value)]


def tables(model: type[BaseModel], path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    found = [path]
    for key, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            found += tables(kind, (*path, key))
    return found


def test_library_has_the_cliff_and_the_pair() -> None:
    assert {"cliff", "pair"} <= set(LIBRARY)
    cliff = load("cliff")
    roles = {name: robot.role for name, robot in cliff.robots.items()}
    anchors = {"anchor-left": "anchor", "anchor-right": "anchor"}
    assert roles == {"recon": "recon", "cliffbot": "cliffbot", **anchors}
    assert cliff.links.profile == "uhf-9600"
    assert cliff.limit_s == 7200
    assert list(load("pair").robots) == ["explorer-1", "explorer-2"]


@pytest.mark.parametrize("name", LIBRARY)
def test_what_is_dumped_loads_back_equal_and_takes_more_events(name: str, tmp_path: Path) -> None:
    scenario = load(name)
    robot = next(iter(scenario.robots))
    path = tmp_path / "scenario.toml"
    path.write_text(dump(scenario))
    assert load(str(path)) == scenario
    for at_s in (10, 20):
        with path.open("a") as file:
            file.write(f'\n[[events]]\nat_s = {at_s}\nlink = "{robot}"\nloss = 0.{at_s}\n')
        again = load(str(path))
        path.write_text(dump(again))
        assert load(str(path)) == again
    assert [event.at_s for event in again.events] == [10, 20]
    assert again.model_copy(update={"events": ()}) == scenario


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_a_changed_scenario_dumps_and_loads_back_equal(data: st.DataObject) -> None:
    number = st.floats(0.1, 50).map(lambda value: round(value, 6))
    sets = {
        "links.rate_bps": data.draw(st.floats(1, 1e6)),
        "links.loss": data.draw(st.floats(0, 1)),
        "drive.speed_mps": data.draw(number),
        "seed": data.draw(st.integers(0, 2**63 - 1)),
        "title": data.draw(st.text(st.characters(codec="utf-8"), max_size=30)),
        "planner.tilts_deg": data.draw(st.lists(st.floats(-90, 45), max_size=3)),
    }
    chosen = data.draw(st.sets(st.sampled_from(sorted(sets))))
    changes = [Override(key, tuple(key.split(".")), sets[key]) for key in sorted(chosen)]
    events = [{"at_s": data.draw(st.floats(0, 3000)), "kill": "recon"}]
    scenario = load("cliff", [*changes, Override("", ("events",), events)])
    assert parse(tomllib.loads(dump(scenario)), "dumped") == scenario


@pytest.mark.parametrize("name", LIBRARY)
def test_set_reaches_every_key(name: str) -> None:
    scenario = load(name)
    full = scenario.model_dump(mode="json", exclude_none=True)
    found = leaves(full)
    assert len(found) > 60
    for path, value in found:
        if path not in {("links", "robots"), ("links", "pairs"), ("events",)}:
            literal = tomli_w.dumps({"v": value}).partition("=")[2].strip()
            assert load(name, [f"{'.'.join(path)}={literal}"]) == scenario, path


def test_set_reaches_keys_that_are_not_there_yet() -> None:
    scenario = load(
        "cliff",
        [
            "links.pairs.recon>cliffbot.up=false",
            "links.robots.recon.rate_bps=1200",
            "robots.recon.start=[16, 20, 90]",
            "robots.anchor-left.join_s=5",
        ],
    )
    assert not resolve(scenario.links, "recon", "cliffbot").carries
    assert resolve(scenario.links, "recon", "anchor-left").rate_bps == 1200
    assert scenario.robots["recon"].start == (16, 20, 90)
    assert scenario.joins_s("anchor-left") == 5


@pytest.mark.parametrize("path", tables(Scenario))
def test_an_unknown_key_is_refused_everywhere(path: tuple[str, ...]) -> None:
    key = ".".join((*path, "nonsense"))
    sentence = problem("cliff", f"{key}=3")
    assert f"{key} = 3" in sentence
    assert "there is no such key" in sentence
    assert "allowed here: " in sentence


@pytest.mark.parametrize("wrong", ["[[1]]", "-1e300"])
@pytest.mark.parametrize("name", LIBRARY)
def test_a_wrong_type_or_an_impossible_value_is_refused_everywhere(name: str, wrong: str) -> None:
    full = load(name).model_dump(mode="json", exclude_none=True)
    text = {("title",)} if wrong.startswith("-") else set[tuple[str, ...]]()
    free = {("links", "robots"), ("links", "pairs"), ("events",), ("robots",), *text}
    for path, _ in leaves(full):
        key = ".".join(path)
        if path not in free and key != "world.terrain.file":
            assert any(key in one for one in problems(name, f"{key}={wrong}")), key


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        (["links.rate_bsp=4"], ["links.rate_bsp = 4", "did you mean rate_bps?"]),
        (["links.rate_bps=fast"], ['"fast"', "must be a number of at least 0"]),
        (["sensor.fov_deg=200"], ["above 1 and at most 170"]),
        (["links.up=False"], ["links.up", "true or false"]),
        (["links.profile=foo"], ["one of sojourner, uhf-9600"]),
        (["limit_s=nan"], ["limit_s = NaN", "must be a number above 0"]),
        (["limit_s=inf"], ["must be a number above 0 and at most 2592000"]),
        (["method=best"], ["method", "one of information-interest"]),
        (["map.tile_cells=33"], ["one of 16, 32, 64, 128"]),
        (["robots.recon.start=[1,2]"], ["robots.recon.start = [1, 2]", "a list of 3 values"]),
        (["name=a/b"], ["name", "Letters, digits"]),
        (["seed=-1"], ["seed = -1", "a whole number of at least 0"]),
        (["seed=true"], ["seed = true"]),
        (["seed=1.5"], ["seed = 1.5"]),
        (["clock.speed=3"], ["clock.speed", "--clock real"]),
        (["sensor.near_m=13"], ["sensor.near_m", "below sensor.range_m = 12"]),
        (["robots.cliffbot.role=recon"], ["exactly two anchors"]),
        (["robots.anchor-left.role=recon"], ["exactly two anchors"]),
        (["robots.recon.role=cliffbot"], ["nobody maps", "at most one cliffbot"]),
        (["robots.recon.join_s=9000"], ["robots.recon.join_s", "below limit_s = 7200"]),
        (['robots."1 y".role=recon'], ["robots.1 y", "starts with a letter"]),
        (["robots.all.role=recon"], ["`all` means all robots"]),
        (["links.robots.me.loss=0.1"], ["links.robots.me", "must be one of recon, cliffbot"]),
        (["links.pairs.recon>me.loss=0.1"], ["links.pairs.recon>me", "no such robot"]),
        (["links.pairs.recon.loss=0.1"], ['"sender>receiver"']),
        (["world.terrain.file=none.npz"], ["world.terrain.file", "no such file"]),
        (["world.terrain.cell_m=1"], ["cell_m is the scale of a file"]),
        (["robots={}"], ["robots = {}"]),
        (["robots=3"], ["robots = 3", "a table"]),
    ],
)
def test_a_refusal_names_the_key_the_value_and_what_is_allowed(
    sets: list[str], words: list[str]
) -> None:
    told = "\n".join(problems("cliff", *sets))
    assert all(word in told for word in words), told
    assert "--set" in told


def test_every_problem_is_told_at_once() -> None:
    assert len(problems("cliff", "seed=-1", "limit_s=0", "sensor.fov=3")) == 3


def test_a_refusal_names_the_file_where_the_file_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\nlimit_s = "long"\n[robots]\ncount = 2\n')
    assert str(path) in problem(str(path))
    assert 'limit_s = "long"' in problem(str(path))
    path.write_text('name = "mine"\n[robots]\ncount = 2\n')
    assert "limit_s: is missing; must be a number" in problem(str(path))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"name = ", "is no TOML"),
        (b"\xff\xfe", "no text in UTF-8"),
        (b"title = 1979-05-27\nlimit_s = 3\n", "no key takes one"),
        (b"x = " + b"[" * 100_000, "nested too deep"),
        (b"#" * 1_000_001, "at most 1000000"),
        (b"", "name: is missing"),
    ],
)
def test_a_file_that_is_no_scenario_is_refused(content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    assert words in "\n".join(problems(str(path)))


def test_an_unknown_name_is_refused_with_the_nearest(tmp_path: Path) -> None:
    assert "did you mean cliff?" in problem("clif")
    assert "no such file" in problem("nowhere/cliff.toml")
    assert "is a folder" in problem(str(tmp_path))


def test_a_terrain_file_makes_any_scenario_one_of_measured_ground(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ground.npz").touch()
    monkeypatch.chdir(tmp_path)
    scenario = load("cliff", ["world.terrain.file=ground.npz", "world.terrain.cell_m=0.2"])
    assert scenario.world.terrain.kind == "file"
    assert scenario.world.terrain.file == str(tmp_path / "ground.npz")
    left = tmp_path / "run" / "scenario.toml"
    left.parent.mkdir()
    left.write_text(dump(scenario))
    monkeypatch.chdir("/")
    assert load(str(left)) == scenario
    assert load(str(left), ["world.terrain.kind=cliff"]).world == load("cliff").world


def test_a_terrain_file_is_found_beside_its_scenario_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        (folder / "ground.npz").touch()
    path = there / "mine.toml"
    path.write_text(
        'name="mine"\nlimit_s=9\nrobots.count=1\nworld.terrain={kind="file",file="ground.npz"}'
    )
    monkeypatch.chdir(here)
    assert load(str(path)).world.terrain.file == str(there / "ground.npz")
    asked = load(str(path), ["world.terrain.file=ground.npz"])
    assert asked.world.terrain.file == str(here / "ground.npz")


def test_count_makes_explorers_and_tables_add_to_them() -> None:
    team = load("pair", ["robots.count=3", "robots.explorer-2.join_s=60"]).robots
    assert list(team) == ["explorer-1", "explorer-2", "explorer-3"]
    assert team["explorer-2"].join_s == 60
    assert team["explorer-2"].role == "explorer"


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        (["robots.count=0"], "whole number from 1 to 64"),
        (["robots.count=65"], "whole number from 1 to 64"),
        (["robots.count=true"], "whole number from 1 to 64"),
        (["robots.role=anchor"], "one of recon, explorer"),
        (["robots.recon.role=recon"], "makes no robot recon"),
    ],
)
def test_an_impossible_count_is_refused(sets: list[str], words: str) -> None:
    assert words in problem("pair", *sets)


def test_seed_can_be_given() -> None:
    assert load("cliff", seed=77).seed == 77
    assert load("cliff", ["seed=5"]).seed == 5
    with pytest.raises(ScenarioError, match="--seed -2: seed = -2"):
        load("cliff", seed=-2)


KILL, STOP = {"at_s": 600, "kill": "recon"}, {"at_s": 600, "stop": "recon"}


@pytest.mark.parametrize(
    ("events", "words"),
    [
        ([{"at_s": 600, "kill": "reco"}], 'events.0.kill = "reco": there is no such robot'),
        ([{"at_s": 7200, "kill": "recon"}], "below limit_s = 7200"),
        ([{"at_s": 7000, "restart": "recon", "after_s": 500}], "events.0.after_s"),
        ([{"at_s": 600}], "has none of kill, stop"),
        ([{**KILL, "stop": "recon"}], "has kill and stop"),
        ([{**KILL, "up": False}], "only an event with link"),
        ([{**KILL, "after_s": 3}], "restart needs after_s"),
        ([{"at_s": 600, "restart": "recon"}], "restart needs after_s"),
        ([{"at_s": 600, "link": "all"}], "link needs something that changes"),
        ([{"at_s": 600, "link": "me", "up": False}], "no such robot"),
        ([{"at_s": 600, "link": "recon>me", "up": False}], "no such robot"),
        ([{"at_s": 600, "link": "recon>", "up": False}], "sender>receiver"),
        ([{"at_s": 600, "resume": "recon"}], "resume needs a robot that is stopped"),
        ([STOP, {"at_s": 500, "resume": "recon"}], "is running at 500 s"),
        ([STOP, {"at_s": 700, "stop": "recon"}], "is stopped at 700 s"),
        ([KILL, {"at_s": 600, "kill": "recon"}], "events.1.kill"),
        ([KILL, {"at_s": 700, "stop": "recon"}], "is dead at 700 s"),
        ([{"at_s": 700, "join": "recon"}, KILL], "has not joined yet at 600 s"),
        (
            [{"at_s": 600, "restart": "recon", "after_s": 9}, {"at_s": 605, "stop": "recon"}],
            "is dead at 605 s",
        ),
        ([{"at_s": -1, "kill": "recon"}], "events.0.at_s = -1"),
        ([{"kill": "recon"}], "events.0.at_s: is missing"),
        ([{"at_s": 1, "kil": "recon"}], "did you mean kill?"),
    ],
)
def test_an_event_that_can_not_happen_is_refused(events: list[dict[str, Any]], words: str) -> None:
    assert words in refused(*events)


def test_a_life_of_many_events_is_taken() -> None:
    scenario = with_events(
        {"at_s": 900, "kill": "recon"},
        {"at_s": 100, "join": "recon"},
        {"at_s": 200, "stop": "recon"},
        {"at_s": 300, "resume": "recon"},
        {"at_s": 400, "restart": "recon", "after_s": 50},
        {"at_s": 450, "stop": "recon"},
        {"at_s": 500, "kill": "recon"},
        {"at_s": 600, "restart": "recon", "after_s": 5},
    )
    assert scenario.joins_s("recon") == 100
    assert scenario.joins_s("cliffbot") == 0
    assert [event.at_s for event in scenario.timeline()] == [100, 200, 300, 400, 450, 500, 600, 900]
    kinds = [event.kind for event in scenario.timeline()]
    assert kinds[:3] == ["join", "stop", "resume"]


def test_join_by_settings_and_by_event_exclude_each_other() -> None:
    with pytest.raises(ScenarioError, match="only one of the two"):
        load("cliff", ["robots.recon.join_s=60", "events=[{at_s=100,join='recon'}]"])
    with pytest.raises(ScenarioError, match="has not joined yet at 30 s"):
        load("cliff", ["robots.recon.join_s=60", "events=[{at_s=30,kill='recon'}]"])


def test_link_events_change_links_in_the_order_of_time() -> None:
    scenario = with_events(
        {"at_s": 900, "link": "all", "profile": "orbiter"},
        {"at_s": 300, "link": "recon>cliffbot", "up": False},
        {"at_s": 600, "link": "recon", "profile": "sojourner", "loss": 0.5},
        KILL,
    )
    changes = scenario.link_changes()
    assert [change.target for change in changes] == ["recon>cliffbot", "recon", "all"]
    assert not resolve(scenario.links, "recon", "cliffbot", changes[:1]).carries
    assert resolve(scenario.links, "recon", "anchor-left", changes[:2]).rate_bps == 2400
    assert resolve(scenario.links, "cliffbot", "recon", changes).rate_bps == 128_000


def test_events_of_one_moment_keep_the_order_of_the_file() -> None:
    targets = ["recon", "cliffbot", "anchor-left", "anchor-right"]
    random.Random(3).shuffle(targets)
    scenario = with_events(*({"at_s": 60, "kill": name} for name in targets))
    assert [event.target for event in scenario.timeline()] == targets


def test_a_refusal_travels_between_processes_whole() -> None:
    refusal = ScenarioError(["one.toml: a", "one.toml: b"])
    again = pickle.loads(pickle.dumps(refusal))
    assert (str(again), again.problems) == (str(refusal), refusal.problems)
