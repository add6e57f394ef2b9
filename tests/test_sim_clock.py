"""The virtual clock keeps the contract of asyncio, and an order for what is simultaneous."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_helpers import run

from comms.timebase import NS, now_ns, sleep_until_ns, to_s
from sim.clock import ScaledLoop, VirtualLoop

quick = settings(max_examples=60, deadline=None)
Trace = list[tuple[float, Any]]
FIFTY_DAYS_NS = 50 * 86_400 * NS


@pytest.fixture
def loop():
    made = VirtualLoop(1)
    yield made
    made.close()


class JumpingLoop(asyncio.SelectorEventLoop):
    """Asyncio's own loop; its clock stands while there is work and jumps to the next timer."""

    def __init__(self) -> None:
        super().__init__()
        self._t_s = 0.0
        self._clock_resolution = 1e-10
        real = self._selector.select
        self._selector.select = lambda timeout=None: self._jump(timeout) or real(0)

    def time(self) -> float:
        return self._t_s

    def _jump(self, timeout: float | None) -> None:
        if timeout is not None and timeout > 0:
            self._t_s = max(self._t_s, self._scheduled[0]._when)


# --- the same as asyncio --------------------------------------------------------------------


def note(trace: Trace, what: Any) -> None:
    trace.append((round(asyncio.get_running_loop().time(), 6), what))


async def sleeping(trace: Trace) -> None:
    for delay_s in (0.3, 0, 0.25, -1.0, 0.001):
        await asyncio.sleep(delay_s)
        note(trace, delay_s)


async def timing_out(trace: Trace) -> None:
    event = asyncio.Event()
    asyncio.get_running_loop().call_later(0.5, event.set)
    for limit_s in (0.2, 0.2, 0.2, 0.0):
        try:
            async with asyncio.timeout(limit_s):
                await event.wait()
                note(trace, "came")
                await asyncio.sleep(10.0)
        except TimeoutError:
            note(trace, "timeout")
    async with asyncio.timeout(1.0):
        await asyncio.sleep(0.1)
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(asyncio.sleep(5.0), 0.7)
    note(trace, "end")


async def gathering(trace: Trace) -> None:
    async def worker(number: int) -> int:
        await asyncio.sleep(0.1 * (4 - number))
        note(trace, number)
        return number

    note(trace, await asyncio.gather(*(worker(n) for n in range(4))))


async def failing_together(trace: Trace) -> None:
    async def fail() -> None:
        await asyncio.sleep(0.2)
        raise KeyError("one")

    async def last() -> None:
        try:
            await asyncio.sleep(1.0)
        except asyncio.CancelledError:
            note(trace, "cancelled")
            raise

    try:
        async with asyncio.TaskGroup() as group:
            group.create_task(fail())
            group.create_task(last())
    except* KeyError as failed:
        note(trace, str(failed.exceptions))
    note(trace, "end")


async def signalling(trace: Trace) -> None:
    event, queue = asyncio.Event(), asyncio.Queue(1)

    async def wait(name: str) -> None:
        await event.wait()
        note(trace, name)

    async def produce() -> None:
        for n in range(4):
            await queue.put(n)
            await asyncio.sleep(0.05)

    async def consume() -> None:
        for _ in range(4):
            note(trace, await queue.get())
            await asyncio.sleep(0.13)

    waiters = [asyncio.create_task(wait(name)) for name in "abc"]
    both = asyncio.gather(produce(), consume())
    await asyncio.sleep(0.31)
    event.set()
    note(trace, "set")
    await both
    await asyncio.wait(waiters)


async def cancelling(trace: Trace) -> None:
    async def stubborn() -> None:
        try:
            await asyncio.sleep(9.0)
        finally:
            note(trace, "unwinding")
            await asyncio.sleep(0.2)
            note(trace, "unwound")

    task = asyncio.create_task(stubborn())
    await asyncio.sleep(0.4)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    handle = asyncio.get_running_loop().call_later(0.1, note, trace, "never")
    handle.cancel()
    await asyncio.sleep(0.3)
    note(trace, handle.cancelled())


PROGRAMS: list[Callable[[Trace], Coroutine[Any, Any, None]]] = [
    sleeping, timing_out, gathering, failing_together, signalling, cancelling,
]  # fmt: skip


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_runs_as_on_asyncios_own_loop(program: Any) -> None:
    mine: Trace = []
    theirs: Trace = []
    run(program(mine))
    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        runner.run(program(theirs))
    assert mine == theirs
    assert mine


@given(st.lists(st.integers(1, 100_000), min_size=1, max_size=12))
@quick
def test_random_sleepers_wake_as_on_asyncios_own_loop(delays_ms: list[int]) -> None:
    delays_s = [delay_ms / 1000 for delay_ms in delays_ms]

    async def program(trace: Trace) -> None:
        async def sleeper(name: int, delay_s: float) -> None:
            for _ in range(2):
                await asyncio.sleep(delay_s)
                note(trace, name)

        await asyncio.gather(*(sleeper(i, d) for i, d in enumerate(delays_s)))

    mine: Trace = []
    theirs: Trace = []
    run(program(mine))
    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        runner.run(program(theirs))
    assert sorted(mine) == sorted(theirs), "those of one instant apart"
    assert [t for t, _ in mine] == [t for t, _ in theirs]


