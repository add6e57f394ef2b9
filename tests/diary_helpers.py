"""A run's folder written by hand: two robots whose maps, ways and frames are known to the digit."""

import math
from pathlib import Path

import numpy as np

from agents.geometry import Floats, GridFrame, Pose
from agents.ports import Exposure
from comms.timebase import NS
from scenarios.logs.diary import Diary, PoseNote
from scenarios.logs.notebook import LogFile
from scenarios.records.folder import MARK
from scenarios.records.tables import DELIVERED, FRAME_COLUMNS, write_table
from scenarios.schema import Scenario, dump, load

FRAME = GridFrame(-1.0, 2.0, 0.25, 9, 13)
GROUND = ("air=memory", "limit_s=100", "sample_s=1")
FLOOR = (*GROUND, "robots.count=2")
ROBOTS = {"elevation": "recon", "planar": "explorer-1"}


def scenario_of(kind: str, *overrides: str) -> Scenario:
    if kind == "elevation":
        return load("cliff", [*GROUND, *overrides])
    return load("planar", [*FLOOR, *overrides])


def grids(kind: str, rng: np.random.Generator) -> dict[str, Floats]:
    """Return a map of which a fifth is unknown."""
    unknown = rng.random(FRAME.shape) < 0.2
    if kind == "planar":
        odds = rng.normal(0.0, 3.0, FRAME.shape)
        return {"log_odds": np.where(unknown, np.nan, odds)}
    z = np.where(unknown, np.nan, rng.normal(-3.0, 1.0, FRAME.shape))
    return {"elevation": z, "sigma": np.where(unknown, np.inf, rng.uniform(0.01, 0.1, FRAME.shape))}


def pose_at(second: int, error_m: float = 0.0) -> Pose:
    angle = 0.1 * second
    return Pose(math.cos(angle) + error_m, math.sin(angle), -0.01 * second, angle)


def written_run(
    folder: Path, kind: str = "elevation", *overrides: str, seconds: int = 60
) -> dict[str, Floats]:
    """Write a run of one robot's log into a folder; return its map at the end."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MARK).touch()
    (folder / "scenario.toml").write_text(dump(scenario_of(kind, *overrides)))
    rng = np.random.default_rng(4)
    log = LogFile(folder / f"{ROBOTS[kind]}.mcap")
    diary = Diary(log, FRAME, 5 * NS)
    last: dict[str, Floats] = {}
    for second in range(seconds + 1):
        note = PoseNote(pose_at(second), pose_at(second, 0.1), 0.01 * np.eye(4), second % 2 == 0)
        diary.pose(second * NS, note)
        if diary.is_due(second * NS):
            last = grids(kind, rng)
            diary.map(second * NS, last)
        if second % 20 == 10:
            points_m = rng.normal(size=(40, 3))
            exposure = Exposure(float(second), 0.1, -0.2, points_m, np.ones(40))
            diary.seen(second * NS, exposure, points_m, pose_at(second, 0.1))
            diary.image(second * NS, np.full((24, 32), second, np.uint8))
    diary.map(seconds * NS, last, whole=True)
    log.close()
    write_frames(folder, ROBOTS[kind])
    return last


def write_frames(folder: Path, sender: str) -> None:
    """Write frames.csv: 30 frames of 100 bytes to each of two mates, one in five lost."""
    rows = [
        (sender, mate, "tile", 100, t, t + 0.5, t + 0.75, t + 1.0 if heard else None, verdict)
        for t in range(30)
        for mate in ("anchor-left", "cliffbot")
        for heard in (t % 5 > 0,)
        for verdict in (DELIVERED if heard else "lost",)
    ]
    write_table(folder / "frames.csv", FRAME_COLUMNS, rows)
