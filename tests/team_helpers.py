"""Small maps and robots without radio or clock, for the laws of layers, stores and sharing."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from agents.geometry import Floats, GridFrame, Pose
from agents.layers import OwnLayer
from agents.maps.elevation import Submap
from agents.maps.elevationlook import LookCells
from agents.maps.planar import PlanarKind, PlanarSubmap
from agents.maps.planarlook import LookOdds
from agents.maps.voxel import Cube, VoxelKind, VoxelOccupancy, VoxelSubmap
from agents.maps.voxellook import VoxelLook
from agents.settings import MapSettings, SharingSettings
from agents.sharing import Desk, Policy, way
from agents.store import AnchorKey, Chunk, Origin, Store, TileKey
from agents.teammap import TeamMap, TileGrid
from agents.voxel.frame import VoxelFrame, VoxelSet
from agents.voxel.tiles import VoxelTiles
from comms.codec import encode_tile

FRAME = GridFrame(10.0, -4.0, 0.5, 20, 24)
GRID = TileGrid(FRAME, 16)
"""Two by two tiles, those at the north and east edge cut."""
SPACE = VoxelFrame(10.0, -4.0, 0.5, 20, 24, -1.0, 20)
"""The same floor plan, in 3-D: two by two by two tiles."""
FRAMES: dict[str, GridFrame] = {"elevation": FRAME, "planar": FRAME, "voxel": SPACE}
GRIDS = {"elevation": GRID, "planar": GRID, "voxel": VoxelTiles(SPACE, 16)}
MAX_ERROR_M = 0.05
SURE = np.diag([1e-6, 1e-6, 1e-6, 1e-8])
START = Pose(16.0, 1.0, 0.0, 0.3)


def truth_m() -> Floats:
    rows, cols = np.indices(FRAME.shape)
    return 0.2 * np.sin(rows / 3.0) + 0.1 * cols


def look(rng: np.random.Generator, sigma_m: float | None = None) -> LookCells:
    """Measure a random rectangle of the truth, with holes, each cell as surely as luck has it."""
    height, width = rng.integers(3, 14, 2)
    row, col = rng.integers(0, FRAME.rows - 3), rng.integers(0, FRAME.cols - 3)
    seen = np.zeros(FRAME.shape, dtype=bool)
    seen[row : row + height, col : col + width] = True
    seen &= rng.random(FRAME.shape) < 0.9
    rows, cols = np.nonzero(seen)
    sigma = np.full(rows.size, sigma_m) if sigma_m else rng.uniform(0.01, 0.3, rows.size)
    noise = rng.normal(size=rows.size) * sigma
    return LookCells(rows, cols, truth_m()[rows, cols] + noise, sigma**2)


def walls() -> np.ndarray:
    rows, cols = np.indices(FRAME.shape)
    return (rows // 5 + cols // 4) % 3 == 0


def planar_look(rng: np.random.Generator) -> LookOdds:
    """Measure a random rectangle of a floor, with holes; always truly, now more and now less so."""
    rows, cols, _, _ = vars(look(rng)).values()
    size = rng.uniform(0.3, 1.5, rows.size)
    return LookOdds(rows, cols, np.where(walls()[rows, cols], size, -size))


def voxel_look(rng: np.random.Generator) -> VoxelLook:
    """Measure a random box of space, with holes; always truly, now more and now less so."""
    size = rng.integers(3, 8, 3)
    low = [int(rng.integers(0, n - 3)) for n in SPACE.voxels]
    seen = np.zeros(SPACE.voxels, dtype=bool)
    seen[tuple(slice(a, a + n) for a, n in zip(low, size, strict=True))] = True
    cells = np.argwhere(seen & (rng.random(seen.shape) < 0.9))
    odds = rng.uniform(0.3, 1.5, len(cells))
    full = walls()[cells[:, 1], cells[:, 2]] | (cells[:, 0] % 9 == 0)
    return VoxelLook(cells, np.where(full, odds, -odds))


LOOKS: dict[str, Any] = {"elevation": look, "planar": planar_look, "voxel": voxel_look}
SUBMAPS: dict[str, Any] = {
    "elevation": Submap, "planar": PlanarSubmap, "voxel": VoxelSubmap,
}  # fmt: skip
KINDS = tuple(LOOKS)


def nowhere(kind: str) -> np.ndarray:
    """Return zeros for all cells of a kind's map."""
    return np.zeros(SPACE.voxels if kind == "voxel" else FRAME.shape)


def cells_of(look: Any) -> tuple[np.ndarray, ...]:
    """Return the indices of one look's cells in `nowhere`."""
    return tuple(look.cells.T) if isinstance(look, VoxelLook) else (look.rows, look.cols)


def mask_of(look: Any) -> Any:
    """Return one look's cells as its kind of map has sets of cells."""
    if isinstance(look, VoxelLook):
        return VoxelSet.of(look.cells)
    mask = np.zeros(FRAME.shape, dtype=bool)
    mask[look.rows, look.cols] = True
    return mask


