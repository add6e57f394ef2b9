"""What a robot does alike on planar and on voxel maps, whatever its rays are cast through.

`mapper` tells a look's way into the map and the choice of the next; `matching` finds the pose from
which a look fits the map. What differs, a floor or space, is handed to them as a small object:
`agents.planar.sense` and `agents.voxel.sense`.
"""
