"""What a robot keeps on disk survives its death at any moment."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_helpers import Log, hear, measure, robot_on, say, settings_of
from robot_helpers import save as save_robot
from team_helpers import FRAME, chunks_of, layer, look

from agents.disk import Disk, DiskError
from agents.files import LocalFiles
from agents.geometry import Floats, Pose
from agents.layers import Anchor, OwnLayer
from agents.maps.elevation import ElevationKind, Submap
from agents.messages import pack_chunks
from agents.ports import Hardware
from agents.robot import Robot
from agents.store import AnchorKey, Chunk, Origin, TileKey
from comms.frames import Kind

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


def test_a_flipped_bit_costs_its_own_record_and_is_told(tmp_path: Path) -> None:
    """What was published is not all known then: the layer's cells might be counted twice."""
    disk = begun(tmp_path)
    chunks, own = some_chunks(4), layer(np.random.default_rng(5))
    for chunk in chunks:
        disk.journal(chunk)
    save(disk, own)
    whole = (tmp_path / "journal").read_bytes()
    for at in range(0, len(whole), 3):
        spoilt = bytearray(whole)
        spoilt[at] ^= 0x10
        (tmp_path / "journal").write_bytes(spoilt)
        found = Disk(tmp_path).recover(FRAME, KIND)
        assert [c for c in chunks if c in found.chunks] == found.chunks
        assert len(found.chunks) < len(chunks)
        if found.chunks == chunks[:3]:
            continue  # the last one looks like what a crash leaves
        assert found.submaps == []
        assert "the journal was spoilt" in found.problems[0]
        assert found.pose == POSE


def test_cells_that_may_have_been_published_stay_behind_for_good(tmp_path: Path) -> None:
    disk = begun(tmp_path)
    for chunk in some_chunks(3):
        disk.journal(chunk)
    save(disk, layer(np.random.default_rng(5)))
    spoilt = bytearray((tmp_path / "journal").read_bytes())
    spoilt[10] ^= 1
    (tmp_path / "journal").write_bytes(spoilt)
    begun(tmp_path)  # finds it out, and dies before it has saved a layer of its own
    after = Chunk(TileKey(1, 2, 0, 0), 1, 3, 0, b"new")
    last = begun(tmp_path)
    last.journal(after)
    found = last.recover(FRAME, KIND)
    assert found.chunks == [*some_chunks(3)[1:], after]
    assert found.submaps == []


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
def test_a_spoilt_layer_is_told_in_one_sentence_and_the_rest_taken(
    tmp_path: Path, keep: int
) -> None:
    disk = begun(tmp_path)
    save(disk, layer(np.random.default_rng(4)))
    path = tmp_path / "layer"
    path.write_bytes(path.read_bytes()[:keep])
    disk.journal(some_chunks(1)[0])
    found = Disk(tmp_path).recover(FRAME, KIND)
    assert "is no saved layer" in found.problems[0]
    assert (found.chunks, found.submaps) == (some_chunks(1), []), "the journal is whole"


def test_a_disk_that_takes_nothing_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    disk = Disk(tmp_path / "file" / "robot")
    with pytest.raises(DiskError, match="robot"):
        disk.journal(some_chunks(1)[0])
    with pytest.raises(DiskError, match="robot"):
        save(disk, OwnLayer(FRAME, Submap))
    with pytest.raises(DiskError, match="robot"):
        disk.begin()


# --- a disk that refuses, and death at any write ----------------------------------------------


class Died(BaseException):
    """The process was killed."""


class Mortal(LocalFiles):
    """Files of a process that is killed at its n-th write: before, half way, or right after it."""

    def __init__(self, nth: int, share: float) -> None:
        self.left, self.share = nth, share

    def append(self, path: Path, data: bytes) -> None:
        self._write(lambda: super(Mortal, self).append(path, data[: int(len(data) * self.share)]))
        super().append(path, data)

    def replace(self, path: Path, data: bytes, *, durable: bool = False) -> None:
        def part() -> None:
            if self.share == 1.0:
                super(Mortal, self).replace(path, data, durable=durable)
            elif self.share > 0.0:
                path.parent.mkdir(parents=True, exist_ok=True)
                part_of = data[: int(len(data) * self.share)]
                path.with_name(f".{path.name}.part").write_bytes(part_of)

        self._write(part)
        super().replace(path, data, durable=durable)

    def _write(self, last: Callable[[], None]) -> None:
        self.left -= 1
        if self.left < 0:
            last()
            raise Died


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_robot_killed_at_any_write_comes_back_with_a_whole_and_recent_layer(
    tmp_path: Path, share: float
) -> None:
    layers = [layer(np.random.default_rng(seed)) for seed in range(3)]
    chunks = some_chunks(6)
    for nth in range(100):
        folder = tmp_path / str(nth)
        disk = Disk(folder, Mortal(nth, share))
        published, saved = 0, -1
        try:
            disk.begin()
            for index, own in enumerate(layers):
                for chunk in chunks[2 * index : 2 * index + 2]:
                    disk.journal(chunk)
                    published += 1
                save(disk, own)
                saved = index
        except Died:
            pass
        else:
            break
        disk = Disk(folder)
        life = disk.begin()
        assert life == (1 if published or saved >= 0 or nth > 0 or share == 1.0 else 0)
        found = disk.recover(FRAME, KIND)
        assert found.problems == []
        assert found.chunks in (chunks[:published], chunks[: published + (share == 1.0)])
        back = [submap.information for _, _, submap in found.submaps]
        had = [[]] + [[own.submaps[0].information] for own in layers]
        recent = had[saved + 1 : saved + 2 + (share == 1.0)]
        assert any(np.array_equal(np.array(back), np.array(one)) for one in recent)
        disk.journal(chunks[5])
        assert begun(folder).recover(FRAME, KIND).chunks[-1] == chunks[5]
    assert nth == 10, "a begin, six records, three layers"


