"""Whole elevation grids: one level, as small as it gets."""

import numpy as np
from numpy.typing import NDArray

from comms.blocks import block_max, spread
from comms.errors import CodecError
from comms.maskcode import code_mask, mask_opinions
from comms.pyramid import BYTES_PER_CELL, Pyramid, best_profile
from comms.rangecoder import Mark, code_words, decoder, encoder, is_whole
from comms.scales import (
    RAW,
    Bound,
    Fields,
    Scale,
    binary_scale,
    bound_for,
    bounded,
    code_scale,
    exact_scales,
    rounding_m,
    spans_units,
)
from comms.sigmacode import (
    code_of,
    code_sigma_blocks,
    sigma_of,
    sigma_opinions,
)

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

LARGEST_SIDE = 4096
_LARGEST_M = float(np.finfo(np.float32).max)
_SIGMA_BLOCK = 4
_LEAST_BITS_PER_CELL = 1 / 6000
"""Less than a cell can cost, by the least probability of a bit: log2(65536 / 65528)."""
_MANY_CELLS = 1 << 14
_NO_BOUND = Bound(10, 0)


def check_grid(elevation_m: NDArray[np.floating], known: Bools, max_error_m: float) -> Floats:
    """Return the elevations (H, W), float64 and finite everywhere, or say what is wrong."""
    if elevation_m.ndim != 2 or elevation_m.shape != known.shape:
        raise CodecError(f"elevation {elevation_m.shape} and mask {known.shape} must be one grid")
    if not (min(elevation_m.shape) >= 1 and max(elevation_m.shape) <= LARGEST_SIDE):
        raise CodecError(f"a grid of {elevation_m.shape} cells is outside 1x1..4096x4096")
    if not 1e-30 <= max_error_m <= 1e30:
        raise CodecError(f"an error bound of {max_error_m} m is outside 1e-30..1e30 m")
    values = elevation_m.astype(np.float64)
    inside = values[known]
    if not np.isfinite(inside).all():
        raise CodecError("every known cell needs a finite elevation")
    if np.abs(inside).max(initial=0.0) > _LARGEST_M:
        raise CodecError(f"float32 cannot hold an elevation of {np.abs(inside).max():g} m")
    return np.where(known, values, inside[0] if inside.size else 0.0)


def encode_grid(
    elevation_m: NDArray[np.floating],
    known: Bools,
    max_error_m: float,
    *,
    sigma_m: NDArray[np.floating] | None = None,
) -> bytes:
    """Return a payload from which every known cell comes back within `max_error_m`.

    `elevation_m` (H, W) metres, read only where `known` (H, W); 1x1 to 4096x4096 cells.
    `sigma_m` (H, W): standard deviations to go with it, see `decode_grid_sigma`.
    Raises `CodecError` where float32 cannot hold the bound, or the arguments make no sense.
    """
    values = check_grid(elevation_m, known, max_error_m)
    mask = np.ascontiguousarray(known).astype(np.uint8)
    codes = None if sigma_m is None else code_of(sigma_m.astype(np.float64), known)
    for scale, bound in _scales_to_try(values[known], max_error_m):
        data, decoded = _write(values, mask, codes, scale, bound)
        error_m = np.abs(decoded.astype(np.float64) - values)[known]
        if error_m.size == 0 or error_m.max() <= max_error_m:
            return data
    raise CodecError(
        f"float32 cannot hold elevations of up to {np.abs(values[known]).max():g} m "
        f"within {max_error_m:g} m"
    )


def decode_grid(data: bytes) -> tuple[Singles, Bools]:
    """Return elevation (H, W) in metres, NaN where unknown, and the mask of known cells (H, W).

    Raises `CodecError` for bytes that are no payload of `encode_grid`.
    """
    elevation_m, known, _ = decode_grid_sigma(data)
    return elevation_m, known


def decode_grid_sigma(data: bytes) -> tuple[Singles, Bools, Singles | None]:
    """Return what `decode_grid` does, and the standard deviations (H, W) if any were sent.

    They are never below those that were sent: a block of 4 x 4 cells shares its largest, rounded up
    to a half octave. NaN where unknown.
    """
    return _read(Fields(decoder(data)), len(data))


def _scales_to_try(values_m: Floats, max_error_m: float) -> list[tuple[Scale, Bound]]:
    if values_m.size == 0:
        return [(Scale(RAW, 1.0), _NO_BOUND)]
    scales = [(scale, _NO_BOUND) for scale in exact_scales(values_m, max_error_m)]
    digits = 2 if values_m.size < _MANY_CELLS else 4
    bound = bound_for(max_error_m, rounding_m(values_m), digits)
    if bound is not None:
        scales.append((bounded(bound), bound))
    scales.append((binary_scale(values_m, max_error_m), _NO_BOUND))
    usable = [(scale, bound) for scale, bound in scales if spans_units(values_m, scale)]
    return [*usable, (Scale(RAW, 1.0), _NO_BOUND)]


