"""What is of caves alone: meshes, and heights of a floor."""

from pathlib import Path

import numpy as np
import trimesh
from occupancy_helpers import small
from run_helpers import run_of

from scenarios.schema import load
from scenarios.scores.occupancy import VoxelTruth, floor_heights
from scenarios.stage import set_stage


def test_a_mesh_can_be_mapped(tmp_path: Path) -> None:
    room = trimesh.creation.box(extents=(7.0, 5.0, 2.5))
    room.export(tmp_path / "room.obj")
    ran = run_of(
        small(
            "cave",
            f"world.cave.file={tmp_path / 'room.obj'}",
            "robots.count=1",
            "planner.max_looks=12",
        ),
        tmp_path / "room",
    )
    assert ran.summary["team"]["coverage"] > 0.8
    assert load(str(ran.out / "scenario.toml")).world.cave.file.endswith("room.obj")


def test_heights_are_of_the_lowest_free_cell() -> None:
    truth = set_stage(small("cave")).truth
    assert isinstance(truth, VoxelTruth)
    free = np.zeros(truth.solid.shape, dtype=bool)
    free[3:5, 1, 2] = True
    heights = floor_heights(free, truth.frame)
    assert np.isnan(heights).sum() == heights.size - 1
    assert heights[1, 2] == truth.frame.z_m + 3 * truth.frame.cell_m