class Full(LocalFiles):
    """A disk that takes half of a record, and then nothing, until there is room again."""

    def __init__(self) -> None:
        self.room = False

    def append(self, path: Path, data: bytes) -> None:
        super().append(path, data if self.room else data[: len(data) // 2])
        if not self.room:
            raise OSError("no space left")

    def replace(self, path: Path, data: bytes, *, durable: bool = False) -> None:
        if not self.room:
            raise OSError("no space left")
        super().replace(path, data, durable=durable)


def test_a_part_of_a_record_is_cut_off_before_the_next_one(tmp_path: Path) -> None:
    files, chunks = Full(), some_chunks(3)
    files.room = True
    disk = Disk(tmp_path, files)
    disk.begin()
    disk.journal(chunks[0])
    files.room = False
    for _ in range(3):
        with pytest.raises(DiskError, match="no space left"):
            disk.journal(chunks[1])
    files.room = True
    disk.journal(chunks[2])
    assert begun(tmp_path).recover(FRAME, KIND).chunks == [chunks[0], chunks[2]]


def test_a_life_that_is_not_on_disk_says_nothing_until_it_is(tmp_path: Path) -> None:
    begun(tmp_path)
    files = Full()
    disk = Disk(tmp_path, files)
    with pytest.raises(DiskError, match="no space left"):
        disk.begin()
    assert disk.incarnation == 1
    log = Log()
    robot = Robot(settings_of(0), Hardware(), disk, log, np.random.default_rng(0))
    assert [robot.choose_frame(n, 200) for n in range(3)] == [None] * 3
    assert len(log.told("disk")) == 2, "its layer, and its number; each once"
    files.room = True
    assert robot.choose_frame(4, 200) is not None
    assert (tmp_path / "incarnation").read_text() == "1"


def test_a_robot_that_can_not_know_which_life_this_is_maps_and_keeps_quiet(tmp_path: Path) -> None:
    first = robot_on(tmp_path)
    measure(first, look(np.random.default_rng(2)))
    save_robot(first)
    (tmp_path / "incarnation").write_text("two")
    disk = Disk(tmp_path)
    with pytest.raises(DiskError, match="incarnation"):
        disk.begin()
    robot = Robot(settings_of(0), Hardware(), disk, Log(), np.random.default_rng(0))
    assert robot.own.known_cells() == first.own.known_cells()
    assert robot.choose_frame(1, 200) is None
    assert (tmp_path / "incarnation").read_text() == "two"


def test_cells_taken_up_are_not_published_before_they_are_on_disk_again(tmp_path: Path) -> None:
    """Else the next life would take them up from the former one's layer, and publish them again."""
    first = robot_on(tmp_path)
    measure(first, look(np.random.default_rng(2), sigma_m=0.02))
    save_robot(first)
    assert first.own.known_cells() > 0
    files = Full()
    disk = Disk(tmp_path, files)
    files.room = True
    disk.begin()
    files.room = False
    second = Robot(settings_of(0), Hardware(), disk, Log(), np.random.default_rng(0))
    files.room = True
    published = say(second, 20)
    assert published
    third = robot_on(tmp_path)  # the second never saved by itself
    own = third.own.known_cells()
    assert own == 0, "all of it is the second life's"
    assert third.team.known_entries() == first.own.known_cells()


def test_what_was_chosen_goes_out_though_the_disk_refuses_the_rest(tmp_path: Path) -> None:
    files = Full()
    files.room = True
    disk = Disk(tmp_path, files)
    disk.begin()
    robot = Robot(settings_of(0), Hardware(), disk, Log(), np.random.default_rng(0))
    say(robot, 3)
    files.room = False
    heard = chunks_of(layer(np.random.default_rng(3)), Origin(1, 0))
    hear(robot, Kind.MAP, pack_chunks(heard[:1], Origin(1, 0)), sender=1)
    measure(robot, look(np.random.default_rng(2), sigma_m=0.02))
    assert {c.key for c in say(robot, 10)} <= {heard[0].key}, "nothing of its own"
    files.room = True
    assert any(c.key.robot == 0 for c in say(robot, 20, t_s=200.0))
