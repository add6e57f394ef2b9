"""Whatever comes off the air is understood whole or refused, within bounds, and breaks nothing.

The targets are those of `fuzz/run.py`, which feeds them for longer. What it has found stands at the
end, each as a test of its own.
"""

import tracemalloc
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import hostile
import hostile_seeds
import hostile_team
import numpy as np
import pytest
from hostile import SENDER, TARGETS, BrokenPromiseError, message_target
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_helpers import Log, settings_of

from agents.geometry import GridFrame
from agents.member import Member
from agents.messages import pack_chunks, pack_fix, unpack_fix
from agents.ports import Hardware
from agents.sharing.reports import Held, Holdings, Report, Section, pack_report
from agents.store import AnchorKey, Chunk, TileKey
from comms.codec import CodecError, decode_grid, decode_tile, encode_tile
from comms.frames import ENVELOPE_BYTES, Frame, Kind

SHORT = 64
"""Bytes of the frame that must not cost much."""
MOST_MB = {"tile": 8.0, "paper": 2.0, "occupancy": 20.0}
"""For arrays of as many cells as there may be in a tile; all else is bytes."""
ALL = {**TARGETS, **hostile_team.TARGETS}
SEEDS = {name: seeds() for name, seeds in hostile_seeds.SEEDS.items()}


def slower(name: str, many: int, some: int) -> int:
    return some if name in ("tile", "paper", "occupancy", "grid", "member") else many


@contextmanager
def memory() -> Generator[Callable[[], float]]:
    """Trace memory; the function that is given returns the most megabytes that were held so far."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        yield lambda: (tracemalloc.get_traced_memory()[1] - before) / 1e6
    finally:
        tracemalloc.stop()


# --- the targets ----------------------------------------------------------------------------


def test_every_target_has_seeds_and_the_other_way_round() -> None:
    assert sorted(SEEDS) == sorted(ALL)
    assert all(SEEDS.values())


@pytest.mark.parametrize("name", sorted(ALL))
def test_any_bytes_are_understood_or_refused(name: str) -> None:
    @given(st.binary(max_size=200))
    @settings(max_examples=slower(name, 150, 30), deadline=None)
    def feed(data: bytes) -> None:
        ALL[name](data)

    feed()


@pytest.mark.parametrize("name", sorted(ALL))
def test_honest_bytes_that_were_altered_are_understood_or_refused(name: str) -> None:
    """Bits flipped, stretches cut out, moved, doubled: near to what a decoder hopes for."""

    @given(st.data())
    @settings(max_examples=slower(name, 150, 40), deadline=None)
    def feed(data: st.DataObject) -> None:
        seed = data.draw(st.sampled_from(SEEDS[name]))
        altered = bytearray(seed + data.draw(st.sampled_from([b"", seed])))
        for _ in range(data.draw(st.integers(1, 4))):
            start = data.draw(st.integers(0, len(altered)))
            end = min(len(altered), start + data.draw(st.integers(0, 8)))
            puts = st.sampled_from([b"", b"\0", b"\xff" * 5, bytes(altered[:3])])
            altered[start:end] = data.draw(puts | st.binary(max_size=4))
        ALL[name](bytes(altered))

    feed()


@pytest.mark.parametrize("name", sorted(ALL))
def test_seeds_keep_all_promises(name: str) -> None:
    for seed in SEEDS[name]:
        ALL[name](seed)


def test_a_member_understands_all_that_is_honest() -> None:
    assert [hostile_team.refusals(seed) for seed in SEEDS["member"]] == [
        [] for _ in SEEDS["member"]
    ]


def test_a_decoder_that_lies_is_noticed() -> None:
    said = SEEDS["fix"][0]
    message_target(unpack_fix, pack_fix)(said)
    with pytest.raises(BrokenPromiseError, match="comes back as"):
        message_target(unpack_fix, lambda fix: pack_fix(replace(fix, robot=fix.robot ^ 1)))(said)
    with pytest.raises(BrokenPromiseError, match="took"):
        hostile.in_time(lambda data: None, limit_s=0.0)(said)
    with pytest.raises(ZeroDivisionError):
        message_target(lambda data: 1 // 0, bytes)(said)


# --- 64 bytes cost little --------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(set(TARGETS) - {"grid"}))
def test_a_short_frame_cannot_make_a_decoder_allocate_much(name: str) -> None:
    payloads = [seed[:SHORT] for seed in SEEDS[name]]
    payloads += [bytes([fill]) * SHORT for fill in range(256)]
    payloads += [bytes([first]) + b"\xff" * (SHORT - 1) for first in range(0, 256, 3)]
    for payload in payloads[:3]:
        ALL[name](payload)
    with memory() as peak_mb:
        for payload in payloads:
            ALL[name](payload)
        assert peak_mb() < MOST_MB.get(name, 0.5)


@pytest.mark.parametrize("fill", [0, 85, 255])
def test_a_short_grid_cannot_claim_more_cells_than_it_could_hold(fill: int) -> None:
    # Not for the air: files. 64 honest bytes may hold a flat grid of almost 4 million cells.
    with memory() as peak_mb:
        for first in range(0, 256, 17):
            try:
                decode_grid(bytes([255, 255, first]) + bytes([fill]) * (SHORT - 3))
            except CodecError:
                continue
        assert peak_mb() < 200


def team_member(side: int) -> Member:
    """Return a robot whose team's grid has side x side cells."""
    plain = settings_of(0)
    frame = GridFrame(0.0, 0.0, 0.1, side, side)
    map_settings = plain.map.model_copy(update={"cell_m": 0.1, "tile_cells": 32})
    big = replace(plain, frame=frame, map=map_settings)
    return Member(big, Hardware(), hostile_team.Nowhere(Path("nowhere")), Log())


