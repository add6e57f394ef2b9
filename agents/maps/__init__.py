"""Kinds of map behind one protocol: kept, shared and merged alike, each in its own cells.

To add one: a submap and an estimate that answer `agents.maps.kind`, its payloads in
`agents.sharing.WAYS`, its name in `MapSettings.kind` and below, and a mapper that fills it
(`agents.mapper`).
"""

from typing import Any, cast

from agents.maps.elevation import ElevationKind
from agents.maps.kind import MapKind
from agents.maps.planar import PlanarKind
from agents.maps.voxel import VoxelKind
from agents.payloads import OccupancyPayloads, Payloads
from agents.settings import MapSettings

__all__ = ["MapKind", "kind_of"]


def kind_of(settings: MapSettings, payloads: object) -> MapKind[Any, Any]:
    """Return the kind of map that is set; `payloads` is how its tiles are written."""
    if settings.kind == "planar":
        return PlanarKind(cast("OccupancyPayloads", payloads))
    if settings.kind == "voxel":
        return VoxelKind(cast("OccupancyPayloads", payloads))
    return ElevationKind(settings.max_error_m, settings.prior_sigma_m, cast("Payloads", payloads))
