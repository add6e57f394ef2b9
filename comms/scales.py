"""How elevations become whole numbers, and how a payload says so in a few bits.

A scale turns metres into units and back. A bounded scale has `STEP_UNITS` units to one step of
twice the error bound; an exact one has steps on which all values of the grid lie already (a terrain
model in whole metres, or values so large that float32 has no finer ones).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.pyramid import STEP_UNITS, Units
from comms.rangecoder import Coder, code_even_bits
from comms.residuals import code_size

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

BOUNDED, DECIMAL, BINARY, RAW = 0, 1, 2, 3
_DECIMALS = (10.0, 5.0, 2.0, 1.0, 0.5, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_SHORT_CODES = 255
SLACKS = (1 / 4096, 1 / 1024, 1 / 256, 1 / 64, 1 / 32, 1 / 16, 1 / 7, 1 / 2)
"""Shares of a bound that can be left to rounding."""
_LARGEST_UNITS = 1 << 44


@dataclass(frozen=True)
class Bound:
    """An error bound that a payload can name: 11 bits for two digits, 34 bits for four.

    The short code holds two digits from 0.001 m up; the long one 16 bits and a decimal exponent.
    `slack` says how much of the bound is left to what float32 rounds away.
    """

    mantissa: int
    exponent: int
    slack: int = 0

    @property
    def step_m(self) -> float:
        """The step that holds the bound, rounding included."""
        return 2 * self.metres * (1 - SLACKS[self.slack])

    @property
    def metres(self) -> float:
        """The bound itself."""
        if self.exponent < 0:
            return self.mantissa / 10.0**-self.exponent
        return self.mantissa * 10.0**self.exponent

    @property
    def short_code(self) -> int:
        """The code of 8 bits, or one that is no code."""
        code = self.mantissa - 10 + 90 * (self.exponent + 4)
        return code if 10 <= self.mantissa < 100 and 0 <= code < _SHORT_CODES else -1


def largest_bound(limit_m: float, digits: int) -> Bound:
    """Return the largest bound of two or four decimal digits that is not above `limit_m`."""
    exponent = math.floor(math.log10(limit_m)) - digits + 1
    for power in (exponent + 1, exponent, exponent - 1):
        mantissa = math.floor(limit_m / 10.0**power * (1 + 1e-12))
        for candidate in (mantissa, mantissa - 1):
            if candidate >= 10 ** (digits - 1) and Bound(candidate, power).metres <= limit_m:
                return Bound(candidate, power)
    raise CodecError(f"an error bound of {limit_m:g} m is too small to be coded")


def bound_for(limit_m: float, rounding: float, digits: int) -> Bound | None:
    """Return the bound to code for a limit, or None if float32 rounds away more than it allows."""
    bound = largest_bound(limit_m, digits)
    for slack, share in enumerate(SLACKS):
        if rounding * (1 + 1e-6) <= bound.metres * share:
            return replace(bound, slack=slack)
    return None


@dataclass(frozen=True)
class Fields:
    """A coder with what headers need of it."""

    coder: Coder

    def bits(self, count: int, value: int = 0) -> int:
        """Code an integer of so many bits."""
        return int(code_even_bits(self.coder, count, value))

    def whole(self, value: int = 0) -> int:
        """Code an integer of either sign."""
        sign = self.bits(1, int(value < 0))
        size = int(code_size(self.coder, abs(value)))
        return -size if sign else size

    def bound(self, value: Bound | None = None) -> Bound:
        """Code an error bound."""
        short = value.short_code if value else -1
        slack = self.bits(3, value.slack if value else 0)
        code = self.bits(8, short if short >= 0 else _SHORT_CODES)
        if code < _SHORT_CODES:
            return Bound(10 + code % 90, code // 90 - 4, slack)
        value = value or Bound(0, 0)
        mantissa = self.bits(16, value.mantissa)
        return Bound(mantissa, self.bits(7, value.exponent + 64) - 64, slack)


@dataclass(frozen=True)
class Scale:
    """Units to metres: elevation = (base * STEP_UNITS + x) * step_m / STEP_UNITS."""

    kind: int
    step_m: float
    base: int = 0

    @property
    def snaps(self) -> bool:
        """Whether decoded values lie on whole steps."""
        return self.kind != BOUNDED

    def units(self, elevation_m: Floats) -> Units:
        """Return what to encode, in whole units from the base."""
        steps = elevation_m / self.step_m
        if self.snaps:
            return (np.rint(steps).astype(np.int64) - self.base) * STEP_UNITS
        return np.rint((steps - self.base) * STEP_UNITS).astype(np.int64)

    def metres(self, x: Units) -> Singles:
        """Return the elevations that a receiver reads, float32."""
        if self.snaps:
            steps = (x // STEP_UNITS + self.base).astype(np.float64)
            return _quietly_single(steps * self.step_m)
        units = (x + self.base * STEP_UNITS).astype(np.float64)
        return _quietly_single(units * (self.step_m / STEP_UNITS))


def _quietly_single(values: Floats) -> Singles:
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def bounded(bound: Bound) -> Scale:
    """Return the scale whose steps are twice the bound, less what rounding takes."""
    return Scale(BOUNDED, bound.step_m)


def rounding_m(values_m: Floats) -> float:
    """Return the largest error that float32 makes of such values."""
    largest = float(np.abs(values_m).max())
    return math.ldexp(1.0, max(math.frexp(largest)[1] - 25, -150)) if largest else 2.0**-150


def spans_units(values_m: Floats, scale: Scale) -> bool:
    """Say whether the values, in this scale, stay within what the integers can hold."""
    spread = float(values_m.max()) - float(values_m.min())
    reach = float(np.abs(values_m).max()) / scale.step_m * STEP_UNITS
    return spread / scale.step_m * STEP_UNITS < _LARGEST_UNITS and reach < 1 << 52


def exact_scales(values_m: Floats, max_error_m: float) -> list[Scale]:
    """Return the scales with steps wider than the bound on which all values lie, widest first."""
    found: list[Scale] = []
    with np.errstate(over="ignore", invalid="ignore"):
        for step_m in _DECIMALS:
            if step_m > 2 * max_error_m:
                scale = Scale(DECIMAL, step_m)
                off = np.abs(np.rint(values_m / step_m) * step_m - values_m).max()
                if off <= min(max_error_m, step_m * 1e-3) and spans_units(values_m, scale):
                    found.append(scale)
    return found[:1]


def binary_scale(values_m: Floats, max_error_m: float) -> Scale:
    """Return the scale of the largest power of two that rounding to float32 leaves alone."""
    exponent = math.floor(math.log2(2 * max_error_m))
    if math.ldexp(1.0, exponent) > 2 * max_error_m:
        exponent -= 1
    finest = math.log2(2 * rounding_m(values_m))
    return Scale(BINARY, math.ldexp(1.0, max(exponent, round(finest))))


def code_scale(fields: Fields, scale: Scale, bound: Bound) -> tuple[Scale, Bound]:
    """Code a scale with its base (and the bound, of a bounded one)."""
    kind = fields.bits(2, scale.kind)
    step_m = 1.0
    if kind == BOUNDED:
        bound = fields.bound(bound)
        step_m = bound.step_m
    elif kind == DECIMAL:
        index = _DECIMALS.index(scale.step_m) if scale.kind == DECIMAL else 0
        index = fields.bits(4, index)
        if index >= len(_DECIMALS):
            raise CodecError(f"step {index} is not one of the {len(_DECIMALS)} decimal steps")
        step_m = _DECIMALS[index]
    elif kind == BINARY:
        exponent = math.frexp(scale.step_m)[1] - 1 if scale.kind == BINARY else 0
        step_m = math.ldexp(1.0, fields.bits(9, exponent + 200) - 200)
    base = fields.whole(scale.base) if kind != RAW else 0
    if step_m <= 0 or not math.isfinite(step_m):
        raise CodecError(f"a step of {step_m} m is not possible")
    return Scale(kind, step_m, base), bound
