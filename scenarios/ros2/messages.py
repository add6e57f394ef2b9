"""What a run knows, as ROS 2 messages: dicts by field name, for `scenarios.ros2.cdr`.

All is in frame `map`, the team's own (x east, y north, z up, m); stamps are simulated time from the
run's start.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats, GridFrame, Pose, Singles
from comms.timebase import NS
from scenarios.logs.diary import Chart
from scenarios.pictures.shading import hillshade
from scenarios.records.linkwindows import LinkWindow

Message = dict[str, Any]
MAP_FRAME = "map"
UNKNOWN = -1
FLOAT32 = 7
Int8s = NDArray[np.int8]


def stamp(t_ns: int) -> Message:
    """Return a builtin_interfaces/Time."""
    return {"sec": t_ns // NS, "nanosec": t_ns % NS}


def header(t_ns: int, frame: str = MAP_FRAME) -> Message:
    """Return a std_msgs/Header."""
    return {"stamp": stamp(t_ns), "frame_id": frame}


def turned(yaw_rad: float) -> Message:
    """Return a geometry_msgs/Quaternion of a turn about the vertical."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw_rad / 2), "w": math.cos(yaw_rad / 2)}


def _pose(pose: Pose) -> Message:
    return {"position": _xyz(pose), "orientation": turned(pose.yaw_rad)}


def _xyz(pose: Pose) -> Message:
    return {"x": pose.x_m, "y": pose.y_m, "z": pose.z_m}


def _level(x_m: float, y_m: float) -> Message:
    return _pose(Pose(x_m, y_m, 0.0, 0.0))


def transforms(t_ns: int, poses: Sequence[tuple[str, Pose]]) -> Message:
    """Return a tf2_msgs/TFMessage of frames (name, pose) under `map`."""
    told = [
        {
            "header": header(t_ns),
            "child_frame_id": name,
            "transform": {"translation": _xyz(pose), "rotation": turned(pose.yaw_rad)},
        }
        for name, pose in poses
    ]
    return {"transforms": told}


def odometry(t_ns: int, child: str, pose: Pose, covariance: Floats) -> Message:
    """Return a nav_msgs/Odometry; covariance (4, 4) of (x, y, z, yaw).

    The robot is levelled: nothing is known of roll and pitch, and their variance is left 0.
    """
    full = np.zeros((6, 6))
    axes = np.array([0, 1, 2, 5])
    full[np.ix_(axes, axes)] = covariance
    told = {"pose": _pose(pose), "covariance": full}
    return {"header": header(t_ns), "child_frame_id": child, "pose": told}


def path(t_ns: int, poses: Sequence[tuple[int, Pose]]) -> Message:
    """Return a nav_msgs/Path of (time in ns, pose)."""
    told = [{"header": header(at_ns), "pose": _pose(pose)} for at_ns, pose in poses]
    return {"header": header(t_ns), "poses": told}


def occupancy(chart: Chart) -> Int8s:
    """Return a chart as occupancy (rows, cols): int8, -1 unknown, else 0 to 100.

    Of a floor the probability that a cell is solid, in percent; of ground its relief lit from the
    north-west, 0 bright to 100 dark, which is a picture and says nothing of where one can drive.
    """
    odds = chart.layers.get("log_odds")
    if odds is not None:
        share = 1.0 / (1.0 + np.exp(-odds.astype(np.float64)))
        known = np.isfinite(odds)
    else:
        elevation_m = chart.layers["elevation"]
        share = 1.0 - hillshade(elevation_m, chart.frame.cell_m)
        known = np.isfinite(elevation_m)
    return np.where(known, np.round(100.0 * np.nan_to_num(share)), UNKNOWN).astype(np.int8)


def occupancy_grid(t_ns: int, chart: Chart) -> Message:
    """Return a nav_msgs/OccupancyGrid, whose row 0 is south as ours is."""
    frame = chart.frame
    info = {
        "map_load_time": stamp(t_ns),
        "resolution": frame.cell_m,
        "width": frame.cols,
        "height": frame.rows,
        "origin": _level(frame.x_m, frame.y_m),
    }
    return {"header": header(t_ns), "info": info, "data": occupancy(chart)}


