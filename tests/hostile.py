"""Decoders of what comes off the air, each as one function that takes any bytes whatever.

A target returns if its decoder understood the bytes or refused them as it should, and raises on
anything else: another exception than its own, an answer that breaks its promises, too much time.
Tests feed them by hypothesis; `fuzz/run.py` by coverage, for as long as one likes.
"""

import hashlib
import math
import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from agents.messages import (
    pack_anchor,
    pack_chunks,
    pack_fix,
    pack_status,
    pack_tethers,
    unpack_anchor,
    unpack_chunks,
    unpack_fix,
    unpack_status,
    unpack_tethers,
)
from agents.sharing.reports import pack_report, unpack_report
from agents.store import MAX_PAYLOAD_BYTES
from agents.wire import MessageError
from comms.air import Packet, PacketError
from comms.codec import CodecError, decode_grid_sigma, decode_tile
from comms.frames import (
    MAC_BYTES,
    MAX_FRAME_BYTES,
    MAX_SEQ,
    Frame,
    FrameError,
    Kind,
    Opener,
    ReplayedError,
)
from comms.occupancy.tile import decode_occupancy_tile
from comms.papercode import decode_paper_map

KEY = b"a key of a team!"
TEAM_SIZE = 4
OWN = 0
SENDER = (1, 0)
"""(robot, incarnation) whose frames the payloads come in."""
CPU_LIMIT_S = 1.0
"""No frame's worth of bytes may take longer: some 20 times what the worst takes in fact."""
PAPER_CELLS = 64 * 64
GRID_CPU_LIMIT_S = 8.0
"""A whole grid may be large and flat: 200 honest bytes hold ten million cells."""

T = TypeVar("T")
Target = Callable[[bytes], None]


class BrokenPromiseError(AssertionError):
    """A decoder gave an answer that it should not have given."""


def promise(holds: bool, what: str) -> None:
    if not holds:
        raise BrokenPromiseError(what)


def in_time(target: Target, limit_s: float = CPU_LIMIT_S) -> Target:
    """Hold a target to a limit of processor time."""

    def timed(data: bytes) -> None:
        if took_s(data) >= limit_s:
            again_s = took_s(data)  # the first time a kernel may have been compiled
            promise(again_s < limit_s, f"{len(data)} bytes took {again_s:.2f} s")

    def took_s(data: bytes) -> float:
        start_s = time.process_time()
        target(data)
        return time.process_time() - start_s

    return timed


def sealed(body: bytes) -> bytes:
    """Return a frame with the team's own code, whatever is in it."""
    return body + hashlib.blake2s(body, key=KEY, digest_size=MAC_BYTES, person=b"ropeteam").digest()


def opened(opener: Opener, data: bytes) -> Frame | None:
    """Return the frame in `data`, if there is one; a second time there must be none."""
    try:
        frame = opener.open(data)
    except FrameError:
        return None
    promise(0 <= frame.sender < TEAM_SIZE and frame.sender != OWN, f"sender {frame.sender}")
    promise(frame.kind in set(Kind) and 0 <= frame.seq <= MAX_SEQ, f"{frame.kind} {frame.seq}")
    promise(len(frame.payload) < len(data) <= MAX_FRAME_BYTES, "a payload longer than its frame")
    try:
        opener.open(data)
    except ReplayedError:
        return frame
    raise BrokenPromiseError("a frame was let through twice")


def frame_target(data: bytes) -> None:
    """Open `data` as it comes, and as a robot with the team's key would have sealed it."""
    opener = Opener(KEY, TEAM_SIZE, OWN)
    if opened(opener, data) is not None:
        promise(data == sealed(data[:-MAC_BYTES]), "a frame without the team's code was opened")
    opened(opener, sealed(data))


def message_target(unpack: Callable[[bytes], T], pack: Callable[[T], bytes]) -> Target:
    """A message that is understood is one that could have been said, and means the same again."""

    def target(data: bytes) -> None:
        try:
            message = unpack(data)
        except MessageError:
            return
        again = pack(message)
        promise(unpack(again) == message, f"{message} comes back as {unpack(again)}")
        promise(len(again) <= len(data), f"{len(data)} bytes told more than fits into them")

    return target


