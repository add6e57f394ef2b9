"""The pages in a real browser: they load without a complaint, time moves, buttons do what they say.

Skipped where no Chromium is installed (Debian's package `chromium` will do).
"""

import threading
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from run_helpers import Ran, run_of, small

from scenarios import runner
from scenarios.schema import load
from scenarios.view.chromium import Tab, browser, find_browser
from scenarios.view.compare import read_all, write_comparison
from scenarios.view.livepage import LivePage
from scenarios.view.report import write_report

PROGRAM = find_browser()
pytestmark = [
    pytest.mark.skipif(PROGRAM is None, reason="no Chromium is installed"),
    pytest.mark.timeout(240),
]
QUICK = ("planner.max_looks=4", "limit_s=300", "map.cell_m=0.4", "sensor.columns=32")
EVENTS = [{"at_s": 60.0, "link": "explorer-1", "up": False}]
READY = "document.documentElement?.dataset.ready"
CHOSEN = "document.querySelector('.choices :checked + span').textContent"
"""Whose map lies over the truth."""
INK = """[...document.querySelector(%r).toDataURL()].reduce(
  (hash, letter) => (31 * hash + letter.charCodeAt(0)) %% 4294967291, 7)"""
"""A number that changes with what is drawn on a canvas."""


def assert_calm(tab: Tab) -> None:
    assert tab.complaints == []


async def shown_s(tab: Tab) -> float:
    return float(await tab.value("document.querySelector('.track input').value"))


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    scenario = small("pair", *QUICK, "links.loss=0.3", events=EVENTS)
    return run_of(scenario, tmp_path_factory.mktemp("run") / "pair")


async def test_a_report_plays_its_run_back(ran: Ran, tmp_path: Path) -> None:
    assert PROGRAM is not None
    report = write_report(ran.out, tmp_path / "r.html")
    compared = write_comparison(read_all([ran.out, ran.out]), tmp_path / "c.html")
    async with browser(PROGRAM) as tab:
        await tab.size(1280, 900)
        await tab.open(report.as_uri())
        await tab.until(READY)
        end_s = ran.summary["simulated_s"]
        assert await shown_s(tab) == pytest.approx(end_s, abs=0.1)
        at_end = [await tab.value(INK % canvas) for canvas in (".world", ".map canvas")]

        await tab.key("Home")
        assert await shown_s(tab) == 0.0
        at_start = [await tab.value(INK % canvas) for canvas in (".world", ".map canvas")]
        assert all(a != b for a, b in zip(at_start, at_end, strict=True))

        await tab.key("ArrowRight")
        assert await shown_s(tab) == 5.0
        await tab.key(" ", " ")
        await tab.until("Number(document.querySelector('.track input').value) > 6")
        await tab.key("End")
        assert [await tab.value(INK % c) for c in (".world", ".map canvas")] == at_end

        for key, whose in (("2", "explorer-2"), ("t", "truth only"), ("0", "all maps")):
            await tab.key(key, key)
            assert await tab.value(CHOSEN) == whose
        await tab.key("?", "?")
        assert await tab.value("document.querySelector('dialog').open")
        await tab.key("2", "2")  # behind the list nothing moves
        assert await tab.value(CHOSEN) == "all maps"
        await tab.value("document.querySelector('dialog button').click()")

        events = await tab.value("document.querySelector('.events').textContent")
        assert "explorer-1: link up = False" in events
        tables = await tab.value("document.querySelector('.tables').textContent")
        assert ran.summary["outcome_reason"] in await tab.value("document.body.textContent")
        assert 'name = "pair"' in tables
        await assert_links_are_told(tab, ran)

        light = await tab.value("getComputedStyle(document.body).backgroundColor")
        await tab.size(390, 800, dark=True, phone=True)
        assert await tab.value("getComputedStyle(document.body).backgroundColor") != light
        await tab.until("document.documentElement.scrollWidth <= 390")  # charts fit a frame later
        assert_calm(tab)

        await tab.open(compared.as_uri())
        await tab.until(f"{READY} && document.title.startsWith('Runs')")
        assert await tab.value("document.querySelectorAll('.chart canvas').length") == 3
        assert_calm(tab)


