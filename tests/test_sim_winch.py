import asyncio

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_helpers import run

from agents.geometry import Pose
from agents.settings import TetherSettings
from sim.motion import Motions, Segment
from sim.winch import SimWinch

HERE = Pose(1.0, 2.0, 3.0, 0.5)
LIMITS = TetherSettings(rate_mps=0.05, command_timeout_s=6.0, max_length_m=10.0)


def winch(length_m: float = 2.0) -> tuple[SimWinch, list[Segment], Motions]:
    told: list[Segment] = []
    motions = Motions()

    def publish(segment: Segment) -> None:
        told.append(segment)
        motions.add(segment)

    return SimWinch("a", LIMITS, lambda _: HERE, publish, length_m=length_m), told, motions


def test_it_runs_to_its_length_at_its_rate_and_the_world_sees_the_same() -> None:
    drum, told, motions = winch()

    async def pay() -> list[float]:
        drum.pay_out(2.2, 0.04)
        seen = []
        for _ in range(4):
            seen.append(drum.length_m)
            await asyncio.sleep(2.0)
        return seen

    assert run(pay()) == pytest.approx([2.0, 2.08, 2.16, 2.2])
    assert [motions.tether_at("a", t * 10**9) for t in (0, 2, 4, 6)] == pytest.approx(
        [2.0, 2.08, 2.16, 2.2]
    )
    assert all(s.start == s.end == HERE for s in told)


def test_no_faster_than_the_drum_and_no_longer_than_one_command_lasts() -> None:
    drum, _, _ = winch()

    async def pay() -> list[float]:
        drum.pay_out(9.0, 99.0)
        await asyncio.sleep(3.0)
        seen = [drum.length_m]
        await asyncio.sleep(60.0)
        seen.append(drum.length_m)
        for _ in range(30):
            drum.pay_out(9.0, 99.0)
            await asyncio.sleep(5.0)
        seen.append(drum.length_m)
        return seen

    assert run(pay()) == pytest.approx([2.15, 2.3, 9.0])


def test_the_brake_stops_it_at_once_and_for_good() -> None:
    drum, told, motions = winch()

    async def stop() -> float:
        drum.pay_out(0.0, 0.05)
        await asyncio.sleep(2.0)
        drum.brake()
        await asyncio.sleep(50.0)
        return drum.length_m

    assert run(stop()) == pytest.approx(1.9)
    assert told[-1].tether_start_m == told[-1].tether_end_m
    assert motions.tether_at("a", 10**15) == pytest.approx(1.9)


@given(target=st.floats(-50, 50), rate=st.floats(0, 1))
@settings(max_examples=40, deadline=None)
def test_the_length_stays_between_nothing_and_all(target: float, rate: float) -> None:
    drum, _, _ = winch(0.1)

    async def pay() -> float:
        drum.pay_out(target, rate)
        await asyncio.sleep(20.0)
        return drum.length_m

    length_m = run(pay())
    assert 0.0 <= length_m <= 0.4 + 1e-9
    if rate > 0.02:
        assert length_m == pytest.approx(min(max(target, 0.0), 0.1 + min(rate, 0.05) * 6))