def _write(
    values: Floats,
    mask: NDArray[np.uint8],
    sigma_codes: NDArray[np.int64] | None,
    scale: Scale,
    bound: Bound,
) -> tuple[bytes, Singles]:
    fields = Fields(encoder(values.size * BYTES_PER_CELL))
    rows, cols = values.shape
    fields.bits(12, rows - 1)
    fields.bits(12, cols - 1)
    fields.bits(1, int(bool(mask.any())))
    if mask.any():
        fields.bits(1, int(bool(mask.all())))
        if not mask.all():
            code_mask(fields.coder, mask_opinions("whole"), np.zeros_like(mask), mask)
        if scale.kind != RAW:
            first = values[mask.astype(bool)][0]
            scale = Scale(scale.kind, scale.step_m, round(first / scale.step_m))
        scale, _ = code_scale(fields, scale, bound)
        decoded = _code_values(fields, mask, scale, values)
        _code_sigma(fields, mask, sigma_codes)
    else:
        decoded = np.full(values.shape, np.nan, np.float32)
    return Mark(fields.coder).finish(length_is_known=True), decoded


def _read(fields: Fields, length: int) -> tuple[Singles, Bools, Singles | None]:
    rows, cols = fields.bits(12) + 1, fields.bits(12) + 1
    some = fields.bits(1)
    if some and rows * cols * _LEAST_BITS_PER_CELL > 8 * (length + 16):
        raise CodecError(f"{length} bytes cannot hold {rows} x {cols} cells")
    if not some:
        _refuse_unless_whole(fields, length, rows, cols)
        return np.full((rows, cols), np.nan, np.float32), np.zeros((rows, cols), np.bool_), None
    if fields.bits(1):
        mask = np.ones((rows, cols), np.uint8)
    else:
        mask = np.zeros((rows, cols), np.uint8)
        code_mask(fields.coder, mask_opinions("whole"), mask.copy(), mask)
    scale, _ = code_scale(fields, Scale(RAW, 1.0), _NO_BOUND)
    decoded = _code_values(fields, mask, scale, None)
    known = mask.astype(np.bool_)
    codes = _code_sigma(fields, mask, None)
    _refuse_unless_whole(fields, length, rows, cols)
    elevation_m = np.where(known, decoded, np.float32(np.nan))
    if not np.isfinite(elevation_m[known]).all():
        raise CodecError("an elevation in the bytes is not finite")
    if codes is None:
        return elevation_m, known, None
    return elevation_m, known, np.where(known, sigma_of(codes), np.float32(np.nan))


def _refuse_unless_whole(fields: Fields, length: int, rows: int, cols: int) -> None:
    if not is_whole(fields.coder):
        raise CodecError(f"{length} bytes are not what a grid of {rows} x {cols} cells takes")


def _code_values(
    fields: Fields,
    mask: NDArray[np.uint8],
    scale: Scale,
    values: Floats | None,
) -> Singles:
    """Code the elevations of the known cells; return what a receiver gets of them, (H, W)."""
    if scale.kind == RAW:
        return _code_raw(fields, mask, values)
    y = None if values is None else scale.units(values)
    profile = 0 if y is None or scale.snaps else best_profile(mask, y)
    pyramid = Pyramid.blank(mask.shape, fields.bits(2, profile), snaps=scale.snaps)
    pyramid.code(fields.coder, mask, y)
    return scale.metres(pyramid.cells.x)


def _code_raw(fields: Fields, mask: NDArray[np.uint8], values: Floats | None) -> Singles:
    known = mask.astype(np.bool_)
    decoded = np.full(mask.shape, np.nan, np.float32)
    words = np.zeros(int(known.sum()), np.int64)
    if values is not None:
        with np.errstate(over="ignore"):
            words[:] = values[known].astype(np.float32).view(np.uint32)
    code_words(fields.coder, words)
    decoded[known] = words.astype(np.uint32).view(np.float32)
    return decoded


def _code_sigma(
    fields: Fields, mask: NDArray[np.uint8], codes: NDArray[np.int64] | None
) -> NDArray[np.int64] | None:
    """Code blocks of standard deviations, if there are any; return one code per cell."""
    if not fields.bits(1, int(codes is not None)):
        return None
    rows, cols = mask.shape
    want = block_max(mask.astype(np.int64), _SIGMA_BLOCK).astype(np.uint8)
    blocks = np.zeros(want.shape, np.int64)
    if codes is not None:
        blocks = block_max(codes, _SIGMA_BLOCK)
    code_sigma_blocks(fields.coder, sigma_opinions(), want, np.zeros_like(want), blocks)
    return spread(blocks, _SIGMA_BLOCK, rows, cols)
