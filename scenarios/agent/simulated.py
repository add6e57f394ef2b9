"""A driver without a robot: body and camera on the ground of a scenario, on the real clock.

Options: `scenario` (a name or a file) and `seed`; the ground is that of the scenario with that
seed, so that several agents, each in its own world, map the same ground.
"""

import math

import numpy as np

from agents.geometry import Pose
from agents.ports import Hardware
from scenarios.agent.hardware import Mount
from scenarios.schema import load
from scenarios.stage import set_stage
from sim.ground import Terrain
from sim.motion import Motions, Segment
from sim.rig import make_rig

NO_DELAY_NS = 1


def make(mount: Mount) -> Hardware:
    """Return simulated hardware for a robot that stands where its file says.

    Raises:
        ScenarioError: the scenario can't be used.
        WorldError: nor its ground.

    """
    file = mount.file
    name = str(mount.option("scenario", "pair"))
    beside = mount.beside / name
    changes = [
        f"map.cell_m={file.map.cell_m}",
        f"world.window_m=[{file.frame.cols * file.map.cell_m}, "
        f"{file.frame.rows * file.map.cell_m}]",
    ]
    scenario = load(str(beside) if beside.is_file() else name, changes, mount.option("seed", 1))
    terrain = set_stage(scenario).terrain
    place = file.start
    on_ground = isinstance(terrain, Terrain)
    height_m = terrain.height_m(place.x_m, place.y_m) if on_ground else 0.0
    start = Pose(place.x_m, place.y_m, height_m, math.radians(place.yaw_deg))
    motions = Motions()
    motions.add(Segment(file.name, 0, 0, start, start))
    luck = np.random.default_rng([file.seed, *file.name.encode()]).spawn(2)
    rig = make_rig(
        file.name,
        {file.name: file.role},
        terrain=terrain,
        motions=motions,
        publish=motions.add,
        delay_ns=NO_DELAY_NS,
        start=start,
        start_ns=0,
        tether_m=None,
        sensor=file.sensor,
        drive=file.drive,
        tether=file.tether,
        body_rng=luck[0],
        camera_rng=luck[1],
        light=scenario.world.light,
        ground_salt=scenario.seed,
    )
    return rig.hardware
