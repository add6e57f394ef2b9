"""A robot's plan as bytes, for a computer that shares neither memory nor disk with the runner.

No pickle: what comes over a network is taken apart field by field, and runs nothing.
"""

import io
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import msgpack
import numpy as np

from agents.geometry import GridFrame, Pose
from agents.voxel.frame import VoxelFrame
from scenarios.errors import StudyError
from scenarios.schema import dump, parse
from scenarios.wire import Plan
from sim.ground import Terrain
from sim.planar_world import PlanarWorld
from sim.voxel.world import VoxelWorld
from sim.worlds import World

_PLAIN = (
    "name",
    "goal_m",
    "start_ns",
    "tether_m",
    "first_number",
    "baseline",
    "segments",
    "link_events",
    "trouble_events",
    "keeps_log",
    "keeps_ledger",
)


class PlanError(Exception):
    """What came is no plan of a robot."""


def pack_plan(plan: Plan) -> bytes:
    """Return a plan as bytes; folder, endpoint and wall clock are the receiver's own affair."""
    world = plan.terrain
    arrays: dict[str, Any] = {"observable": plan.observable}
    if isinstance(world, Terrain):
        arrays |= {"elevation_m": world.elevation_m, "texture": world.texture}
        if world.edge_m is not None:
            arrays["edge_m"] = world.edge_m
    else:
        arrays["solid"] = world.solid
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    frame, start = (
        world.frame,
        None if isinstance(world, Terrain) else [int(n) for n in world.start],
    )
    facts: dict[str, Any] = {name: getattr(plan, name) for name in _PLAIN}
    facts |= {
        "scenario": dump(plan.scenario),
        "frame": [frame.x_m, frame.y_m, frame.cell_m, frame.rows, frame.cols],
        "height": [frame.z_m, frame.layers] if isinstance(frame, VoxelFrame) else None,
        "start_cell": start,
        "starts": {name: _pose(pose) for name, pose in plan.starts.items()},
        "landmarks": {name: _pose(pose) for name, pose in plan.landmarks.items()},
        "pose": None if plan.pose is None else _pose(plan.pose),
        "arrays": stream.getvalue(),
    }
    return cast("bytes", msgpack.packb(facts))


def unpack_plan(data: bytes, folder: Path, endpoint: str) -> Plan:
    """Return the plan in `data`, for a robot that keeps its files in `folder`.

    Raises:
        PlanError: there is none in it.

    """
    try:
        facts: dict[str, Any] = msgpack.unpackb(data, use_list=False)
        with np.load(io.BytesIO(facts["arrays"]), allow_pickle=False) as file:
            arrays: dict[str, Any] = {name: file[name] for name in file.files}
        pose = facts["pose"]
        return Plan(
            **{name: facts[name] for name in _PLAIN},
            scenario=parse(tomllib.loads(facts["scenario"]), "the runner's scenario"),
            terrain=_world(facts, arrays),
            observable=arrays["observable"],
            starts={name: Pose(*values) for name, values in facts["starts"].items()},
            landmarks={name: Pose(*values) for name, values in facts["landmarks"].items()},
            pose=None if pose is None else Pose(*pose),
            folder=folder,
            endpoint=endpoint,
        )
    except (ValueError, TypeError, KeyError, EOFError, OSError, StudyError) as error:
        raise PlanError(f"{len(data)} bytes are no plan of a robot: {error}") from error
    except msgpack.exceptions.UnpackException as error:
        raise PlanError(f"{len(data)} bytes are no MessagePack: {error}") from error


def _world(facts: dict[str, Any], arrays: dict[str, Any]) -> World:
    frame, height, start = GridFrame(*facts["frame"]), facts["height"], facts["start_cell"]
    if height is not None:
        return VoxelWorld(VoxelFrame(*facts["frame"], *height), arrays["solid"], start)
    if start is not None:
        return PlanarWorld(frame, arrays["solid"], start)
    return Terrain(frame, arrays["elevation_m"], arrays["texture"], arrays.get("edge_m"))


def _pose(pose: Pose) -> list[float]:
    return [float(getattr(pose, field.name)) for field in fields(pose)]