async def assert_links_are_told(tab: Tab, ran: Ran) -> None:
    """Hold the table of links against the run's own table of frames."""
    sent = [row for row in ran.table("frames") if row["from"] == "explorer-1"]
    heard = [row for row in sent if row["verdict"] == "delivered"]
    assert 0 < len(heard) < len(sent)
    delays_s = sorted(row["arrive_s"] - row["chosen_s"] for row in heard)
    expected = {
        "frames heard": f"{len(heard)} of {len(sent)}",
        "lost, %": f"{100 * (1 - len(heard) / len(sent)):.1f}",
        "heard, kB": f"{sum(row['bytes'] for row in heard) / 1000:.1f}",
        "delay in the middle, s": f"{delays_s[len(delays_s) // 2]:.3f}",
    }
    for measure, told in expected.items():
        await tab.value(f"""(() => {{
          const choice = document.querySelector('.tables select');
          choice.value = '{measure}';
          choice.dispatchEvent(new Event('change'));
        }})()""")
        row = "document.querySelector('[aria-label^=Links] tbody tr').textContent"
        assert await tab.value(row) == f"explorer-1{told}"
    assert "Not heard: " in await tab.value("document.querySelector('.tables').textContent")


@pytest.fixture
def floor(tmp_path: Path) -> Ran:
    sets = ("air=memory", "world.window_m=[16.0, 16.0]", "planner.max_looks=3", "limit_s=300")
    return run_of(load("planar", sets), tmp_path / "floor")


async def test_a_floor_is_shown_too(floor: Ran) -> None:
    assert PROGRAM is not None
    report = write_report(floor.out)
    async with browser(PROGRAM) as tab:
        await tab.open(report.as_uri())
        await tab.until(READY)
        assert "solid" in await tab.value("document.querySelector('.legend').textContent")
        assert_calm(tab)


async def test_a_run_is_watched_and_a_robot_is_killed(tmp_path: Path) -> None:
    assert PROGRAM is not None
    said: list[str] = []
    page = LivePage(opens=False, paused=True, say=said.append)
    outcome: dict[str, Any] = {}

    def run() -> None:
        scenario = small("pair", *QUICK)
        with patch.object(runner, "draw"):
            outcome["of"] = runner.run(scenario, tmp_path / "run", quiet=True, page=page)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        async with browser(PROGRAM) as tab:
            deadline_s = time.monotonic() + 60
            while not said and time.monotonic() < deadline_s:
                time.sleep(0.05)
            await tab.open(said[0].split()[-1])
            await tab.until(READY)
            blank = await tab.value(INK % ".map canvas")
            await tab.value("document.querySelector('.runbar select').value = '60'")
            change = "document.querySelector('.runbar select').dispatchEvent(new Event('change'))"
            await tab.value(change)
            await tab.key(" ", " ")
            await tab.until("Number(document.querySelector('.track input').value) > 40")
            assert await tab.value(INK % ".map canvas") != blank
            await tab.value("document.querySelector('[data-deed=kill]').click()")
            await tab.until("document.querySelector('.events').textContent.includes('kill')")
            await tab.until("document.querySelector('[data-deed=kill]').disabled")
            await tab.value("document.querySelector('.runbar select').value = '0'")
            await tab.value(change)
            await tab.until("document.querySelector('.tables').childElementCount > 0")
            await tab.key("Home")
            assert await shown_s(tab) == 0.0
            assert_calm(tab)
    finally:
        page.close()
        assert page.desk is not None
        page.desk.ask({"do": "go"})
        thread.join(120)
    assert outcome["of"].summary["robots"]["explorer-1"]["state"] == "killed"
    killed = load(str(tmp_path / "run" / "scenario.toml")).timeline()
    assert [(event.kind, event.target) for event in killed] == [("kill", "explorer-1")]
