"""What came out of a run: `summary.json` for studies, `host.json` for what it cost the computer.

`summary.json` holds nothing of the computer and no wall time: on the virtual clock it is the same,
byte for byte, for the same scenario and seed.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from agents.geometry import Bools, Singles
from agents.layers import Anchor
from agents.store import AnchorKey
from scenarios.records.tables import Records, write_atomic
from scenarios.schema import Scenario
from scenarios.scores.occupancy import PlanarTruth, score_floor, union_floor

SCHEMA = 1
Outcome = Literal["complete", "partial", "failed"]
State = Literal["alive", "killed", "stopped", "left"]
"""Left: ended by itself before the run did, in whatever way."""


@dataclass(frozen=True)
class RobotFinal:
    """One robot at the end of a run, or when it was last heard of (a killed one)."""

    name: str
    state: State
    own_cells: int
    """Cells that its own sensors measured."""
    team_cells: int
    """Known (origin, submap, cell) entries of its store, its unpublished ones included."""
    digest: str
    """Of its replicated store, in hex."""
    distance_m: float
    """Driven, truly."""
    received_bytes: int
    """Of frames that it got and believed, without the modems' overhead."""
    pose_error_rms_m: float | None = None
    """Of its own estimate over the whole run; None: it never had one to compare."""
    dropped_frames: dict[str, int] = field(default_factory=dict[str, int])
    """By reason."""
    elevation_m: Singles | None = None
    """Team map (H, W), row 0 south, NaN unknown; None: it has none."""
    sigma_m: Singles | None = None
    """Standard deviation (H, W) of the team map's cells."""
    log_odds: Singles | None = None
    """Planar (H, W) or voxel (L, H, W) team map instead, row 0 south, NaN unknown; None: none."""
    payload_bytes: int = 0
    """Of the newest versions in its replicated store."""
    hazards_hit: int = 0
    """Rocks and steps that it came onto, or walls that it ran into."""
    moved: Mapping[AnchorKey, Anchor] = field(default_factory=dict[AnchorKey, Anchor])
    """Submaps that lie elsewhere in its map than they were drawn."""


@dataclass(frozen=True)
class Truth:
    """The world as it is."""

    elevation_m: Singles
    """(H, W), row 0 south, NaN where the world itself knows nothing."""
    observable: Bools
    """(H, W): cells that the team could see from where it can stand."""


@dataclass(frozen=True)
class Ending:
    """How a run ended."""

    simulated_s: float
    outcome: Outcome
    reason: str
    mission: dict[str, bool | int | float | str | None] = field(
        default_factory=dict[str, bool | int | float | str | None]
    )
    """Of a cliff: cliffbot_reached, safe_path_at_s, hazards_hit."""


@dataclass(frozen=True)
class MapScore:
    """How good a map is against the truth."""

    mapped_cells: int
    """Known cells among the observable ones."""
    coverage: float
    """The same as a share of the observable ones; 0 where nothing is observable."""
    rmse_m: float | None
    """Root mean square elevation error over all known cells; None where none is known."""
    p95_m: float | None
    """The absolute error that 95 % of the known cells stay below (or at)."""
    within_3_sigma: float | None
    """Share of the known cells whose error is at most three of their own standard deviations."""


def score(elevation_m: Singles, sigma_m: Singles, truth: Truth) -> MapScore:
    """Return how good a map (H, W; NaN unknown) with its standard deviations (H, W) is."""
    known: Bools = np.isfinite(elevation_m)
    observable = int(truth.observable.sum())
    mapped = int((known & truth.observable).sum())
    apart_m = np.abs(elevation_m.astype(np.float64) - truth.elevation_m.astype(np.float64))
    both: Bools = np.isfinite(apart_m)
    errors, sigmas = apart_m[both], sigma_m[both].astype(np.float64)
    some = errors.size > 0
    return MapScore(
        mapped_cells=mapped,
        coverage=mapped / observable if observable else 0.0,
        rmse_m=math.sqrt(float(np.mean(errors**2))) if some else None,
        p95_m=float(np.percentile(errors, 95)) if some else None,
        within_3_sigma=float(np.mean(errors <= 3.0 * sigmas)) if some else None,
    )


def union_map(robots: Sequence[RobotFinal], shape: tuple[int, int]) -> tuple[Singles, Singles]:
    """Return the union of the robots' team maps: of each cell whichever is surest.

    Elevations (H, W; NaN unknown) and their standard deviations (H, W; inf unknown), in metres.

    Maps are not fused once more: they share their measurements. Of equally sure cells the first
    robot's counts.
    """
    best_m = np.full(shape, np.nan, np.float32)
    best_sigma_m = np.full(shape, np.inf, np.float32)
    for robot in robots:
        if robot.elevation_m is None or robot.sigma_m is None:
            continue
        sigma_m = np.where(np.isfinite(robot.elevation_m), robot.sigma_m, np.inf)
        better = (sigma_m < best_sigma_m) | (np.isnan(best_m) & np.isfinite(robot.elevation_m))
        best_m[better] = robot.elevation_m[better]
        best_sigma_m[better] = sigma_m[better]
    return best_m, best_sigma_m


def survivors(robots: Sequence[RobotFinal]) -> list[RobotFinal]:
    """Return the robots whose maps are the team's: those alive, or all where none is."""
    return [robot for robot in robots if robot.state == "alive"] or list(robots)


