"""Recordings for the tests, their bytes and files written by rosbags, which is not ours."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.geometry import Floats
from comms.timebase import NS, from_s
from scenarios.ros2.cdr import encode
from scenarios.ros2.messages import cloud, header, turned

CLOUD = "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"
ODOMETRY = "nav_msgs/msg/Odometry"
STAMPED = "geometry_msgs/msg/PoseStamped"
FIRST_NS = 1_700_000_000 * NS
"""Clocks of real robots tell the time of day."""
Told = tuple[str, str, float, dict[str, Any]]
"""Topic, type, seconds from the first, message."""


def at_ns(t_s: float) -> int:
    return FIRST_NS + from_s(t_s)


def position(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def pitched(rad: float) -> dict[str, float]:
    return {"x": 0.0, "y": math.sin(rad / 2), "z": 0.0, "w": math.cos(rad / 2)}


def level(yaw_rad: float = 0.0) -> dict[str, float]:
    return turned(yaw_rad)


def transform(
    t_s: float, parent: str, child: str, at: dict[str, float], turn: dict[str, float], topic: str
) -> Told:
    one = {
        "header": header(at_ns(t_s), parent),
        "child_frame_id": child,
        "transform": {"translation": at, "rotation": turn},
    }
    return topic, TF, t_s, {"transforms": [one]}


def odometry(t_s: float, at: dict[str, float], turn: dict[str, float]) -> Told:
    pose = {"pose": {"position": at, "orientation": turn}}
    told = {"header": header(at_ns(t_s), "odom"), "child_frame_id": "base_link", "pose": pose}
    return "/odom", ODOMETRY, t_s, told


def points(t_s: float, frame: str, xyz: Floats, topic: str = "/points") -> Told:
    told = cloud(at_ns(t_s), xyz.astype(np.float32))
    return topic, CLOUD, t_s, told | {"header": header(at_ns(t_s), frame)}


def write_bag(
    folder: Path, told: Iterable[Told], storage: str = "SQLITE3", big: bool = False
) -> Path:
    """Write a ROS 2 bag with rosbags: its own encoder, its own files."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="rosbags is an extra of the tests")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    plugin = getattr(rosbag2.StoragePlugin, storage)
    with rosbag2.Writer(folder, version=9, storage_plugin=plugin) as writer:
        known: dict[str, Any] = {}
        for topic, kind, t_s, message in told:
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            theirs = store.deserialize_cdr(encode(kind, message), kind)
            data = store.serialize_cdr(theirs, kind, little_endian=not big)
            writer.write(known[topic], at_ns(t_s) + 7, data)
    return folder
