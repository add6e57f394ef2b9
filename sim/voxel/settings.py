"""What can be set about a world of cubes."""

from typing import Annotated

from pydantic import Field

from comms.settings import Settings


class CaveSettings(Settings):
    """A cave made from the seed, or a mesh or point cloud, for voxel maps."""

    file: str = ""
    """A mesh or point cloud (.ply, .obj; metres, z up): cells that its surface touches are solid.
    Left out, a cave is made up from the seed."""
    height_m: Annotated[float, Field(ge=2, le=200)] = 7.0
    """Height of a made-up cave's rock."""
    chambers: Annotated[int, Field(ge=1, le=60)] = 5
    """Chambers of a made-up cave, besides its entrance."""
    roughness: Annotated[float, Field(ge=0, le=1)] = 0.4
    """How rough its walls and roofs are."""
    overhangs: Annotated[float, Field(ge=0, le=10)] = 1.5
    """Mean number of overhanging rocks, and of hanging stones, in each chamber."""