def map_points(chart: Chart) -> Singles:
    """Return the known cells of a chart as points (N, 4): x, y, z in m and sigma in m.

    Of a floor the cells that are rather solid than free; sigma is then their probability.
    """
    frame = chart.frame
    odds = chart.layers.get("log_odds")
    with np.errstate(invalid="ignore"):
        shown = np.isfinite(chart.layers["elevation"]) if odds is None else odds > 0
    rows, cols = np.nonzero(shown)
    x_m = frame.x_m + (cols + 0.5) * frame.cell_m
    y_m = frame.y_m + (rows + 0.5) * frame.cell_m
    if odds is None:
        z_m, sigma = chart.layers["elevation"][shown], chart.layers["sigma"][shown]
    else:
        z_m, sigma = np.zeros(rows.size), 1.0 / (1.0 + np.exp(-odds[shown]))
    return np.column_stack((x_m, y_m, z_m, sigma)).astype(np.float32)


def cloud(t_ns: int, points: Singles, names: Sequence[str] = ("x", "y", "z")) -> Message:
    """Return a sensor_msgs/PointCloud2 of points (N, len(names))."""
    fields = [
        {"name": name, "offset": 4 * i, "datatype": FLOAT32, "count": 1}
        for i, name in enumerate(names)
    ]
    count, step = len(points), 4 * len(names)
    return {
        "header": header(t_ns),
        "height": 1,
        "width": count,
        "fields": fields,
        "point_step": step,
        "row_step": step * count,
        "data": points.astype("<f4").tobytes(),
        "is_dense": bool(np.isfinite(points).all()),
    }


def jpeg(t_ns: int, data: bytes) -> Message:
    """Return a sensor_msgs/CompressedImage of a JPEG."""
    return {"header": header(t_ns), "format": "jpeg", "data": data}


def grid_map(t_ns: int, chart: Chart) -> Message:
    """Return a grid_map_msgs/GridMap: cell (0, 0) is the north-east one, columns run south."""
    frame = chart.frame
    layers = [_layer(frame, values) for values in chart.layers.values()]
    west, east, south, north = frame.extent_m
    info = {
        "resolution": frame.cell_m,
        "length_x": east - west,
        "length_y": north - south,
        "pose": _level((west + east) / 2, (south + north) / 2),
    }
    names = list(chart.layers)
    return {
        "header": header(t_ns),
        "info": info,
        "layers": names,
        "basic_layers": names[:1],
        "data": layers,
    }


def _layer(frame: GridFrame, values: Singles) -> Message:
    """Return a layer (rows, cols; row 0 south) as grid_map keeps it, index by index.

    Its first index falls with x, its second with y, and its matrices are written column by column.
    """
    dim = [
        {"label": "column_index", "size": frame.rows, "stride": frame.rows * frame.cols},
        {"label": "row_index", "size": frame.cols, "stride": frame.cols},
    ]
    return {"layout": {"dim": dim}, "data": values[::-1, ::-1]}


def link_statistics(window: LinkWindow) -> Message:
    """Return our own ropeteam_msgs/LinkStatistics: what crossed one link in one window of time."""
    reasons = sorted(window.drops)
    return {
        "header": header(window.end_ns),
        "sender": window.sender,
        "receiver": window.receiver,
        "window_s": window.length_s,
        "frames": window.frames,
        "bytes": window.bytes,
        "delivered_frames": window.delivered_frames,
        "delivered_bytes": window.delivered_bytes,
        "dropped_frames": sum(window.drops.values()),
        "drop_reasons": reasons,
        "drop_counts": [window.drops[reason] for reason in reasons],
        "busy_fraction": window.busy_s / window.length_s,
        "queue_delay_mean_s": _mean(window.queue_delays_s),
        "queue_delay_max_s": max(window.queue_delays_s, default=0.0),
        "latency_mean_s": _mean(window.latencies_s),
        "latency_max_s": max(window.latencies_s, default=0.0),
    }


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else 0.0
