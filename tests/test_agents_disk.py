"""What a robot keeps on disk survives its death at any moment."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from team_helpers import FRAME, chunks_of, layer

from agents.disk import Disk, DiskError
from agents.geometry import Floats, Pose
from agents.layers import Anchor, OwnLayer
from agents.maps.elevation import ElevationKind, Submap
from agents.store import AnchorKey, Chunk, Origin, TileKey

POSE = Pose(1.25, -2.5, 0.125, 0.75)
COVARIANCE: Floats = np.diag([0.1, 0.2, 0.3, 0.4])
KIND = ElevationKind(0.05, 1.0)
OLD = AnchorKey(1, 0, 0)
OLD_ANCHOR = Anchor.at(POSE, (0.1, 0.2, 0.3, 0.4)).moved_to(Pose(1, 2, 3, 0.5), (0.1,) * 4)


def begun(folder: Path) -> Disk:
    disk = Disk(folder)
    disk.begin()
    return disk


def save(disk: Disk, own: OwnLayer, pose: Pose = POSE) -> None:
    disk.save_layer(disk.layer_content(own, pose, COVARIANCE, {OLD: OLD_ANCHOR}))


def some_chunks(count: int, seed: int = 0) -> list[Chunk]:
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 30, count)
    return [
        Chunk(TileKey(1, 0, 0, i), i + 1, int(n), 0, rng.bytes(int(n))) for i, n in enumerate(sizes)
    ]


# --- incarnations ---------------------------------------------------------------------------


def test_every_life_gets_a_number_of_its_own_and_it_is_on_disk_at_once(tmp_path: Path) -> None:
    for life in range(4):
        disk = Disk(tmp_path / "robot")
        assert disk.begin() == life
        assert (tmp_path / "robot" / "incarnation").read_text() == str(life)


def test_a_first_life_finds_nothing(tmp_path: Path) -> None:
    found = begun(tmp_path).recover(FRAME, KIND)
    assert (found.chunks, found.submaps, found.pose, found.anchors) == ([], [], None, {})


@pytest.mark.parametrize("text", ["", "two", "1.5"])
def test_a_spoilt_incarnation_is_refused_and_not_begun_again_from_0(
    tmp_path: Path, text: str
) -> None:
    (tmp_path / "incarnation").write_text(text)
    with pytest.raises(DiskError, match="incarnation"):
        Disk(tmp_path).begin()


# --- the journal ----------------------------------------------------------------------------


@given(st.integers(0, 6), st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_what_was_journalled_is_found_again(
    tmp_path_factory: pytest.TempPathFactory, count: int, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("robot")
    disk = begun(folder)
    chunks = some_chunks(count, seed)
    for chunk in chunks:
        disk.journal(chunk)
    assert begun(folder).recover(FRAME, KIND).chunks == chunks


def test_a_journal_torn_at_any_byte_gives_back_its_whole_records(tmp_path: Path) -> None:
    disk = begun(tmp_path)
    chunks, ends = some_chunks(4), [0]
    for chunk in chunks:
        disk.journal(chunk)
        ends.append((tmp_path / "journal").stat().st_size)
    whole = (tmp_path / "journal").read_bytes()
    after = Chunk(TileKey(1, 1, 0, 0), 1, 3, 0, b"new")
    for length in range(len(whole) + 1):
        (tmp_path / "journal").write_bytes(whole[:length])
        complete = sum(end <= length for end in ends[1:])
        assert Disk(tmp_path).recover(FRAME, KIND).chunks == chunks[:complete]
        # The next life writes behind what is whole: what it publishes is found, too.
        begun(tmp_path).journal(after)
        assert begun(tmp_path).recover(FRAME, KIND).chunks == [*chunks[:complete], after]


def test_a_record_with_a_flipped_bit_ends_the_journal(tmp_path: Path) -> None:
    disk = begun(tmp_path)
    chunks = some_chunks(3)
    for chunk in chunks:
        disk.journal(chunk)
    whole = (tmp_path / "journal").read_bytes()
    for at in range(0, len(whole), 3):
        spoilt = bytearray(whole)
        spoilt[at] ^= 0x10
        (tmp_path / "journal").write_bytes(spoilt)
        found = Disk(tmp_path).recover(FRAME, KIND).chunks
        assert found == chunks[: len(found)]
        assert len(found) < len(chunks)


# --- the layer ------------------------------------------------------------------------------


def test_the_layer_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    own = layer(np.random.default_rng(1), submaps=3)
    own.submaps[1].anchor = own.submaps[1].anchor.moved_to(Pose(1, 2, 3, 0.1), (1e-3,) * 4)
    disk = begun(tmp_path)
    disk.begin()
    for chunk in chunks_of(own, Origin(1, 1)):
        disk.journal(chunk)
    save(disk, own)
    found = begun(tmp_path).recover(FRAME, KIND)
    assert found.pose == POSE
    assert np.array_equal(found.covariance, COVARIANCE)  # pyright: ignore[reportArgumentType]
    assert repr(found.anchors) == repr({OLD: OLD_ANCHOR}), "digests are taken of their text"
    assert [origin for origin, _, _ in found.submaps] == [Origin(1, 1)] * 3
    for index, (_, found_index, submap) in enumerate(found.submaps):
        mine = own.submaps[index]
        assert found_index == index
        assert repr(submap.anchor) == repr(mine.anchor)
        assert np.array_equal(submap.information, mine.information)
        assert np.array_equal(submap.weighted_z, mine.weighted_z)
        assert np.array_equal(submap.looks, mine.looks)


def test_the_layer_is_replaced_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A crash may come before the new file has its name: then the old one is still there."""
    first, second = (layer(np.random.default_rng(seed)) for seed in (1, 2))
    disk = begun(tmp_path)
    save(disk, first)
    seen: list[bytes] = []
    before = (tmp_path / "layer").read_bytes()

    def crash(source: Path, target: Path) -> None:
        seen.append(Path(target).read_bytes())
        raise OSError("the power fails")

    monkeypatch.setattr(os, "replace", crash)
    with pytest.raises(DiskError, match="the power fails"):
        save(disk, second)
    monkeypatch.undo()
    assert seen == [before], "while the new one is written the old one stands"
    found = begun(tmp_path).recover(FRAME, KIND)
    assert np.array_equal(found.submaps[0][2].information, first.submaps[0].information)
    save(disk, second)
    found = begun(tmp_path).recover(FRAME, KIND)
    assert np.array_equal(found.submaps[0][2].information, second.submaps[0].information)


def test_what_is_saved_is_the_layer_as_it_was_when_it_was_asked_for(tmp_path: Path) -> None:
    own = layer(np.random.default_rng(3))
    disk = begun(tmp_path)
    content = disk.layer_content(own, POSE, COVARIANCE, {})
    information = own.submaps[0].information.copy()
    own.submaps[0].information *= 2
    disk.save_layer(content)
    assert np.array_equal(disk.recover(FRAME, KIND).submaps[0][2].information, information)


@pytest.mark.parametrize("keep", [0, 1, 20, -1])
def test_a_spoilt_layer_is_refused_in_one_sentence(tmp_path: Path, keep: int) -> None:
    disk = begun(tmp_path)
    save(disk, layer(np.random.default_rng(4)))
    path = tmp_path / "layer"
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(DiskError, match="is no saved layer"):
        Disk(tmp_path).recover(FRAME, KIND)


def test_a_disk_that_takes_nothing_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    disk = Disk(tmp_path / "file" / "robot")
    with pytest.raises(DiskError, match="robot"):
        disk.journal(some_chunks(1)[0])
    with pytest.raises(DiskError, match="robot"):
        save(disk, OwnLayer(FRAME, Submap))
    with pytest.raises(DiskError, match="robot"):
        disk.begin()