def laid_out(mask: Any) -> np.ndarray:
    """Return a mask of cells as an array, one of voxels as far as the tiles reach."""
    if not isinstance(mask, VoxelSet):
        return mask
    out = np.zeros(GRIDS["voxel"].cells, dtype=bool)
    out[tuple(mask.cells().T)] = True
    return out


def window_of(kind: str, tile: int) -> tuple[slice, ...]:
    """Return the cells of a tile in `nowhere`."""
    return GRIDS[kind].window(tile)


def known_in(estimate: Any) -> np.ndarray:
    """Return the mask of the cells that an estimate of the whole map knows."""
    if isinstance(estimate, VoxelOccupancy):
        return np.isfinite(estimate.dense(SPACE))
    return estimate.known


def looks_in(estimate: Any) -> np.ndarray:
    """Return the looks behind each cell."""
    if not isinstance(estimate, VoxelOccupancy):
        return estimate.looks
    counts = {b: Cube(c.looks.astype(float), c.looks) for b, c in estimate.cubes.items()}
    return np.nan_to_num(VoxelOccupancy(counts).dense(SPACE))


def certainty(estimate: Any) -> np.ndarray:
    """Return how sure an estimate is of each cell: what adds up over independent looks."""
    if isinstance(estimate, VoxelOccupancy):
        return np.abs(np.nan_to_num(estimate.dense(SPACE)))
    if hasattr(estimate, "log_odds"):
        return np.abs(estimate.log_odds)
    return 1.0 / estimate.variance_m2


def certainty_of(look: Any) -> np.ndarray:
    """Return the same of one look's cells."""
    if isinstance(look, LookOdds | VoxelLook):
        return np.abs(look.log_odds)
    return 1.0 / look.variance_m2


def layer(
    rng: np.random.Generator, looks: int = 3, submaps: int = 1, kind: str = "elevation"
) -> OwnLayer[Any]:
    own = OwnLayer(FRAMES[kind], SUBMAPS[kind])
    for index in range(submaps):
        turned = Pose(START.x_m + index, START.y_m, START.z_m, START.yaw_rad)
        own.begin_submap(turned, SURE * (1 + 10 * index))
        for _ in range(looks):
            own.submaps[-1].observe(LOOKS[kind](rng))
    return own


def payload_of(submap: Any, tile: int) -> bytes:
    if isinstance(submap, VoxelSubmap):
        return VoxelKind().encode(submap, window_of("voxel", tile)).data
    if isinstance(submap, PlanarSubmap):
        return PlanarKind().encode(submap, GRID.window(tile)).data
    elevation, variance = submap.estimate(GRID.window(tile))
    known = np.isfinite(variance)
    sigma = np.sqrt(np.where(known, variance, 0.0))
    return encode_tile(elevation, known, sigma, MAX_ERROR_M).data


def chunks_of(own: OwnLayer[Any], origin: Origin, version: int = 1) -> list[Chunk]:
    """Publish a whole layer."""
    chunks: list[Chunk] = []
    for index, submap in enumerate(own.submaps):
        grid = GRIDS["voxel"] if isinstance(submap, VoxelSubmap) else GRID
        for tile in grid.touched(submap.known):
            data = payload_of(submap, tile)
            chunks.append(Chunk(TileKey(*origin, index, tile), version, len(data), 0, data))
    return chunks


def cut(chunk: Chunk, size: int) -> list[Chunk]:
    """Cut a whole chunk in pieces of a size, in order."""
    return [
        Chunk(chunk.key, chunk.version, chunk.total, at, chunk.data[at : at + size])
        for at in range(0, chunk.total, size)
    ]


def team_map(
    me: Origin,
    own: OwnLayer[Any] | None = None,
    store: Store | None = None,
    policy: str = "value",
    kind: str = "elevation",
) -> TeamMap[Any, Any]:
    chosen = way(policy)
    grid = TileGrid(FRAME, max(FRAME.shape)) if chosen.whole_map else GRIDS[kind]
    own = own or OwnLayer(FRAMES[kind], SUBMAPS[kind])
    cells = MapSettings(kind=kind, max_error_m=MAX_ERROR_M)
    return TeamMap(grid, store or Store(), own, me, chosen.kind(cells))


def hear(team: TeamMap[Any, Any], chunks: Iterable[Chunk]) -> None:
    for chunk in chunks:
        if team.store.offer(chunk):
            team.tile_changed(chunk.key)


def hear_anchors(team: TeamMap[Any, Any], own: OwnLayer[Any], origin: Origin) -> None:
    for index, submap in enumerate(own.submaps):
        if team.store.offer_anchor(AnchorKey(*origin, index), submap.anchor):
            team.own_changed()


def sharing(
    team: TeamMap[Any, Any],
    team_size: int,
    journal: list[Chunk] | None = None,
    settings: SharingSettings | None = None,
) -> Policy:
    kept: list[Chunk] = [] if journal is None else journal
    chosen = settings or SharingSettings()
    desk = Desk(chosen, team.me, team_size, team, kept.append)
    return way(chosen.policy).policy(desk)
