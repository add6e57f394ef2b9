"""Occupancy in few bytes: planar grids and voxel blocks of log odds, whole or progressive."""
