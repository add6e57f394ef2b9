"""A pair of grey images from what two rows of rays meet: light, lens and noise."""

import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.geometry import Bools, Floats, Ints
from agents.stereo.calibration import Calibration
from agents.stereo.tagmodel import PANEL_CELLS, PANEL_M, is_lid
from sim.stereo.paint import pattern, sampled
from sim.stereo.scene import Met, Moment
from sim.stereo.settings import LensSettings, LightSettings

Grey = NDArray[np.uint8]
GRAINS = 4
"""Points per side of a pixel at which a painted panel is looked at."""
WHITE, LID_WHITE, BLACK = 0.45, 0.27, 0.04
"""Albedos of painted panels. The sun falls on a lid as on the ground: a white one would be brighter
than the image can show, and edges would look shifted towards the dark."""
SKY_GREY = 0.35
"""Radiance of the sky, per strength."""
THING_TEXTURE = 0.7
"""How much of the ground's contrast robots and the landmark have."""


@dataclass(frozen=True)
class Aim:
    """Where a pair of cameras is and looks, world axes less the world's origin."""

    eye_m: Floats
    """(3,) of the left camera."""
    right: Floats
    """(3,) unit vector along image rows."""
    down: Floats
    ahead: Floats


@dataclass(frozen=True)
class Shot:
    """A pair of images, and the truth behind the left one."""

    left: Grey
    right: Grey
    depth_m: Floats
    """(H, W) along the optical axis of the left camera; inf where there is only sky."""
    exposure: float
    """In those of full daylight."""


def aimed(eye_m: Floats, azimuth_rad: float, elevation_rad: float) -> Aim:
    """Return the aim of a camera that stands level: azimuth from +x, elevation from the horizon."""
    ca, sa = math.cos(azimuth_rad), math.sin(azimuth_rad)
    ce, se = math.cos(elevation_rad), math.sin(elevation_rad)
    return Aim(
        eye_m,
        np.array([sa, -ca, 0.0]),
        np.array([ca * se, sa * se, -ce]),
        np.array([ca * ce, sa * ce, se]),
    )


def shoot(
    moment: Moment,
    aim: Aim,
    calibration: Calibration,
    *,
    light: LightSettings,
    lens: LensSettings,
    salt: int,
    rng: np.random.Generator,
    vergence_px: tuple[float, float] = (0.0, 0.0),
) -> Shot:
    """Return a pair of images; the same world, salt and generator state give the same ones.

    `salt` names the pattern on the ground; `vergence_px` is by how much (u, v) the right camera's
    picture is shifted against what the calibration says.
    """
    c = calibration
    left, depth_m = _radiance(moment, aim, c, (c.cx_px, c.cy_px), light, salt)
    eye = aim.eye_m + c.baseline_m * aim.right
    other = Aim(eye, aim.right, aim.down, aim.ahead)
    centre = (c.cx_px + c.doffs_px + vergence_px[0], c.cy_px + vergence_px[1])
    right, _ = _radiance(moment, other, c, centre, light, salt)
    exposure = _exposure(left, np.isfinite(depth_m), lens)
    return Shot(
        _developed(left, exposure, lens, rng),
        _developed(right, exposure, lens, rng),
        depth_m,
        exposure,
    )


def _radiance(
    moment: Moment,
    aim: Aim,
    c: Calibration,
    centre_px: tuple[float, float],
    light: LightSettings,
    salt: int,
) -> tuple[Floats, Floats]:
    """Return the light (H, W) that reaches one camera's pixels, and depth (H, W)."""
    x = (np.arange(c.width_px) - centre_px[0]) / c.focal_px
    y = (np.arange(c.height_px) - centre_px[1]) / c.focal_px
    rays = aim.ahead + x[None, :, None] * aim.right + y[:, None, None] * aim.down
    rays = rays.reshape(-1, 3)
    met = moment.cast(aim.eye_m, rays)
    hit = np.flatnonzero(np.isfinite(met.range_m))
    out = np.full(rays.shape[0], SKY_GREY * light.sky)
    points = aim.eye_m + met.range_m[hit, None] * rays[hit]
    normals = _normals(moment, points, rays, met, hit)
    step = np.column_stack((aim.right, aim.down)).T / c.focal_px
    albedo = _albedo(moment, aim.eye_m, rays, met, hit, points, step, normals, light, salt)
    sun = _sun(light)
    facing = np.einsum("ij,j->i", normals, sun)
    lit = np.flatnonzero(facing > 0) if light.sun > 0 else np.zeros(0, dtype=np.int64)
    direct = np.zeros(hit.size)
    shade = moment.in_shadow(points[lit], normals[lit], sun)
    direct[lit] = np.where(shade, 0.0, facing[lit])
    out[hit] = albedo * (light.sun * direct + light.sky * (0.5 + 0.5 * normals[:, 2]))
    shape = (c.height_px, c.width_px)
    return out.reshape(shape), met.range_m.reshape(shape)