def map_target(data: bytes) -> None:
    try:
        chunks = unpack_chunks(data, SENDER)
    except MessageError:
        return
    for chunk in chunks:
        end = chunk.offset + len(chunk.data)
        promise(0 <= chunk.offset < end <= chunk.total <= MAX_PAYLOAD_BYTES, f"chunk {chunk}")
    promise(sum(len(chunk.data) for chunk in chunks) <= len(data), "chunks from nowhere")
    promise(unpack_chunks(pack_chunks(chunks, SENDER), SENDER) == chunks, "chunks changed")


def packet_target(data: bytes) -> None:
    try:
        packet = Packet.from_wire(data)
    except PacketError:
        return
    promise(Packet.from_wire(packet.to_wire()) == packet, f"{packet} came back otherwise")


def tile_target(data: bytes) -> None:
    """Whatever a tile's bytes tell is within bounds, and half of them never tell a later level."""
    try:
        tile = decode_tile(data)
    except CodecError:
        return
    promise(tile.known.shape == tile.elevation_m.shape == tile.sigma_m.shape, "shapes differ")
    promise(max(tile.known.shape) <= 128, f"a tile of {tile.known.shape} cells")
    promise(-1 <= tile.level < max(tile.levels, 1) <= 4, f"level {tile.level} of {tile.levels}")
    promise(bool(np.isfinite(tile.elevation_m[tile.known]).all()), "a known cell is not finite")
    promise(bool(np.isnan(tile.elevation_m[~tile.known]).all()), "an unknown cell is told")
    promise(bool((tile.sigma_m[tile.known] > 0).all()), "a sigma is not positive")
    promise(tile.bound_m > 0 and math.isfinite(tile.bound_m) == bool(tile.known.any()), "bound")
    half = decode_tile(data[: len(data) // 2])
    promise(half.level <= tile.level, f"half tells level {half.level}, the whole {tile.level}")


def grid_target(data: bytes) -> None:
    try:
        elevation_m, known, sigma_m = decode_grid_sigma(data)
    except CodecError:
        return
    promise(elevation_m.shape == known.shape and max(known.shape) <= 4096, f"{known.shape}")
    promise(bool(np.isfinite(elevation_m[known]).all()), "a known cell is not finite")
    promise(bool(np.isnan(elevation_m[~known]).all()), "an unknown cell is told")
    if sigma_m is not None:
        promise(bool((sigma_m[known] > 0).all()), "a sigma is not positive")


def paper_target(data: bytes) -> None:
    try:
        paper = decode_paper_map(data, PAPER_CELLS)
    except CodecError:
        return
    promise(paper.elevation_m.shape == paper.known.shape, "shapes differ")
    promise(paper.known.size <= PAPER_CELLS, f"a map of {paper.known.shape} cells")
    promise(bool(np.isfinite(paper.elevation_m[paper.known]).all()), "a known cell is not finite")
    promise(bool(np.isnan(paper.elevation_m[~paper.known]).all()), "an unknown cell is told")
    if paper.sigma_m is not None:
        promise(bool((paper.sigma_m[paper.known] > 0).all()), "a sigma is not positive")


def occupancy_target(data: bytes) -> None:
    """Whatever the bytes tell is within bounds, and half of them never tell a later level."""
    try:
        tile = decode_occupancy_tile(data)
    except CodecError:
        return
    promise(tile.log_odds.shape == tile.known.shape, "shapes differ")
    promise(tile.known.ndim in (2, 3) and max(tile.known.shape) <= 128, f"{tile.known.shape}")
    promise(bool(np.isfinite(tile.log_odds).all()), "log odds are not finite")
    promise(bool((tile.log_odds[~tile.known] == 0).all()), "an unknown cell is told")
    half = decode_occupancy_tile(data[: len(data) // 2])
    promise(half.level <= tile.level, f"half tells level {half.level}, the whole {tile.level}")


def anchor_pack(message: Any) -> bytes:
    return pack_anchor(*message)


TARGETS: dict[str, Target] = {
    "frame": in_time(frame_target),
    "map": in_time(map_target),
    "anchor": in_time(message_target(unpack_anchor, anchor_pack)),
    "digest": in_time(message_target(unpack_report, pack_report)),
    "status": in_time(message_target(unpack_status, pack_status)),
    "fix": in_time(message_target(unpack_fix, pack_fix)),
    "tether": in_time(message_target(unpack_tethers, pack_tethers)),
    "packet": in_time(packet_target),
    "tile": in_time(tile_target),
    "paper": in_time(paper_target),
    "occupancy": in_time(occupancy_target),
    "grid": in_time(grid_target, GRID_CPU_LIMIT_S),
}