# --- what is simultaneous -------------------------------------------------------------------

events = st.lists(
    st.tuples(st.integers(0, 3), st.sampled_from([0, 1, 2]), st.integers(0, 5)),
    max_size=30,
    unique_by=lambda e: e[1:] if e[1] != 1 else object(),
)


@given(events)
@quick
def test_what_is_simultaneous_goes_by_source_and_then_by_sequence(
    planned: list[tuple[int, int, int]],
) -> None:
    """Timers of the loop's own count as its source's, in the order in which they were set."""
    loop, happened = VirtualLoop(1), []
    expected: list[tuple[int, int, int, int]] = []
    for place, (t_ns, source, number) in enumerate(planned):
        if source == loop.source:
            loop.call_at(to_s(t_ns), happened.append, place)
            expected.append((t_ns, source, place, place))
        else:
            loop.post(t_ns, source, number, lambda place=place: happened.append(place), True)
            expected.append((t_ns, source, number, place))
    loop.run_window(10)
    loop.close()
    assert happened == [place for *_, place in sorted(expected)]


def test_what_an_event_sets_for_the_same_instant_comes_after_all_that_was_due(
    loop: VirtualLoop,
) -> None:
    happened: list[str] = []
    loop.call_at(1e-9, lambda: loop.call_at(1e-9, happened.append, "set now"))
    loop.call_at(1e-9, lambda: loop.call_soon(happened.append, "soon"))
    loop.call_at(1e-9, happened.append, "due")
    loop.run_window(2)
    assert happened == ["due", "soon", "set now"]


# --- mail -----------------------------------------------------------------------------------


def test_mail_does_not_wake_and_is_handed_over_before_the_event_that_does(
    loop: VirtualLoop,
) -> None:
    happened: list[Any] = []

    def hand(what: str) -> Callable[[], None]:
        return lambda: happened.append((loop.now_ns, what))

    loop.post(30, 0, 1, hand("mail of 30"), wake=False)
    loop.post(10, 2, 5, hand("mail of 10, robot 2"), wake=False)
    loop.post(10, 0, 7, hand("mail of 10, robot 0, 7"), wake=False)
    loop.post(10, 0, 6, hand("mail of 10, robot 0, 6"), wake=False)
    assert loop.next_event_ns() is None
    loop.run_window(100)
    assert happened == []
    loop.call_at(20e-9, hand("event"))
    assert loop.next_event_ns() == 20
    loop.run_window(200)
    assert happened == [
        (20, "mail of 10, robot 0, 6"),
        (20, "mail of 10, robot 0, 7"),
        (20, "mail of 10, robot 2"),
        (20, "event"),
    ]
    loop.post(20, 0, 8, hand("late"), wake=False)
    loop.call_at(40e-9, hand("next"))
    loop.run_window(200)
    assert happened[4:] == [(40, "late"), (40, "mail of 30"), (40, "next")]


def test_mail_of_the_very_instant_comes_before_its_event(loop: VirtualLoop) -> None:
    happened: list[str] = []
    loop.call_at(10e-9, happened.append, "event")
    loop.post(10, 9, 0, lambda: happened.append("mail"), wake=False)
    loop.run_window(11)
    assert happened == ["mail", "event"]


def test_urgent_news_wakes_and_finds_the_mail_before_it_read(loop: VirtualLoop) -> None:
    happened: list[str] = []
    loop.post(5, 0, 0, lambda: happened.append("mail"), wake=False)
    loop.post(7, 0, 1, lambda: happened.append("urgent"), wake=True)
    assert loop.next_event_ns() == 7
    loop.run_window(8)
    assert (happened, loop.now_ns) == (["mail", "urgent"], 7)


def test_advancing_hands_out_the_mail_and_runs_nothing(loop: VirtualLoop) -> None:
    happened: list[str] = []
    loop.post(5, 0, 0, lambda: happened.append("mail"), wake=False)
    loop.post(6, 0, 1, lambda: happened.append("later"), wake=False)
    loop.call_at(5e-9, happened.append, "event")
    loop.advance(5)
    assert (happened, loop.now_ns) == (["mail"], 5)


# --- windows --------------------------------------------------------------------------------


@given(
    st.lists(st.integers(0, 60), max_size=12),
    st.lists(st.integers(0, 70), min_size=1, max_size=6).map(sorted),
)
@quick
def test_nothing_runs_at_or_after_the_end_of_its_window(times: list[int], ends: list[int]) -> None:
    loop, happened = VirtualLoop(0), []
    for t_ns in times:
        loop.call_at(to_s(t_ns), lambda: happened.append(loop.now_ns))
    for end_ns in ends:
        loop.run_window(end_ns)
        assert happened == sorted(t for t in times if t < end_ns)
        left = [t for t in times if t >= end_ns]
        assert loop.next_event_ns() == (min(left) if left else None)
        assert loop.now_ns == (happened[-1] if happened else 0)
    loop.close()


