"""How fast visibility is predicted (Eq. 5), beside a plain kernel in the same run.

    python benchmarks/visibility.py [--repeats N]

Made-up Mars-like ground, an eye 1.2 m above it. `plain` walks one ray to each cell of a wedge of 90
degrees, every factor by erfc; ours predict all bearings. CPU time of one core; the ratio in the
same run is what compares between machines. Errors are the largest against the product of every
factor along the same rays. Voxel rays go to each cell of the wedge; OctoMap's `castRay` (if
`pyoctomap` is installed) gets the same rays through the same voxels, its Python call included.
"""

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
from numba import njit

try:
    import pyoctomap
except ImportError:
    pyoctomap = None

from agents import voxelcast
from agents.geometry import Floats, GridFrame, Ints
from agents.sight import visibility
from agents.sight.crests import LEAST_SIGMA_M
from sim.terrain import TerrainSettings, WorldSettings, make_terrain

EYE_M = 1.2
WEDGE_RAD = math.pi / 2
GRIDS = ((0.1, 10.0), (0.1, 15.0), (0.05, 8.0), (0.2, 40.0))
"""Cell size and range, metres."""


def cpu_s(work: Callable[[], object], repeats: int) -> float:
    work()
    times: list[float] = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return float(np.median(times))


@njit(error_model="numpy")
def plain(z, sigma, row, col, eye_z, cells, out):
    """Walk one ray to each cell, steps of one cell along its longer axis, every factor by erfc."""
    for n in range(len(cells)):
        di, dj = cells[n, 0] - row, cells[n, 1] - col
        steps = max(abs(di), abs(dj))
        p = 1.0
        for s in range(1, steps):
            i = math.floor(row + s * di / steps + 0.5)
            j = math.floor(col + s * dj / steps + 0.5)
            ray_z = eye_z + s * (z[cells[n, 0], cells[n, 1]] - eye_z) / steps
            p *= 0.5 * math.erfc((z[i, j] - ray_z) / (sigma[i, j] * math.sqrt(2.0)))
        out[n] = p


@njit(error_model="numpy")
def exact(z, sigma, row, col, eye_z, cell, bearings, least_sigma, cells, out):
    """Multiply every factor along the rays of `agents.sight.visibility`'s fan."""
    for n in range(len(cells)):
        dy, dx = cells[n, 0] - row, cells[n, 1] - col
        flat = math.sqrt(dx * dx + dy * dy)
        turn = math.floor(math.atan2(dy, dx) * bearings / (2 * math.pi) + 0.5) % bearings
        angle = 2 * math.pi * turn / bearings
        rise = (z[cells[n, 0], cells[n, 1]] - eye_z) / (flat * cell)
        p = 1.0
        for k in range(int(flat + 0.5) - 1):
            i = math.floor(row + (k + 1) * math.sin(angle) + 0.5)
            j = math.floor(col + (k + 1) * math.cos(angle) + 0.5)
            clear = eye_z + rise * (k + 1) * cell - z[i, j]
            p *= 0.5 * math.erfc(-clear / (max(sigma[i, j], least_sigma) * math.sqrt(2.0)))
        out[n] = p


class Ground:
    """Made-up ground about an eye, and the cells of the wedge."""

    def __init__(self, cell_m: float, range_m: float) -> None:
        side_m = 2 * range_m + 4 * cell_m
        settings = TerrainSettings(kind="plain", roughness_m=0.3, rock_fraction=0.1)
        world = WorldSettings(window_m=(side_m, side_m), terrain=settings)
        terrain = make_terrain(world, cell_m, np.random.default_rng(1))
        self.frame: GridFrame = terrain.frame
        self.z: Floats = terrain.elevation_m.astype(np.float64)
        self.range_m = range_m
        self.row, self.col = self.frame.rows // 2, self.frame.cols // 2
        x_m, y_m = self.frame.centre_of(self.row, self.col)
        self.eye = (x_m, y_m, float(self.z[self.row, self.col]) + EYE_M)
        rows, cols = np.indices(self.frame.shape)
        dy, dx = rows - self.row, cols - self.col
        flat_m = np.hypot(dy, dx) * cell_m
        self.sigma: Floats = 0.01 + 0.0005 * flat_m**2
        distance_m = np.hypot(flat_m, self.z - self.eye[2])
        apart = np.abs((np.arctan2(dy, dx) - 0.3 + np.pi) % (2 * np.pi) - np.pi)
        self.wedge: Ints = np.argwhere(
            (distance_m <= range_m) & (flat_m > 2 * cell_m) & (apart <= WEDGE_RAD / 2)
        )


