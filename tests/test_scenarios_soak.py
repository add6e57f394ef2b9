"""Hours under faults: they are survived, and no process grows that should not."""

import pytest

from scenarios.chaos.soak import Soaked, soak, soak_faults, soak_scenario
from scenarios.schema.overrides import parse_override

QUICK = [parse_override(text) for text in ("air=memory", "robots.count=2", "sensor.look_s=120")]


def test_growth_is_that_of_the_second_half() -> None:
    samples = [(float(t), 100 + (0 if t < 50 else t - 50)) for t in range(0, 101, 2)]
    soaked = Soaked(100.0, "limit", (), 0, 0, {"flat": [(t, 7) for t, _ in samples], "up": samples})
    growth = soaked.growth()
    assert growth["flat"] == 0.0
    assert growth["up"] == pytest.approx(146 / 104 - 1.0)


def test_something_goes_wrong_in_every_half_hour_and_is_over_before_the_next() -> None:
    scenario = soak_scenario(3.0, 5, QUICK)
    faults = soak_faults(scenario, 5)
    assert soak_faults(scenario, 5) == faults != soak_faults(scenario, 6)
    for span in range(6):
        here = [fault for fault in faults if span * 1800 <= fault.at_s < (span + 1) * 1800]
        assert here
        assert all(fault.at_s + fault.for_s < (span + 1) * 1800 for fault in here)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_two_robots_last_for_an_hour_and_a_half_under_faults() -> None:
    scenario = soak_scenario(1.5, 3, QUICK)
    soaked = soak(scenario, 3)
    assert (soaked.ending, soaked.simulated_s) == ("limit", 5400.0)
    assert soaked.looks > 30
    assert soaked.frames > 100
    assert max(soaked.growth().values()) < 0.05, soaked.growth()
