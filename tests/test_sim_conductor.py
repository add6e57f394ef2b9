"""Windows of time change nothing: robots do what they would do one event at a time."""

import heapq
from collections import Counter
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.conductor import Conductor

quick = settings(max_examples=100, deadline=None)
LOOKAHEAD_NS = 10
LIMIT_NS = 400
NAMES = ("anna", "bert", "cleo", "dora")


@dataclass(frozen=True)
class Letter:
    """Wakes its receiver, who may answer as long as there are hops left."""

    sender: str
    receiver: str
    arrive_ns: int
    hops: int


@dataclass
class Actor:
    """A robot with a script: at each own event it may write, and each letter it may answer."""

    name: str
    script: list[tuple[int, list[tuple[str, int]]]]
    """(pause in ns before the event, [(receiver, latency)])."""
    answers_ns: int
    events: list[tuple[int, int, str, Letter | None]] = field(default_factory=list)
    diary: list[tuple[int, str]] = field(default_factory=list)
    outbox: list[Letter] = field(default_factory=list)
    now_ns: int = 0
    step: int = 0
    sent: int = 0

    def __post_init__(self) -> None:
        self.plan_next()

    def plan_next(self) -> None:
        if self.step < len(self.script):
            due_ns = self.now_ns + self.script[self.step][0]
            heapq.heappush(self.events, (due_ns, 0, "", None))

    @property
    def next_ns(self) -> int | None:
        return self.events[0][0] if self.events else None

    def receive(self, letter: Letter) -> None:
        heapq.heappush(self.events, (letter.arrive_ns, 1 + letter.hops, letter.sender, letter))

    def act(self, floor_ns: int = 0) -> None:
        """Do the next thing."""
        due_ns, _, _, letter = heapq.heappop(self.events)
        self.now_ns = max(self.now_ns, due_ns, floor_ns)
        if letter is None:
            self.diary.append((self.now_ns, "acts"))
            writes = [(receiver, latency, 2) for receiver, latency in self.script[self.step][1]]
            self.step += 1
            self.plan_next()
        else:
            self.diary.append((self.now_ns, f"hears {letter.sender} {letter.hops}"))
            writes = [(letter.sender, self.answers_ns, letter.hops - 1)] if letter.hops else []
        for receiver, latency_ns, hops in writes:
            self.sent += 1
            self.outbox.append(Letter(self.name, receiver, self.now_ns + latency_ns, hops))

    def run(self, end_ns: int, floor_ns: int) -> None:
        while self.events and self.events[0][0] < end_ns:
            self.act(floor_ns)


latencies = st.integers(LOOKAHEAD_NS, 40)
scripts = st.lists(
    st.tuples(
        st.integers(0, 60), st.lists(st.tuples(st.sampled_from(NAMES), latencies), max_size=2)
    ),
    max_size=6,
)
teams = st.lists(st.tuples(scripts, latencies), min_size=2, max_size=4)
Team = list[tuple[list[tuple[int, list[tuple[str, int]]]], int]]


def cast(team: Team) -> dict[str, Actor]:
    names = NAMES[: len(team)]
    actors: dict[str, Actor] = {}
    for name, (script, answers_ns) in zip(names, team, strict=True):
        heard = [(t, [(r, ns) for r, ns in to if r in names and r != name]) for t, to in script]
        actors[name] = Actor(name, heard, answers_ns)
    return actors


@dataclass(frozen=True)
class Turn:
    """Something scripted that befalls a robot at a barrier."""

    t_ns: int
    what: str
    name: str


turns = st.lists(
    st.builds(
        Turn,
        st.integers(1, 300),
        st.sampled_from(["stop", "resume", "leave"]),
        st.sampled_from(NAMES),
    ),
    max_size=6,
).map(lambda planned: sorted(planned, key=lambda turn: turn.t_ns))


