"""The world: terrain, cameras, bodies, faults and the virtual clock."""