def hear(robot: Member, kind: Kind, payload: bytes, number: int = 0) -> None:
    robot.on_frame(Frame(*SENDER, number, kind, payload), (number + 1) * hostile_team.NS)


def many_submaps(data: bytes, total: int) -> bytes:
    """Return the payload of one short frame that begins tiles of as many submaps as fit."""
    chunks: list[Chunk] = []
    while True:
        key = TileKey(*SENDER, len(chunks), 0)
        more = [*chunks, Chunk(key, 1, total, 0, data)]
        if len(pack_chunks(more, SENDER)) > SHORT - ENVELOPE_BYTES:
            return pack_chunks(chunks, SENDER)
        chunks = more


def flat_tile() -> bytes:
    flat = np.zeros((32, 32))
    return encode_tile(flat, np.ones(flat.shape, np.bool_), flat + 0.1, 0.05).data


@pytest.mark.parametrize("whole", [False, True])
def test_a_short_frame_with_the_teams_key_costs_a_member_little(whole: bool) -> None:
    robot = team_member(1024)
    tile = flat_tile()
    payload = many_submaps(tile, len(tile)) if whole else many_submaps(b"?", 1 << 16)
    decode_tile(tile)
    with memory() as peak_mb:
        hear(robot, Kind.MAP, payload)
        assert peak_mb() < 4.0
    assert len(robot.store.keys()) >= 4
    assert log_of(robot).told("refused") == []


def log_of(robot: Member) -> Log:
    assert isinstance(robot.log, Log)
    return robot.log


# --- what the fuzzer found -------------------------------------------------------------------


def test_a_digest_that_tells_of_an_own_submap_that_never_was_breaks_nothing() -> None:
    key = AnchorKey(0, 0, 7)
    held = (Held(1, 1, -1), Held(9, 1, 4))
    told = pack_report(Report((), Holdings(((key, 1),), (Section(key, 0, 3, held),))))
    hostile_team.member_target(hostile_team.as_input([(Kind.DIGEST, 1, told)]))


def test_a_chunk_of_version_0_is_not_taken_for_an_unpublished_one() -> None:
    chunk = Chunk(TileKey(*SENDER, 3, 1), 0, 7, 0, flat_tile())
    said = [(Kind.MAP, 1, pack_chunks([chunk], SENDER))]
    lacking = [(Kind.DIGEST, 2, pack_report(Report((), Holdings((), ()))))] * 3
    hostile_team.member_target(hostile_team.as_input([*said, *lacking]))


def test_a_grid_of_infinite_elevation_is_refused() -> None:
    hostile.grid_target(bytes.fromhex("ffffff3001ff0266ebbb3f0c78"))