class OneByOne:
    """The reference: always the earliest event of all, and turns before what is due with them."""

    def __init__(self, team: Team, planned: list[Turn]) -> None:
        self.actors = cast(team)
        self.stopped: set[str] = set()
        self.floor_ns = dict.fromkeys(self.actors, 0)
        pending = [turn for turn in planned if turn.name in self.actors]
        while True:
            due = [
                (max(actor.next_ns, self.floor_ns[name]), name)
                for name, actor in self.actors.items()
                if name not in self.stopped and actor.next_ns is not None
            ]
            t_ns, name = min(due, default=(LIMIT_NS, ""))
            if pending and pending[0].t_ns <= t_ns:
                self.turn(pending.pop(0))
                continue
            if t_ns >= LIMIT_NS:
                return
            self.actors[name].act(self.floor_ns[name])
            for letter in self.actors[name].outbox:
                if letter.receiver in self.actors:
                    self.actors[letter.receiver].receive(letter)
            self.actors[name].outbox.clear()

    def turn(self, turn: Turn) -> None:
        if turn.name not in self.actors:
            return
        match turn.what:
            case "stop":
                self.stopped.add(turn.name)
            case "resume" if turn.name in self.stopped:
                self.stopped.remove(turn.name)
                self.floor_ns[turn.name] = turn.t_ns
            case "leave":
                self.gone = {**getattr(self, "gone", {}), turn.name: self.actors.pop(turn.name)}
            case _:
                pass


class InWindows:
    """The same, as the runner does it: reports, windows, grants, barriers."""

    def __init__(self, team: Team, planned: list[Turn], lookahead_ns: int = LOOKAHEAD_NS) -> None:
        self.actors = cast(team)
        self.gone: dict[str, Actor] = {}
        self.conductor = Conductor(lookahead_ns, LIMIT_NS)
        self.post: dict[str, list[Letter]] = {name: [] for name in self.actors}
        self.starts: list[int] = []
        for name, actor in self.actors.items():
            self.conductor.join(name, actor.next_ns)
        pending = [turn for turn in planned if turn.name in self.actors]
        while True:
            barrier_ns = pending[0].t_ns if pending else LIMIT_NS
            window = self.conductor.open_window(barrier_ns)
            if window is not None:
                self.grant(window, barrier_ns)
                continue
            assert self.conductor.now_ns == barrier_ns, "an event falls on its exact instant"
            if not pending:
                return
            self.turn(pending.pop(0))

    def grant(self, window, barrier_ns: int) -> None:
        conductor = self.conductor
        assert window.start_ns < window.end_ns <= min(window.start_ns + LOOKAHEAD_NS, barrier_ns)
        self.starts.append(window.start_ns)
        assert self.starts == sorted(self.starts), "time never goes back"
        due = {n: m.due_ns() for n, m in conductor.members.items()}
        letters: list[Letter] = []
        for name in window.members:
            actor, member = self.actors[name], conductor.members[name]
            for letter in self.post[name]:
                actor.receive(letter)
            self.post[name] = []
            before = len(actor.diary)
            actor.run(window.end_ns, member.floor_ns)
            assert len(actor.diary) > before, "who is granted a window has something to do in it"
            assert all(window.start_ns <= t_ns < window.end_ns for t_ns, _ in actor.diary[before:])
            letters += actor.outbox
            assert conductor.waiting_for()[0] == name
            urgent = [(letter.receiver, letter.arrive_ns) for letter in actor.outbox]
            conductor.report(name, actor.next_ns, actor.sent, urgent)
            actor.outbox.clear()
        for letter in letters:
            assert letter.arrive_ns >= window.end_ns, "it would have come too late"
            if letter.receiver in self.actors:
                self.post[letter.receiver].append(letter)
        skipped = set(conductor.members) - set(window.members)
        assert all(due[name] is None or due[name] >= window.end_ns for name in skipped)

    def turn(self, turn: Turn) -> None:
        if turn.name not in self.actors:
            return
        match turn.what:
            case "stop":
                self.conductor.stop(turn.name)
            case "resume" if self.conductor.members[turn.name].stopped:
                self.conductor.resume(turn.name)
            case "leave":
                self.conductor.leave(turn.name)
                self.gone[turn.name] = self.actors.pop(turn.name)
            case _:
                pass


@given(teams)
@quick
def test_windows_change_nothing_in_what_happens(team: Team) -> None:
    reference, windowed = OneByOne(team, []), InWindows(team, [])
    for name, actor in reference.actors.items():
        assert windowed.actors[name].diary == actor.diary


@given(teams, turns)
@settings(max_examples=150, deadline=None)
def test_windows_change_nothing_where_robots_stop_go_on_and_leave(
    team: Team, planned: list[Turn]
) -> None:
    reference, windowed = OneByOne(team, planned), InWindows(team, planned)
    theirs = {**reference.actors, **getattr(reference, "gone", {})}
    mine = {**windowed.actors, **windowed.gone}
    for name, actor in theirs.items():
        assert mine[name].diary == actor.diary


