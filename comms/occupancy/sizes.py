"""How sure a known cell is: the size of its log odds, coded in the contexts of its neighbours'.

A size is three binary choices; one that has a single outcome left, by the sizes that the map has
and the least that the cell was told, costs nothing.
"""

from typing import NamedTuple

from comms.occupancy.classes import TOP, ZERO
from comms.occupancy.field import Palette
from comms.occupancy.judge import Judge, code_judged, judge
from comms.occupancy.priors import opinions
from comms.parts import part, whole
from comms.rangecoder import Coder, Words

_INPUTS = 10
_NODES = 8
_MEANS = 36
_SUMS = 2 * 8 * _MEANS
_PAIRS = 2 * 256
DENSE = (_SUMS + 2 * _PAIRS) * _NODES
"""Models of contexts that are counted, not hashed; the first ones."""
_LIMIT = 400


class Near(NamedTuple):
    """Symbols around a cell; those that are not decided yet count as not known."""

    west: int
    north: int
    third: int
    """North-west in a plane, below in a block."""
    fourth: int
    """North-east."""
    fifth: int
    """West of west in a plane, below to the east in a block."""
    sixth: int
    """North of north in a plane, below to the south in a block."""
    seventh: int
    """North-east of north in a plane, below the one below in a block."""
    eighth: int
    """North-west of west in a plane, north-west in a block."""
    east: int
    south: int


def size_judge(name: str, hash_bits: int) -> Judge:
    """Return the models of the sizes of a kind of map at the start of a payload."""
    slots = DENSE + (1 << hash_bits)
    return judge(opinions(f"{name} sizes", slots, 2 * 8 * _NODES, _INPUTS), 2 * _PAIRS * _NODES)


@part
def _agrees(symbol: int, occupied: int) -> int:
    """Return the size of a neighbour of the same sign, else 0."""
    size = symbol - ZERO if occupied else ZERO - symbol
    return min(max(size, 0), TOP) if symbol else whole(0)


@part
def hashed(key: int, salt: int, mask: int) -> int:
    """Return a number of the bits of `mask` for a context."""
    mixed = (key + 1) * whole(0x9E3779B97F4A7C1) + salt * whole(0x632BE59BD9B4E019)
    mixed ^= mixed >> 29
    mixed *= whole(0x2545F4914F6CDD1D)
    return (mixed >> 32) & mask


@part
def _look(slots: Words, near: Near, mean: int, occupied: int, least: int, mask: int) -> int:
    """Write the first slot of each opinion; return what a plane through three neighbours says."""
    a, b, c, d = near.west, near.north, near.third, near.fourth
    slots[0] = ((occupied * 8 + least) * _MEANS + mean) * _NODES
    slots[1] = (_SUMS + occupied * 256 + a * 16 + b) * _NODES
    slots[2] = (_SUMS + _PAIRS + occupied * 256 + c * 16 + d) * _NODES
    mask &= ~whole(_NODES - 1)
    key = (a * 16 + b) * 16
    slots[3] = DENSE + hashed((key + c) * 16 + d, 1 + occupied, mask)
    slots[4] = DENSE + hashed((key + near.fifth) * 16 + near.sixth, 3 + occupied, mask)
    slots[5] = DENSE + hashed((key + near.east) * 16 + near.south, 5 + occupied, mask)
    key = (c * 16 + d) * 16 + near.sixth
    slots[6] = DENSE + hashed(key * 8 + least, 7 + occupied, mask)
    key = ((a * 16 + b) * 16 + c) * 16 + d
    slots[7] = DENSE + hashed((key * 16 + near.fifth) * 16 + near.sixth, 9 + occupied, mask)
    west, north = _agrees(a, occupied), _agrees(b, occupied)
    low, high = min(west, north), max(west, north)
    plane = min(max(west + north - _agrees(c, occupied), low), high)
    key = (plane * 8 + high - low) * 8 + _agrees(d, occupied)
    slots[8] = DENSE + hashed(key * 8 + least, 11 + occupied, mask)
    key = (b * 16 + d) * 16 + near.seventh
    slots[9] = DENSE + hashed((key * 16 + a) * 16 + near.eighth, 13 + occupied, mask)
    return plane


@part
def code_size(
    coder: Coder,
    sizes: Judge,
    palette: Palette,
    near: Near,
    occupied: int,
    least: int,
    size: int,
) -> int:
    """Code the size of a known cell, at least `least`."""
    allowed = palette.sizes & (255 << least) & (254 if occupied else 255)
    low, node = whole(0), whole(1)
    is_open = allowed & (allowed - 1) != 0
    slots = sizes.opinions.slots
    mean, chosen, first, second = whole(0), whole(0), whole(0), whole(0)
    if is_open:
        mean = _agrees(near.west, occupied) + _agrees(near.north, occupied)
        chosen = (occupied * 8 + (mean >> 1)) * _NODES
        mean += _agrees(near.third, occupied) + _agrees(near.fourth, occupied)
        mean += (_agrees(near.fifth, occupied) + _agrees(near.sixth, occupied)) >> 1
        plane = _look(slots, near, mean, occupied, least, sizes.opinions.models.size - DENSE - 1)
        first = (occupied * 256 + near.west * 16 + near.north) * _NODES
        second = (_PAIRS + occupied * 256 + mean * 7 + plane) * _NODES
    half = whole(4)
    while half:
        smaller = (allowed >> low) & ((1 << half) - 1)
        larger = (allowed >> (low + half)) & ((1 << half) - 1)
        bit = 1 if larger else 0
        if smaller and larger:
            for k in range(_INPUTS):
                slots[k] += node
            bit = 1 if size >= low + half else 0
            bit = code_judged(coder, sizes, chosen + node, first + node, second + node, _LIMIT, bit)
            for k in range(_INPUTS):
                slots[k] -= node
        node = 2 * node + bit
        low += bit * half
        half >>= 1
    return low