def prediction_rows(ground: Ground, repeats: int) -> list[str]:
    frame, wedge = ground.frame, ground.wedge
    at = (ground.z, ground.sigma, ground.row, ground.col, ground.eye[2])
    out, want = np.zeros(len(wedge)), np.zeros(len(wedge))
    bearings, _ = visibility.fan_size(ground.range_m, frame.cell_m)
    exact(*at, frame.cell_m, bearings, LEAST_SIGMA_M, wedge, want)
    base = len(wedge) / cpu_s(lambda: plain(*at, wedge, out), repeats)
    what = f"{frame.cell_m:g} m cells, {ground.range_m:g} m"
    rows = [f"| {what} | plain, own rays | {base / 1e6:.2f} | 1.0 | | {(out > 0.5).mean():.0%} |"]
    laws: tuple[visibility.Law, ...] = ("product", "crest")
    for law in laws:

        def predict(law: visibility.Law = law) -> visibility.Patch:
            return visibility.predict(
                ground.z,
                ground.sigma,
                frame,
                ground.eye,
                range_m=ground.range_m,
                near_m=0.0,
                law=law,
            )

        patch = predict()
        got = patch.p[wedge[:, 0] - patch.row0, wedge[:, 1] - patch.col0]
        rate = int((patch.range_m <= ground.range_m).sum()) / cpu_s(predict, repeats)
        error = f"{np.abs(got - want).max():.1e}" if law == "product" else "another law"
        rows.append(
            f"| {what} | {law} | {rate / 1e6:.2f} | {rate / base:.1f} | {error} "
            f"| {(got > 0.5).mean():.0%} |"
        )
    return rows


def surface_voxels(ground: Ground) -> voxelcast.VoxelBlocks:
    """Return voxels that are full from each cell's height down to its lowest neighbour's."""
    cell_m, z = ground.frame.cell_m, ground.z
    padded = np.pad(z, 1, mode="edge")
    rows, cols = z.shape
    low = np.min([padded[i : i + rows, j : j + cols] for i in range(3) for j in range(3)], axis=0)
    bottom_m = float(z.min()) - cell_m
    layers = math.ceil((max(float(z.max()), ground.eye[2]) - bottom_m) / cell_m) + 2
    top, foot = (np.floor((h - bottom_m) / cell_m).astype(np.int64) for h in (z, low))
    layer = np.arange(layers)[:, None, None]
    full = (layer >= foot) & (layer <= top)
    corner = (ground.frame.x_m, ground.frame.y_m, bottom_m)
    return voxelcast.VoxelBlocks.from_dense(corner, cell_m, full.astype(np.float32), full)


def voxel_rows(ground: Ground, repeats: int) -> list[str]:
    voxels, wedge = surface_voxels(ground), ground.wedge
    frame, cell_m = ground.frame, ground.frame.cell_m
    x_m = frame.x_m + (wedge[:, 1] + 0.5) * cell_m
    y_m = frame.y_m + (wedge[:, 0] + 0.5) * cell_m
    ways = np.column_stack((x_m, y_m, ground.z[wedge[:, 0], wedge[:, 1]])) - np.array(ground.eye)
    rays = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    hits = voxelcast.cast(voxels, ground.eye, rays, ground.range_m)
    ours = len(rays) / cpu_s(
        lambda: voxelcast.cast(voxels, ground.eye, rays, ground.range_m), repeats
    )
    what = f"{cell_m:g} m voxels, {ground.range_m:g} m"
    share = np.isfinite(hits.distance_m).mean()
    rows = [f"| {what} | agents.voxelcast | {ours / 1e6:.2f} | {share:.0%} | |"]
    if pyoctomap is None:
        return [*rows, f"| {what} | OctoMap castRay | left out: pyoctomap is not installed | | |"]
    tree = pyoctomap.OcTree(cell_m)
    for block, row, col in np.argwhere(voxels.index >= 0):
        cells = voxels.cells[voxels.index[block, row, col]]
        corner = np.array((block, row, col)) * voxelcast.SIDE
        for cell in np.argwhere(cells > 0.5):
            centre = np.array(voxels.corner_m) + (corner + cell + 0.5)[::-1] * cell_m
            tree.updateNode(centre, True)
    tree.updateInnerOccupancy()
    eye, end = np.array(ground.eye), np.zeros(3)

    def cast_all() -> int:
        return sum(bool(tree.castRay(eye, ray, end, True, ground.range_m)) for ray in rays)

    met = cast_all() / len(rays)
    theirs = len(rays) / cpu_s(cast_all, min(repeats, 3))
    rows.append(
        f"| {what} | OctoMap castRay | {theirs / 1e6:.3f} | {met:.0%} | {ours / theirs:.0f}x |"
    )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=9)
    repeats = parser.parse_args().repeats
    print("| ground | kernel | M cells/s | ratio | largest error | P > 0.5 |")
    print("|---|---|---:|---:|---:|---:|")
    for cell_m, range_m in GRIDS:
        print("\n".join(prediction_rows(Ground(cell_m, range_m), repeats)), flush=True)
    print("\n| voxels | caster | M rays/s | hit | ours is |")
    print("|---|---|---:|---:|---:|")
    print("\n".join(voxel_rows(Ground(0.1, 15.0), repeats)))


if __name__ == "__main__":
    main()