def summarise(
    scenario: Scenario,
    records: Records,
    robots: Sequence[RobotFinal],
    truth: Truth | PlanarTruth,
    ending: Ending,
) -> dict[str, Any]:
    """Return what `summary.json` holds.

    The team's map is the union of the survivors' (see `survivors`); `maps_equal` says that all
    robots alive have the same digest. `received_bytes` leaves out the modems' overhead, that
    `sent_bytes` holds.
    """
    heard = Counter(rx.receiver for _, rx in records.deliveries())
    return {
        "schema": SCHEMA,
        "scenario": scenario.name,
        "seed": scenario.seed,
        "clock": scenario.clock.mode,
        "simulated_s": ending.simulated_s,
        "outcome": ending.outcome,
        "outcome_reason": ending.reason,
        "robots": {
            robot.name: {
                "role": scenario.robots[robot.name].role,
                "state": robot.state,
                **_deeds(records, robot, ending.simulated_s),
                "received_frames": heard[robot.name],
                **_knowledge(robot),
            }
            for robot in sorted(robots, key=lambda robot: robot.name)
        },
        "team": _team(robots, truth),
        "mission": dict(ending.mission),
    }


def _deeds(records: Records, robot: RobotFinal, simulated_s: float) -> dict[str, Any]:
    sent = [tx for tx in records.frames if tx.sender == robot.name]
    busy_s = records.busy_s(robot.name, simulated_s)
    return {
        "looks": sum(look.robot == robot.name for look in records.looks),
        "distance_m": robot.distance_m,
        "sent_frames": len(sent),
        "sent_bytes": sum(tx.bytes for tx in sent),
        "link_busy_fraction": busy_s / simulated_s if simulated_s > 0 else 0.0,
    }


def _knowledge(robot: RobotFinal) -> dict[str, Any]:
    return {
        "received_bytes": robot.received_bytes,
        "dropped_frames": dict(sorted(robot.dropped_frames.items())),
        "own_cells": robot.own_cells,
        "team_cells": robot.team_cells,
        "team_map_digest": robot.digest,
        "map_payload_bytes": robot.payload_bytes,
        "pose_error_rms_m": robot.pose_error_rms_m,
        "hazards_hit": robot.hazards_hit,
    }


def _team(robots: Sequence[RobotFinal], truth: Truth | PlanarTruth) -> dict[str, Any]:
    team = survivors(robots)
    return {
        "observable_cells": int(truth.observable.sum()),
        **(_of_floor(team, truth) if isinstance(truth, PlanarTruth) else _of_ground(team, truth)),
        "maps_equal": len({robot.digest for robot in team}) == 1,
    }


def _of_ground(team: Sequence[RobotFinal], truth: Truth) -> dict[str, Any]:
    shape = (truth.elevation_m.shape[0], truth.elevation_m.shape[1])
    result = score(*union_map(team, shape), truth)
    return {
        "mapped_cells": result.mapped_cells,
        "coverage": result.coverage,
        "elevation_rmse_m": result.rmse_m,
        "elevation_error_p95_m": result.p95_m,
        "within_3_sigma": result.within_3_sigma,
    }


def _of_floor(team: Sequence[RobotFinal], truth: PlanarTruth) -> dict[str, Any]:
    maps = [robot.log_odds for robot in team if robot.log_odds is not None]
    result = score_floor(union_floor(maps, truth.solid.shape), truth)
    return {
        "mapped_cells": result.mapped_cells,
        "coverage": result.coverage,
        "wrong_cells": result.wrong_cells,
        "elevation_rmse_m": None,
        "elevation_error_p95_m": None,
        "within_3_sigma": None,
    }


@dataclass(frozen=True)
class ProcessCost:
    """What one process took of the computer."""

    cpu_s: float
    peak_memory_bytes: int
    unique_memory_bytes: int | None = None
    """What it shared with no other process; None: not known."""


@dataclass(frozen=True)
class HostCost:
    """What a run took of the computer; differs from run to run."""

    wall_s: float
    """From the command to the end, compilation excluded."""
    compile_s: float
    """Compiling kernels, where that was needed."""
    startup_s: float
    """From the command to the first granted instant, compilation excluded."""
    grants: int
    """Windows of virtual time that were granted to robots."""
    processes: dict[str, ProcessCost]
    """By robot, and "runner"."""
    launch_s: float = 0.0
    """From the order to start the first robots until all were up."""


def host_facts(cost: HostCost) -> dict[str, Any]:
    """Return what `host.json` holds."""
    return {
        "schema": SCHEMA,
        "wall_s": cost.wall_s,
        "compile_s": cost.compile_s,
        "startup_s": cost.startup_s,
        "launch_s": cost.launch_s,
        "grants": cost.grants,
        "processes": {
            name: {key: value for key, value in asdict(one).items() if value is not None}
            for name, one in sorted(cost.processes.items())
        },
    }


def write_json(path: Path, facts: dict[str, Any]) -> None:
    """Write facts as JSON, whole or not at all; floats in full, what is not finite as null."""
    write_atomic(path, json.dumps(_plain(facts), indent=2, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    """Return the value in types that JSON knows."""
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in cast("dict[Any, Any]", value).items()}
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