def _sun(light: LightSettings) -> Floats:
    azimuth, elevation = math.radians(light.sun_azimuth_deg), math.radians(light.sun_elevation_deg)
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def _normals(moment: Moment, points: Floats, rays: Floats, met: Met, hit: Ints) -> Floats:
    """Return unit normals (M, 3): of the ground without its triangles' edges, of things by face."""
    u, v = moment.world.cells_at(points)
    east, north = sampled(moment.world.east, u, v), sampled(moment.world.north, u, v)
    up = 1 / np.sqrt(1 + east * east + north * north)
    normals = np.column_stack((-east * up, -north * up, up))
    if moment.things is not None:
        thing = np.flatnonzero(met.face[hit] >= 0)
        outward = moment.face_normals[met.face[hit[thing]]]
        away = np.einsum("ij,ij->i", outward, rays[hit[thing]]) > 0
        normals[thing] = np.where(away[:, None], -outward, outward)
    return normals


def _albedo(
    moment: Moment,
    eye_m: Floats,
    rays: Floats,
    met: Met,
    hit: Ints,
    points: Floats,
    step: Floats,
    normals: Floats,
    light: LightSettings,
    salt: int,
) -> Floats:
    """Return the albedo (M,) of what was met; `step` (2, 3) is from a pixel's ray to the next's."""
    world, things = moment.world, moment.things
    u, v = world.cells_at(points)
    texture = sampled(world.terrain.texture, u, v)
    mean = np.full(hit.size, light.ground_albedo)
    face = met.face[hit]
    if things is not None:
        thing = face >= 0
        mean[thing] = things.albedo[face[thing]]
        texture[thing] = THING_TEXTURE * things.pebbled[face[thing]]
    along = np.linalg.norm(rays[hit], axis=1)
    facing = np.abs(np.einsum("ij,ij->i", rays[hit], normals)) / along
    across = met.range_m[hit] * along * float(np.linalg.norm(step[0]))
    footprint = across / np.sqrt(np.maximum(facing, 0.02))
    albedo = mean * pattern(points + world.origin_m, footprint, texture, salt)
    if things is not None:
        painted: Bools = (face >= 0) & (things.tag[np.maximum(face, 0)] >= 0)
        for k in np.unique(face[painted]):
            mine = np.flatnonzero(face == k)
            albedo[mine] = _painted(
                things.panel[k], int(things.tag[k]), eye_m, rays[hit[mine]], step
            )
    return albedo


@cache
def tag_cells(tag: int) -> Floats:
    """Return the albedos (PANEL_CELLS, PANEL_CELLS) of a panel with its white border."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    black = np.asarray(family.generateImageMarker(tag, PANEL_CELLS - 2, None, 1))
    white = LID_WHITE if is_lid(tag) else WHITE
    return np.pad(np.where(black > 127, white, BLACK), 1, constant_values=white)


def _painted(panel: Floats, tag: int, eye_m: Floats, rays: Floats, step: Floats) -> Floats:
    """Return the mean albedo (M,) of a panel over the pixels of rays (M, 3)."""
    centre, right, down = panel[:3], panel[3:6], panel[6:]
    out = np.cross(down, right)
    cells = tag_cells(tag)
    grains = (np.arange(GRAINS) + 0.5) / GRAINS - 0.5
    total = np.zeros(rays.shape[0])
    for a in grains:
        for b in grains:
            fine = rays + a * step[0] + b * step[1]
            reach = ((centre - eye_m) @ out) / (fine @ out)
            on = eye_m + reach[:, None] * fine - centre
            col = np.floor((on @ right / PANEL_M + 0.5) * PANEL_CELLS)
            row = np.floor((on @ down / PANEL_M + 0.5) * PANEL_CELLS)
            inside = np.clip(np.stack((row, col)), 0, PANEL_CELLS - 1).astype(np.int64)
            total += cells[inside[0], inside[1]]
    return total / GRAINS**2


def _exposure(radiance: Floats, ground: Bools, lens: LensSettings) -> float:
    """Return the exposure that brings the mean of what is not sky to the target."""
    seen = radiance[ground] if ground.any() else radiance
    return min(lens.target_dn / 255 / max(float(seen.mean()), 1e-12), lens.longest_exposure)


def _developed(
    radiance: Floats, exposure: float, lens: LensSettings, rng: np.random.Generator
) -> Grey:
    """Return grey levels: blur of the lens, shot noise, read noise, whole levels."""
    light = radiance.astype(np.float32)
    if lens.blur_px > 0:
        light = np.asarray(cv2.GaussianBlur(light, (0, 0), lens.blur_px), dtype=np.float32)
    electrons = np.minimum(light * np.float32(exposure), 1.5) * np.float32(lens.full_well)
    noise = rng.standard_normal(light.shape, dtype=np.float32)
    electrons += noise * np.sqrt(electrons + np.float32(lens.read_noise**2))
    return np.clip(np.rint(electrons * (255 / lens.full_well)), 0, 255).astype(np.uint8)
