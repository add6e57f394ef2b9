"""Voxel maps (3-D): their grid, what rays say of them, where one can stand, where to look next."""