@given(teams)
@quick
def test_a_window_is_one_lookahead_and_so_spares_grants(team: Team) -> None:
    windowed = InWindows(team, [])
    done = sum(len(actor.diary) for actor in windowed.actors.values())
    assert windowed.conductor.grants <= done
    assert windowed.conductor.rounds <= windowed.conductor.grants


# --- one by one -----------------------------------------------------------------------------


def test_only_those_with_something_due_are_granted_the_window() -> None:
    conductor = Conductor(10, 1000)
    for name, next_ns in (("a", 5), ("b", 14), ("c", 15), ("d", None)):
        conductor.join(name, next_ns)
    window = conductor.open_window(1000)
    assert window is not None
    assert (window.start_ns, window.end_ns, window.members) == (5, 15, ("a", "b"))
    assert conductor.waiting_for() == ["a", "b"]
    assert (conductor.rounds, conductor.grants) == (1, 2)


def test_urgent_news_wakes_its_receiver_and_other_news_does_not() -> None:
    conductor = Conductor(10, 1000)
    conductor.join("a", 5)
    conductor.join("b", None)
    assert conductor.open_window(1000) is not None
    conductor.report("a", None, 3, [("b", 40), ("b", 20), ("nobody", 21)])
    assert conductor.members["a"].sent == 3
    window = conductor.open_window(1000)
    assert window is not None
    assert (window.start_ns, window.members) == (20, ("b",))
    conductor.report("b", 40, 0, [])  # it told of the other itself
    assert conductor.next_due_ns() == 40


def test_a_window_ends_at_the_barrier_and_the_clock_then_stands_there() -> None:
    conductor = Conductor(10, 1000)
    conductor.join("a", 95)
    window = conductor.open_window(100)
    assert window is not None
    assert (window.start_ns, window.end_ns) == (95, 100)
    conductor.report("a", 100, 0, [])
    assert conductor.open_window(100) is None
    assert conductor.now_ns == 100
    window = conductor.open_window(300)
    assert window is not None
    assert window.start_ns == 100, "what is due at the barrier's instant comes after it"


def test_nothing_runs_at_or_after_the_limit() -> None:
    conductor = Conductor(10, 50)
    conductor.join("a", 49)
    window = conductor.open_window(10**9)
    assert window is not None
    assert window.end_ns == 50
    conductor.report("a", 50, 0, [])
    assert conductor.open_window(10**9) is None
    assert conductor.now_ns == 50


def test_who_is_stopped_holds_nobody_up_and_goes_on_at_the_instant_of_its_resume() -> None:
    conductor = Conductor(10, 1000)
    conductor.join("a", 30)
    conductor.join("b", 100)
    conductor.stop("a")
    assert conductor.next_due_ns() == 100
    assert conductor.open_window(60) is None
    conductor.resume("a")
    assert conductor.members["a"].floor_ns == 60
    window = conductor.open_window(1000)
    assert window is not None
    assert (window.start_ns, window.members) == (60, ("a",)), "overdue since 30, done at 60"


def test_who_left_is_waited_for_no_more_and_who_joins_counts_at_once() -> None:
    conductor = Conductor(10, 1000)
    conductor.join("a", 5)
    conductor.join("b", 6)
    assert conductor.open_window(1000) is not None
    conductor.leave("a")
    assert conductor.waiting_for() == ["b"]
    conductor.report("b", 90, 1, [("a", 50)])
    conductor.leave("b")
    conductor.leave("b")
    assert conductor.next_due_ns() is None
    conductor.join("c", 40, sent=7)
    assert (conductor.next_due_ns(), conductor.members["c"].sent) == (40, 7)


def test_a_window_is_not_opened_while_a_report_is_still_to_come() -> None:
    conductor = Conductor(10, 1000)
    conductor.join("a", 5)
    assert conductor.open_window(1000) is not None
    with pytest.raises(AssertionError):
        conductor.open_window(1000)


def test_the_conductor_serves_all_alike() -> None:
    """Three robots with an event each nanosecond: nobody is granted more windows than another."""
    conductor = Conductor(10, 1000)
    clocks = dict.fromkeys("abc", 0)
    for name in clocks:
        conductor.join(name, 0)
    served: Counter[str] = Counter()
    while (window := conductor.open_window(1000)) is not None:
        for name in window.members:
            served[name] += 1
            clocks[name] = window.end_ns
            conductor.report(name, window.end_ns, 0, [])
    assert set(served.values()) == {100}
