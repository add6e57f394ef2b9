"""Laws of the whole house: what holds for any team, whatever befalls it."""

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from robot_helpers import NS, PAYLOAD_BYTES, hear, measure, robot_on, save
from team_helpers import (
    GRIDS,
    KINDS,
    LOOKS,
    cells_of,
    certainty,
    certainty_of,
    known_in,
    nowhere,
)

from agents.maps.occupancy import probability
from agents.member import KEEP_ALIVE_S
from agents.robot import Robot

ROOT = Path(__file__).parents[1]
ROOMS = ("comms", "agents", "sim", "scenarios")
"""Each may import itself and what stands before it."""
MAPPERS = 2
TEAM = 3


# --- a team under misfortune ----------------------------------------------------------------


class Radio:
    """A robot's end of the lossy air: it numbers frames."""

    def __init__(self) -> None:
        self.next_seq = 0

    def kick(self) -> None:
        pass

    def send_urgent(self, *_: object) -> None:
        raise AssertionError("a robot that only talks commands nobody")


class Team:
    """Robots on folders, who hear each other through lossy air; they die and come back."""

    def __init__(self, folder: Path, seed: int, kind: str) -> None:
        self.kind = kind
        self.folder = folder
        self.rng = np.random.default_rng(seed)
        self.robots: dict[int, Robot] = {}
        self.measured = nowhere(kind)
        self.now_s = 0.0
        self.radios: dict[int, Radio] = {}
        self.told_s = 0.0
        for index in range(TEAM):
            self.restart(index)

    def restart(self, index: int) -> None:
        robot = robot_on(self.folder / str(index), index, self.kind)
        robot.radio = self.radios[index] = Radio()
        self.robots[index] = robot

    def look(self, index: int) -> None:
        cells = LOOKS[self.kind](self.rng)
        self.measured[cells_of(cells)] += certainty_of(cells)
        measure(self.robots[index], cells)
        save(self.robots[index])

    def exchange(self, rounds: int, loss: float, deaf: int | None = None) -> bool:
        """Let all send so many frames each; return whether they have come to rest."""
        quiet = False
        for _ in range(rounds):
            if self.now_s >= self.told_s + KEEP_ALIVE_S:
                self.told_s = self.now_s
                for robot in self.robots.values():
                    robot.tell_status()
            said = [
                (index, robot.me.incarnation, robot.choose_frame(self.t_ns, PAYLOAD_BYTES))
                for index, robot in self.robots.items()
            ]
            quiet = all(outgoing is None for *_, outgoing in said)
            self.now_s += 10.0 if quiet else 0.2
            for sender, life, outgoing in said:
                if outgoing is None:
                    continue
                seq = self.radios[sender].next_seq
                self.radios[sender].next_seq += 1
                for index, robot in self.robots.items():
                    if sender == index or deaf in (sender, index):
                        continue
                    if self.rng.random() >= loss:
                        kind, payload = outgoing.kind, outgoing.payload
                        hear(robot, kind, payload, sender, self.now_s, life, seq)
            if quiet and self.is_settled:
                return True
        return False

    @property
    def t_ns(self) -> int:
        return round(self.now_s * NS)

    @property
    def digests(self) -> set[str]:
        return {robot.store.digest() for robot in self.robots.values()}

    @property
    def is_settled(self) -> bool:
        settled = all(robot.sharing.settled() for robot in self.robots.values())
        return settled and len(self.digests) == 1


deeds = st.lists(
    st.tuples(
        st.sampled_from(["look", "look", "talk", "talk", "die", "part"]),
        st.integers(0, TEAM - 1),
        st.integers(1, 25),
    ),
    min_size=4,
    max_size=12,
)


@example(seed=0, loss=0.0, planned=[("look", 0, 1), ("look", 0, 1), ("part", 0, 3), ("die", 0, 1)])
@given(seed=st.integers(0, 2**32 - 1), loss=st.sampled_from([0.0, 0.15, 0.4]), planned=deeds)
@settings(max_examples=20, deadline=None)
@pytest.mark.parametrize("kind", KINDS)
def test_whatever_befalls_a_team_its_maps_end_equal_and_true(
    tmp_path_factory: pytest.TempPathFactory,
    kind: str,
    seed: int,
    loss: float,
    planned: list[tuple[str, int, int]],
) -> None:
    team = Team(tmp_path_factory.mktemp("team"), seed, kind)
    for deed, index, count in planned:
        if deed == "look":
            team.look(index % MAPPERS)
        elif deed == "die":
            team.restart(index)
        else:
            team.exchange(count, loss, deaf=index if deed == "part" else None)
        for robot in team.robots.values():
            fused = robot.team.fused()
            assert np.all(certainty(fused) <= team.measured * (1 + 1e-9)), "counted twice"
    assert team.exchange(6000, loss), "they never come to rest"
    for robot in team.robots.values():
        fused = robot.team.fused()
        assert np.all(certainty(fused) <= team.measured * (1 + 1e-9))
        assert not (known_in(fused) & (team.measured == 0)).any()
    listener = team.robots[TEAM - 1].team.fused()
    known = known_in(listener)
    for tile in map(GRIDS[kind].window, range(GRIDS[kind].count)):
        missing = team.measured[tile][(team.measured[tile] > 0) & ~known[tile]]
        if kind != "elevation":
            missing = missing[probability(missing) > 0.75]
        assert missing.size < 24, "only what is not worth its bytes stays with its robot"


# --- the house ------------------------------------------------------------------------------


def imports_of(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module or ""


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_import_in_one_direction_only(room: str) -> None:
    allowed = ROOMS[: ROOMS.index(room) + 1]
    files = sorted((ROOT / room).glob("**/*.py"))
    assert files
    for path in files:
        for name in imports_of(path):
            top = name.split(".")[0]
            assert top not in ROOMS or top in allowed, f"{path} imports {name}"


def test_two_files_know_zenoh() -> None:
    knowing = {
        path.name
        for room in ROOMS
        for path in (ROOT / room).glob("**/*.py")
        if any(name.split(".")[0] == "zenoh" for name in imports_of(path))
    }
    assert knowing == {"zenoh_air.py", "ros2_zenoh.py"}, "team-mates, and viewers of others"


@pytest.mark.parametrize("module", ["random", "secrets", "uuid", "datetime"])
def test_no_other_source_of_chance_or_time_is_used(module: str) -> None:
    """Chance comes from numpy generators that are handed in, time from the running loop."""
    for room in ("comms", "agents", "sim"):
        for path in (ROOT / room).glob("**/*.py"):
            assert module not in {name.split(".")[0] for name in imports_of(path)}, path
