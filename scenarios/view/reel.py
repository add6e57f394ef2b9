"""What a page is told of a run, as it happens: who moved where, how maps grew, what was planned.

The runner keeps it beside its tables. What the tables hold comes from them when a report is made;
the rest is written as `playback.bin` (`scenarios.view.playback`). Rows are short lists, with a
robot's index for its name and seconds for times; `assets/model.js` reads them.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from comms.timebase import to_s
from scenarios.palette import robot_colours
from scenarios.records.tables import EventRow, LookRow, MapRow, Row, RxRow, TxRow
from scenarios.stage import Stage
from scenarios.view.growth import scale_of, truth_of
from scenarios.view.playback import FORMAT, KEPT, Rows, write_playback
from scenarios.wire import Report
from sim.planar_world import PlanarWorld

ROWS = (*KEPT, "looks", "tx", "rx", "maps", "events")


def head_of(stage: Stage) -> dict[str, Any]:
    """Return what is known of a run before its first instant: the world, the team, the scales."""
    scenario, world = stage.scenario, stage.terrain
    scale, frame = scale_of(world), world.frame
    truth = scale.levels(truth_of(world))
    colours = robot_colours(scenario.robots)
    return {
        "format": FORMAT,
        "name": scenario.name,
        "title": scenario.title or scenario.name,
        "seed": scenario.seed,
        "limit_s": scenario.limit_s,
        "kind": "planar" if isinstance(world, PlanarWorld) else "elevation",
        "frame": {
            "x_m": frame.x_m,
            "y_m": frame.y_m,
            "cell_m": frame.cell_m * scale.stride,
            "rows": truth.shape[0],
            "cols": truth.shape[1],
            "stride": scale.stride,
        },
        "scale": {"low": scale.low, "step": scale.step, "most": scale.most},
        "truth": truth.astype("<u2").tobytes(),
        "observable_cells": int(np.count_nonzero(stage.truth.observable)),
        "sensor": {
            "fov_rad": float(np.radians(scenario.sensor.fov_deg)),
            "range_m": scenario.sensor.range_m,
            "near_m": scenario.sensor.near_m,
            "look_s": scenario.sensor.look_s,
        },
        "footprint_m": scenario.drive.footprint_m,
        "goal_m": None if stage.goal_m is None else [float(v) for v in stage.goal_m],
        "robots": [
            {
                "name": name,
                "role": robot.role,
                "colour": colours[name],
                "start": _place(stage.starts[name]),
                "joins_s": scenario.joins_s(name),
            }
            for name, robot in scenario.robots.items()
        ],
    }


class Reel:
    """All that a page is told of one run; rows are only ever added."""

    def __init__(self, stage: Stage) -> None:
        """Begin, before the first instant."""
        self.head = head_of(stage)
        self.rows: Rows = {key: [] for key in ROWS}
        self._index = {name: index for index, name in enumerate(stage.scenario.robots)}

    def take(self, told: Report) -> None:
        """Take what a robot reports of its motion, its plans and its map."""
        me = self._index[told.name]
        for segment in told.segments:
            self.rows["moves"].append(_move(me, segment))
        for t_ns, plan in told.plans:
            self.rows["plans"].append([me, _s(t_ns), plan])
        for t_ns, cells, first, data in told.growth:
            self.rows["growth"].append([me, _s(t_ns), cells, int(first), data])

    def freeze(self, name: str, t_ns: int) -> None:
        """Note that a robot moves no more."""
        self.rows["moves"].append([self._index[name], _s(t_ns)])

    def state(self, name: str, t_s: float, state: str) -> None:
        """Note what became of a robot: alive, stopped, killed, left."""
        self.rows["states"].append([self._index[name], _round(t_s), state])

    def row(self, row: Row) -> None:
        """Take a row of the run's tables."""
        for key, told in rows_of(row, self._index):
            self.rows[key].append(told)

    def since(self, marks: dict[str, int]) -> Rows:
        """Return the rows after the `marks` (how many of each were told), and move these on."""
        fresh: Rows = {}
        for key, rows in self.rows.items():
            begun = marks.get(key, 0)
            if len(rows) > begun:
                fresh[key] = rows[begun:]
                marks[key] = len(rows)
        return fresh

    def write(self, folder: Path) -> None:
        """Write `playback.bin`, whole or not at all: what the tables don't have."""
        write_playback(folder, self.head, self.rows)


def rows_of(row: Row, index: dict[str, int]) -> Iterable[tuple[str, list[Any]]]:
    """Yield a table's row as a page is told it; nothing of what is no robot's."""
    match row:
        case LookRow():
            yield "looks", [
                index[row.robot], _round(row.t_s), _round(row.x_m), _round(row.y_m),
                _round(row.pan_rad), _round(row.expected_cells), row.obtained_cells,
                row.new_cells, _round(row.coverage, 5),
            ]  # fmt: skip
        case TxRow():
            when = (_round(row.start_s), _round(row.end_s), _round(row.chosen_s))
            yield "tx", [index[row.sender], row.seq, row.kind, row.bytes, *when]
        case RxRow():
            to, sender = index[row.receiver], index[row.sender]
            yield "rx", [to, sender, row.seq, _round(row.arrive_s), row.verdict]
        case MapRow():
            error_m = None if row.elevation_rmse_m is None else _round(row.elevation_rmse_m, 4)
            known = (row.map_cells, row.own_cells, row.team_cells)
            yield "maps", [index[row.robot], _round(row.t_s), *known, error_m]
        case EventRow():
            yield "events", [index.get(row.robot, row.robot), _round(row.t_s), row.what, row.detail]


def _move(me: int, segment: Sequence[Any]) -> list[Any]:
    """Return a motion as [robot, start, end, pose, pose, tether, tether]."""
    _, start_ns, end_ns, start, end, tether_start_m, tether_end_m, _ = segment
    poses = [[_round(v) for v in pose] for pose in (start, end)]
    return [me, _s(start_ns), _s(end_ns), *poses, _round(tether_start_m), _round(tether_end_m)]


def _place(pose: Any) -> list[float]:
    return [_round(v) for v in (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad)]


def _s(t_ns: int) -> float:
    return _round(to_s(t_ns))


def _round(value: float, digits: int = 3) -> float:
    return round(float(value), digits)
