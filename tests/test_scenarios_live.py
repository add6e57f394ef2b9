import io
from pathlib import Path

import pytest

from scenarios import live
from scenarios.live import LiveView, RobotNow, Snapshot, clock_text, line
from scenarios.records.report import report
from scenarios.records.tables import Records, TxRow


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def snapshot(t_s: float = 600.0, robots: int = 2) -> Snapshot:
    recon = RobotNow("recon", "recon", "alive", "looking", 3, 4000, 41000, 120_400, 0.87)
    more = [RobotNow(f"robot-{i}", "anchor", "stopped") for i in range(1, robots)]
    return Snapshot(t_s, 7200.0, [recon, *more])


@pytest.mark.parametrize(("t_s", "text"), [(0, "0:00:00"), (59.9, "0:00:59"), (3661, "1:01:01")])
def test_time_is_written_as_people_write_it(t_s: float, text: str) -> None:
    assert clock_text(t_s) == text


def test_a_line_tells_of_every_robot_up_to_a_bound() -> None:
    told = line(snapshot())
    words = ("0:10:00", "2:00:00", "recon 3 looks, 41000 cells, 120.4 kB", "link 87 %", "(stopped)")
    assert all(word in told for word in words)
    assert "and 12 more robots" in line(snapshot(robots=20))


def test_without_a_terminal_there_are_plain_lines_now_and_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = 100.0
    monkeypatch.setattr(live.time, "monotonic", lambda: now_s)
    stream = io.StringIO()
    with LiveView("A cliff", stream=stream) as view:
        view.say("compiling")
        for _ in range(40):
            view.update(snapshot(now_s))
            now_s += 0.5
    lines = stream.getvalue().splitlines()
    assert lines[:2] == ["A cliff", "compiling"]
    assert len(lines) == 2 + 4  # 20 s at one line in 5 s
    assert "\x1b" not in stream.getvalue()


def test_quiet_is_silent() -> None:
    for stream in (io.StringIO(), Terminal()):
        with LiveView("A cliff", quiet=True, stream=stream) as view:
            view.say("compiling")
            view.update(snapshot())
        assert stream.getvalue() == ""


def test_on_a_terminal_a_table_shows_every_robot_and_goes_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    stream = Terminal()
    view = LiveView("A cliff", stream=stream)
    view.start()
    view.update(snapshot())
    shown = stream.getvalue()
    for word in ("A cliff", "0:10:00", "recon", "looking", "41,000", "120.4", "87 %", "stopped"):
        assert word in shown
    view.stop()
    view.stop()
    assert "\x1b[?25h" in stream.getvalue()  # the cursor is back


def summary() -> dict[str, object]:
    robot = {
        "role": "recon",
        "state": "killed",
        "looks": 12,
        "distance_m": 3.25,
        "sent_bytes": 5300,
        "received_bytes": 1000,
        "link_busy_fraction": 0.5,
        "team_cells": 41000,
    }
    team = {
        "observable_cells": 2000,
        "mapped_cells": 1500,
        "coverage": 0.75,
        "elevation_rmse_m": 0.031,
        "elevation_error_p95_m": 0.06,
        "maps_equal": True,
    }
    return {
        "outcome": "complete",
        "outcome_reason": "all is done",
        "simulated_s": 1805.0,
        "robots": {"recon": robot, "cliffbot": {**robot, "state": "alive", "looks": 0}},
        "team": team,
        "mission": {"cliffbot_reached": True, "safe_path_at_s": 640.0, "hazards_hit": 2},
    }


def test_the_report_tells_the_outcome_and_what_bytes_were_spent_on() -> None:
    records = Records(["recon", "cliffbot"])
    records.add(TxRow("recon", 0, "map", 5000, 0, 0, 1))
    records.add(TxRow("recon", 1, "digest", 300, 1, 1, 2))
    records.add(TxRow("cliffbot", 0, "tether", 4700, 1, 1, 2))
    told = report(summary(), records, Path("runs/x"))
    lines = [" ".join(one.split()) for one in told.splitlines()]
    assert lines[0] == "Complete after 0:30:05 simulated: all is done"
    assert "The Cliff-bot got down; safe way found at 0:10:40; it ran into 2 hazards" in lines
    assert "bytes spent on map digest tether" in lines
    assert "recon 5,000 300 0" in lines
    assert "share 50.0 % 3.0 % 47.0 %" in lines
    assert "recon recon killed 12 3.2 m 5.3 kB 1.0 kB 50 % 41,000" in lines
    assert "runs/x" in lines[-1]
    assert "error 0.031 m rms" in told


def test_the_report_of_a_team_that_did_nothing() -> None:
    nothing = summary()
    nothing["mission"] = {}
    nothing["team"] = {
        "observable_cells": 0,
        "coverage": 0.0,
        "elevation_rmse_m": None,
        "elevation_error_p95_m": None,
        "maps_equal": False,
    }
    told = report(nothing, Records(["recon"]), Path("x"))
    assert "Nothing was sent." in told
    assert "the maps differ" in told
    assert "Cliff-bot" not in told
