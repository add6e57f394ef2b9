"""The worlds that robots live in, by kind of map."""

from sim.ground import Terrain
from sim.planar_world import PlanarWorld
from sim.voxel.world import VoxelWorld

World = Terrain | PlanarWorld | VoxelWorld
