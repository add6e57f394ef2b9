"""What a simulated robot is made of, by its plan: hardware, what it is told, what it believes."""

from collections.abc import Callable

import numpy as np

from agents.briefing import AgentSettings
from agents.geometry import Floats, GridFrame, Pose
from agents.planar.rays import fan_rad
from agents.ports import Exposure
from agents.pose.landmarks import Landmark
from agents.stereo.eyes import Seen
from agents.voxel.rays import ray_directions
from scenarios.dice import dice
from scenarios.hostradio import lookahead_ns
from scenarios.recordings import drive_of, recorded
from scenarios.schema import Scenario
from scenarios.wire import Plan
from sim.motion import Motions, Segment
from sim.rig import Rig, make_rig
from sim.stereo.shoot import Shot

START_SIGMA_M = 0.02
START_SIGMA_RAD = 0.004
"""What the team's first localisation leaves unsure of everybody but the origin."""


def motions_of(plan: Plan) -> Motions:
    """Return what is known of everybody's motion when a robot starts."""
    motions = Motions()
    for name, pose in plan.starts.items():
        motions.add(Segment(name, 0, 0, pose, pose))
    for wire in plan.segments:
        motions.add(Segment.from_wire(wire))
    return motions


def rig_of(
    plan: Plan,
    life: int,
    motions: Motions,
    publish: Callable[[Segment], None],
    kept: Callable[[Shot, Seen], None],
) -> Rig:
    """Return a robot's hardware in one of its lives; see `sim.rig.make_rig`."""
    scenario, name = plan.scenario, plan.name
    return make_rig(
        name,
        {mate: robot.role for mate, robot in scenario.robots.items()},
        terrain=plan.terrain,
        landmarks=plan.landmarks,
        meshes={n: m.mesh for n, m in scenario.world.landmarks.items() if m.mesh},
        motions=motions,
        publish=publish,
        delay_ns=lookahead_ns(scenario),
        start=plan.pose or plan.starts[name],
        start_ns=plan.start_ns,
        tether_m=plan.tether_m,
        sensor=scenario.sensor,
        drive=scenario.drive,
        tether=scenario.tether,
        body_rng=dice(scenario, name, "body", life),
        camera_rng=dice(scenario, name, "camera", life),
        light=scenario.world.light,
        ground_salt=scenario.seed,
        led=recorded(scenario, name, plan.starts[name]),
        kept=kept,
    )


def told(plan: Plan) -> AgentSettings:
    """Return what a robot is told before it starts."""
    scenario, frame = plan.scenario, plan.terrain.frame
    roster = tuple(scenario.robots)
    start, covariance = believed_start(scenario, plan.starts, plan.name, frame)
    return AgentSettings(
        name=plan.name,
        index=roster.index(plan.name),
        roster=roster,
        roles=tuple(robot.role for robot in scenario.robots.values()),
        frame=frame,
        start=start,
        start_covariance=covariance,
        goal_m=plan.goal_m,
        method=scenario.method,
        map=scenario.map.model_copy(update={"cell_m": frame.cell_m}),
        sensor=scenario.sensor,
        drive=drive_of(scenario, plan.name),
        planner=scenario.planner,
        sharing=scenario.sharing,
        tether=scenario.tether,
        landmarks=tuple(Landmark(n, pose) for n, pose in sorted(plan.landmarks.items())),
        start_known=scenario.robots[plan.name].start_known,
    )


def believed_start(
    scenario: Scenario, starts: dict[str, Pose], name: str, frame: GridFrame
) -> tuple[Pose, Floats]:
    """Return what a robot believes of its start: the first mapping robot is the team's origin.

    The others were localised against it (section 2.1): a little unsure, and a little wrong. Who
    does not know its start takes the middle of the grid for its own frame's.
    """
    if not scenario.robots[name].start_known:
        west, east, south, north = frame.extent_m
        middle = Pose((west + east) / 2, (south + north) / 2, 0.0, 0.0)
        return middle, np.diag([1e-6, 1e-6, 1e-6, 1e-8])
    origin = next((n for n, r in scenario.robots.items() if r.role == "recon"), next(iter(starts)))
    true = starts[name]
    if name == origin:
        return true, np.diag([1e-6, 1e-6, 1e-6, 1e-8])
    error = dice(scenario, name, "start").normal(size=4)
    sigma = (START_SIGMA_M, START_SIGMA_M, START_SIGMA_M, START_SIGMA_RAD)
    x, y, z, yaw = (float(e) * s for e, s in zip(error, sigma, strict=True))
    believed = Pose(true.x_m + x, true.y_m + y, true.z_m + z, true.yaw_rad + yaw)
    return believed, np.diag([s * s for s in sigma])


def points_of(scenario: Scenario, exposure: Exposure) -> Floats:
    """Return the points (N, 3) of a look, of ranges too, in the levelled robot frame."""
    if not exposure.ranges_m.size:
        return exposure.points_m
    ranges_m, sensor = exposure.ranges_m, scenario.sensor
    if scenario.map.kind == "voxel":
        rays = ray_directions(sensor, exposure.pan_rad, exposure.tilt_rad)
        points_m = ranges_m.reshape(-1, 1) * rays + (0.0, 0.0, sensor.height_m)
        return points_m[np.isfinite(ranges_m.ravel())]
    angles = exposure.pan_rad + fan_rad(sensor)
    flat = (ranges_m * np.cos(angles), ranges_m * np.sin(angles), np.zeros_like(ranges_m))
    return np.column_stack(flat)[np.isfinite(ranges_m)]
