"""Worlds of cubes: made-up caves, voxelised files, and robots in them."""
