from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.errors import ScenarioError
from scenarios.schema.overrides import apply_overrides, parse_override, parse_value


@pytest.mark.parametrize(
    ("text", "path", "value"),
    [
        ("links.profile=sojourner", ("links", "profile"), "sojourner"),
        ("links.rate_bps=5000", ("links", "rate_bps"), 5000),
        ("links.loss=1e-3", ("links", "loss"), 0.001),
        ("links.up=false", ("links", "up"), False),
        ("world.terrain.file=x.npz", ("world", "terrain", "file"), "x.npz"),
        ("title=a = b", ("title",), "a = b"),
        ('title="5"', ("title",), "5"),
        ("title=", ("title",), ""),
        ("title=1979-05-27", ("title",), "1979-05-27"),
        ("title=1\nseed = 2", ("title",), "1\nseed = 2"),
        ("links.pairs.a>b.up=true", ("links", "pairs", "a>b", "up"), True),
        ('links.pairs."a>b".up=true', ("links", "pairs", "a>b", "up"), True),
        ("x.'a.b'.c=[1, 2]", ("x", "a.b", "c"), [1, 2]),
        (" x = {a = 1} ", ("x",), {"a": 1}),
    ],
)
def test_a_value_is_toml_and_what_is_none_is_text(
    text: str, path: tuple[str, ...], value: object
) -> None:
    override = parse_override(text)
    assert (override.path, override.value) == (path, value)


@pytest.mark.parametrize("text", ["links", "", "=3", "a..b=3", ".a=3", "a.=3", "a b=3", 'a"b"=3'])
def test_what_is_no_key_is_refused(text: str) -> None:
    with pytest.raises(ScenarioError, match="must be"):
        parse_override(text)


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=40))
def test_any_text_is_some_value(text: str) -> None:
    assert isinstance(parse_value(text), bool | int | float | str | list | dict)


KEY = st.text("abc", min_size=1, max_size=2)


@settings(max_examples=100, deadline=None)
@given(st.lists(KEY, min_size=1, max_size=4), st.integers())
def test_a_value_that_was_put_is_there(parts: list[str], value: int) -> None:
    tables: dict[str, Any] = {"z": {"kept": 1}}
    apply_overrides(tables, [parse_override(f"{'.'.join(parts)}={value}")])
    node: Any = tables
    for part in parts:
        node = node[part]
    assert node == value
    assert tables["z"] == {"kept": 1}


def test_an_entry_of_a_list_is_reached_by_its_number() -> None:
    tables: dict[str, Any] = {"events": [{"at_s": 1}, {"at_s": 2}], "tilts": [1, 2]}
    apply_overrides(tables, [parse_override("events.1.at_s=7"), parse_override("tilts.0=9")])
    assert tables == {"events": [{"at_s": 1}, {"at_s": 7}], "tilts": [9, 2]}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("events.2.at_s=1", "events is a list of 1; '2' names none"),
        ("events.x.at_s=1", "'x' names none"),
        ("events.0.at_s.x=1", "events.0.at_s is no table, it holds 1"),
        ("seed.x=1", "seed is no table"),
    ],
)
def test_a_key_that_leads_nowhere_is_refused(text: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        apply_overrides({"events": [{"at_s": 1}], "seed": 3}, [parse_override(text)])


def test_later_changes_win() -> None:
    tables: dict[str, Any] = {}
    apply_overrides(tables, [parse_override("a.b=1"), parse_override("a.b=2")])
    assert tables == {"a": {"b": 2}}
