"""How often rays are stopped in what nobody measured, by the map so far."""

from dataclasses import dataclass

from agents.geometry import Bools


@dataclass(frozen=True)
class StopPrior:
    """What is believed before there is a map: `p`, which counts like so many steps of rays."""

    p: float
    steps: float = 400.0


def stop_share(free: Bools, solid: Bools, axes: tuple[int, ...], prior: StopPrior) -> float:
    """Return the probability that a step from a free cell along these axes meets a solid one."""
    steps = stops = 0
    for axis in axes:
        low = [slice(None)] * free.ndim
        high = [slice(None)] * free.ndim
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        a, b = tuple(low), tuple(high)
        stops += int((free[a] & solid[b]).sum()) + int((solid[a] & free[b]).sum())
        steps += 2 * int((free[a] & free[b]).sum())
    steps += stops
    return (stops + prior.p * prior.steps) / (steps + prior.steps)
