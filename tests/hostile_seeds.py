"""Where a fuzzer begins: for each target, some bytes that a sound robot would have sent."""

from collections.abc import Callable

import numpy as np
from hostile import KEY, SENDER
from hostile_team import as_input
from team_helpers import START, chunks_of, cut, layer

from agents.geometry import Pose
from agents.layers import Anchor
from agents.messages import (
    Fix,
    Status,
    TetherCommand,
    pack_anchor,
    pack_chunks,
    pack_fix,
    pack_status,
    pack_tethers,
)
from agents.sharing.reports import Acks, Held, Holdings, Report, Section, pack_report
from agents.store import AnchorKey, Chunk, Origin
from comms.air import Packet
from comms.codec import encode_grid, encode_tile
from comms.frames import Kind, Sealer
from comms.occupancy.tile import encode_occupancy_tile
from comms.papercode import COMPRESSORS, encode_paper_map

VARIANCE = (0.01, 0.02, 0.03, 0.0001)
ME = Origin(*SENDER)


def ground(rows: int, cols: int, holes: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return elevation, mask and sigma of ground with this share of unknown cells."""
    rng = np.random.default_rng(rows * cols)
    y, x = np.indices((rows, cols))
    elevation_m = np.sin(x / 5.0) + 0.1 * y + 0.02 * rng.standard_normal((rows, cols))
    known = rng.random((rows, cols)) >= holes
    return elevation_m, known, 0.02 + 0.1 * rng.random((rows, cols))


def published() -> list[Chunk]:
    """Return the tiles of a small layer, whole and in pieces."""
    whole = chunks_of(layer(np.random.default_rng(3)), ME)
    return [*whole, *(piece for chunk in whole for piece in cut(chunk, 40))]


def map_seeds() -> list[bytes]:
    chunks = [chunk for chunk in published() if len(chunk.data) < 240]
    packed = [pack_chunks([chunk], sender) for chunk in chunks for sender in (SENDER, (2, 0))]
    return [*packed, pack_chunks([chunk for chunk in chunks if len(chunk.data) <= 40][:4], SENDER)]


def anchor_seeds() -> list[bytes]:
    anchor = Anchor.at(START, VARIANCE)
    moved = anchor.moved_to(Pose(16.2, 0.9, 0.1, 0.31), VARIANCE)
    key = AnchorKey(*SENDER, 0)
    return [pack_anchor(key, anchor), pack_anchor(key, moved)]


def digest_seeds() -> list[bytes]:
    mine, other = AnchorKey(0, 0, 0), AnchorKey(*SENDER, 0)
    held = (Held(0, 1, -1), Held(1, 1, 40), Held(3, 2, 0))
    apart = (Section(other, 0, 3, held[:1]), Section(mine, 1, 2, held[1:2]))
    acks = (Acks(0, 0, 9, ((1, 2), (5, 5))), Acks(2, 1, 200, ((17, 30),)))
    reports = [
        Report(acks),
        Report((), Holdings((), ())),
        Report((), Holdings(((mine, 1),), (Section(mine, 0, 3, held),))),
        Report(acks, Holdings(((mine, 0), (other, 2)), apart, opens=False)),
    ]
    return [pack_report(report) for report in reports]


def status_seeds() -> list[bytes]:
    return [
        pack_status(Status(START, VARIANCE, 1, (12.0, 2.0, 3.0), 0.0)),
        pack_status(Status(START, VARIANCE, 3, None, 4.5, 77, settled=True)),
    ]


def fix_seeds() -> list[bytes]:
    return [pack_fix(Fix(robot, 12.5, START, VARIANCE)) for robot in (0, 2)]


def tether_seeds() -> list[bytes]:
    return [pack_tethers([TetherCommand(0, 3.5, 0.05), TetherCommand(3, 3.0, 0.02)])]


def frame_seeds() -> list[bytes]:
    sealer = Sealer(KEY, *SENDER)
    frames = [sealer.seal(kind, b"payload") for kind in Kind]
    return [*frames, *(frame[:-6] for frame in frames)]


def packet_seeds() -> list[bytes]:
    arrivals = (("cliffbot", 2_000_000_000), ("anchor-left", 2_000_000_001))
    return [
        Packet("recon", 7, 1_000_000_000, 1_900_000_000, arrivals, False, b"frame").to_wire(),
        Packet("anchor-left", 0, 0, 0, (), True, b"").to_wire(),
    ]


def tile_seeds() -> list[bytes]:
    tiles = [
        encode_tile(*ground(side, side, holes), bound_m).data
        for side in (1, 5, 16, 32)
        for holes in (0.0, 0.3, 1.0)
        for bound_m in (0.02, 0.5)
    ]
    return [*tiles, encode_tile(*ground(9, 20, 0.2), 0.1).data]


def grid_seeds() -> list[bytes]:
    seeds: list[bytes] = []
    for rows, cols in ((1, 1), (3, 7), (24, 20)):
        for holes in (0.0, 0.4, 1.0):
            elevation_m, known, sigma_m = ground(rows, cols, holes)
            seeds.append(encode_grid(elevation_m, known, 0.05))
            seeds.append(encode_grid(elevation_m.astype(np.float32), known, 1e-9))  # raw
            seeds.append(encode_grid(np.rint(elevation_m), known, 0.3, sigma_m=sigma_m))
    return seeds


def paper_seeds() -> list[bytes]:
    seeds: list[bytes] = []
    for holes in (0.0, 0.4, 1.0):
        elevation_m, known, sigma_m = ground(24, 20, holes)
        for compressor in COMPRESSORS:
            payload = encode_paper_map(elevation_m, known, 0.05, compressor=compressor)
            seeds.append(payload.data)
        seeds.append(encode_paper_map(elevation_m, known, 0.05, sigma_m=sigma_m).data)
    return seeds


def occupancy_seeds() -> list[bytes]:
    rng = np.random.default_rng(8)
    seeds: list[bytes] = []
    for shape in ((1, 1), (16, 16), (32, 20), (4, 4, 4), (8, 16, 12)):
        for share in (0.0, 0.6, 1.0):
            log_odds = np.cumsum(rng.normal(size=shape), axis=-1)
            seeds.append(encode_occupancy_tile(log_odds, rng.random(shape) < share).data)
    return seeds


def member_seeds() -> list[bytes]:
    """Return conversations: the same payloads, said to a member one after another."""
    said = {
        Kind.MAP: [payload for payload in map_seeds() if len(payload) < 256],
        Kind.ANCHOR: anchor_seeds(),
        Kind.DIGEST: digest_seeds(),
        Kind.STATUS: status_seeds(),
        Kind.FIX: fix_seeds(),
        Kind.TETHER: tether_seeds(),
        Kind.STOP: [b""],
    }
    single = [as_input([(kind, 1, payload)]) for kind, all_ in said.items() for payload in all_]
    maps, anchors, digests = said[Kind.MAP], said[Kind.ANCHOR], said[Kind.DIGEST]
    talk = [(Kind.MAP, 1, maps[0]), (Kind.ANCHOR, 1, anchors[0]), (Kind.DIGEST, 2, digests[3])]
    more = [
        (Kind.ANCHOR, 1, anchors[1]),
        (Kind.MAP, 2, maps[1]),
        (Kind.STATUS, 3, status_seeds()[0]),
    ]
    return [*single, as_input(talk), as_input([*talk, *more]), as_input(more)]


SEEDS: dict[str, Callable[[], list[bytes]]] = {
    "frame": frame_seeds,
    "map": map_seeds,
    "anchor": anchor_seeds,
    "digest": digest_seeds,
    "status": status_seeds,
    "fix": fix_seeds,
    "tether": tether_seeds,
    "packet": packet_seeds,
    "tile": tile_seeds,
    "paper": paper_seeds,
    "occupancy": occupancy_seeds,
    "grid": grid_seeds,
    "member": member_seeds,
}
