"""The robot's clock is the running event loop's: virtual, scaled or real, nobody below knows which.

Times are integer nanoseconds; only asyncio's own interface speaks of seconds.
"""

import asyncio

NS = 1_000_000_000
"""Nanoseconds in a second."""


def to_s(t_ns: int) -> float:
    """Return nanoseconds as seconds."""
    return t_ns / NS


def from_s(t_s: float) -> int:
    """Return seconds as the nearest whole nanosecond."""
    return round(t_s * NS)


def now_ns() -> int:
    """Return the running loop's time."""
    return from_s(asyncio.get_running_loop().time())


def _release(future: "asyncio.Future[None]") -> None:
    if not future.done():
        future.set_result(None)


async def sleep_until_ns(t_ns: int) -> None:
    """Wait until the loop's time is `t_ns`; yield once where that has passed.

    The timer is set at the instant itself: a difference of two times, as `asyncio.sleep` takes it,
    would be rounded twice.
    """
    loop = asyncio.get_running_loop()
    if t_ns <= now_ns():
        await asyncio.sleep(0)
        return
    woken: asyncio.Future[None] = loop.create_future()
    timer = loop.call_at(to_s(t_ns), _release, woken)
    try:
        await woken
    finally:
        timer.cancel()
