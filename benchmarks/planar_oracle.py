"""A planner that already knows the map: offline greedy maximum coverage, with free travel."""

import math

import numpy as np

from agents.geometry import Bools, Pose
from agents.planar.casting import first_ray, gains, star_of, windows
from agents.planar.sensing import LIMIT, MAPPED, look_log_odds
from agents.settings import SensorSettings
from sim.planar_world import HEADINGS, PlanarWorld, lattice, look


def oracle_looks(
    world: PlanarWorld,
    observable: Bools,
    sensor: SensorSettings,
    footprint_m: float,
    goal: float,
    *,
    step_m: float = 2.0,
    headings: int = HEADINGS,
) -> int:
    """Return how many noise-free looks map `goal` of the observable cells, the best one each time.

    The looks are those by which observability is defined (2 m lattice, 12 headings) unless
    `step_m` and `headings` say otherwise; each adds what the same sensor model says.
    """
    rays = star_of(sensor, world.frame.cell_m)
    through = np.where(world.solid, 0.0, 1.0)
    eyes = lattice(world, footprint_m, step_m)
    yaws = 2.0 * math.pi * np.arange(headings) / headings
    firsts = np.array([first_ray(float(yaw), rays.width) for yaw in yaws])
    log_odds = np.zeros(world.frame.shape)
    wanted = goal * float(observable.sum())
    count = 0
    while float((observable & (np.abs(log_odds) > MAPPED)).sum()) < wanted:
        short = np.where(observable, np.maximum(MAPPED + 1e-9 - np.abs(log_odds), 0.0), 0.0)
        worth = windows(gains(through, short, rays, eyes), rays.width)[:, firsts]
        place, heading = np.unravel_index(int(np.argmax(worth)), worth.shape)
        x, y = world.frame.centre_of(int(eyes[place, 0]), int(eyes[place, 1]))
        pose = Pose(x, y, 0.0, float(yaws[heading]))
        ranges_m, _ = look(world, pose, sensor, None)
        added = look_log_odds(world.frame, pose, ranges_m, sensor)
        log_odds = np.clip(log_odds + added, -LIMIT, LIMIT)
        count += 1
    return count