def test_work_without_a_timer_is_done_at_once_in_whatever_window(loop: VirtualLoop) -> None:
    happened: list[str] = []
    loop.call_soon(happened.append, "soon")
    assert loop.next_event_ns() == 0
    loop.run_window(1)
    assert happened == ["soon"]
    assert loop.next_event_ns() is None


def test_a_robot_that_was_stopped_finds_its_overdue_timers_at_the_instant_it_goes_on(
    loop: VirtualLoop,
) -> None:
    happened: list[Any] = []
    for t_ns in (30, 10, 20, 70):
        loop.call_at(to_s(t_ns), lambda t=t_ns: happened.append((t, loop.now_ns)))
    loop.run_window(100, floor_ns=50)
    assert happened == [(10, 50), (20, 50), (30, 50), (70, 70)]


def test_a_timer_in_the_past_fires_now(loop: VirtualLoop) -> None:
    happened: list[Any] = []
    loop.call_at(5e-9, lambda: loop.call_at(2e-9, lambda: happened.append(loop.now_ns)))
    loop.run_window(9)
    assert happened == [5]
    loop.post(1, 0, 0, lambda: happened.append(loop.now_ns), wake=True)
    assert loop.next_event_ns() == 5
    loop.run_window(9)
    assert happened == [5, 5]


def test_cancelled_timers_wake_nobody(loop: VirtualLoop) -> None:
    happened: list[str] = []
    first = loop.call_at(1e-9, happened.append, "first")
    second = loop.call_at(2e-9, happened.append, "second")
    loop.call_at(3e-9, second.cancel)
    third = loop.call_at(3e-9, happened.append, "third")
    loop.call_at(2e-9, third.cancel)
    first.cancel()
    assert loop.next_event_ns() == 2
    loop.run_window(9)
    assert (happened, loop.now_ns) == (["second"], 3)
    assert loop.next_event_ns() is None


# --- time is exact --------------------------------------------------------------------------


@given(st.lists(st.integers(0, FIFTY_DAYS_NS), min_size=1, max_size=6).map(sorted))
@quick
def test_an_instant_is_met_to_the_nanosecond_for_fifty_days(instants: list[int]) -> None:
    async def program() -> list[int]:
        met: list[int] = []
        for t_ns in instants:
            await sleep_until_ns(t_ns)
            met.append(now_ns())
        return met

    loop = VirtualLoop(0)
    task = loop.create_task(program())
    loop.run_window(FIFTY_DAYS_NS + 1)
    assert task.result() == instants
    assert loop.now_ns == instants[-1]
    loop.close()


def test_a_million_short_sleeps_do_not_drift() -> None:
    async def program() -> int:
        for k in range(1, 20_001):
            await sleep_until_ns(k * 720_000_001)
        return now_ns()

    assert run(program()) == 20_000 * 720_000_001, "four hours of frames"


def test_a_loop_starts_at_the_instant_at_which_its_robot_joins() -> None:
    loop = VirtualLoop(0, start_ns=7 * NS)
    assert (loop.time(), loop.now_ns) == (7.0, 7 * NS)
    happened: list[int] = []
    loop.call_later(1.0, lambda: happened.append(loop.now_ns))
    loop.run_window(9 * NS)
    loop.close()
    assert happened == [8 * NS]


# --- computing ------------------------------------------------------------------------------


def test_computing_takes_no_simulated_time_and_its_errors_are_the_callers() -> None:
    async def program() -> tuple[float, int]:
        value = await asyncio.to_thread(sum, [1, 2, 3])
        with pytest.raises(ZeroDivisionError):
            await asyncio.to_thread(lambda: 1 // 0)
        return asyncio.get_running_loop().time(), value

    assert run(program()) == (0.0, 6)


def test_an_hour_takes_no_hour() -> None:
    async def program() -> float:
        for _ in range(3600):
            await asyncio.sleep(1.0)
        return asyncio.get_running_loop().time()

    start_s = time.perf_counter()
    assert run(program()) == pytest.approx(3600.0)
    assert time.perf_counter() - start_s < 5.0


# --- the wall clock, faster -----------------------------------------------------------------


def test_a_scaled_loop_keeps_the_wall_clocks_time_times_its_speed() -> None:
    epoch_s = time.monotonic()
    loop = ScaledLoop(50.0)
    assert loop.time() == 0.0
    loop.begin(epoch_s)
    happened: list[float] = []
    loop.post(round(1.5 * NS), 0, 0, lambda: happened.append(loop.time()), wake=False)
    loop.run_until_complete(asyncio.sleep(3.0))
    loop.close()
    wall_s = time.monotonic() - epoch_s
    assert wall_s * 50.0 >= 3.0
    assert wall_s < 2.0, "sixty milliseconds of the wall's, and some slack"
    assert happened
    assert happened[0] >= 1.5
