"""Randomness of a run: one source per robot, purpose and life, all from the scenario's seed."""

import numpy as np

from scenarios.schema import Scenario

PURPOSES = ("robot", "body", "camera", "transmitter", "receiver", "start", "terrain", "team")


def dice(scenario: Scenario, name: str, purpose: str, life: int = 0) -> np.random.Generator:
    """Return the source of randomness of one robot for one purpose, in one incarnation."""
    key = (list(scenario.robots).index(name), PURPOSES.index(purpose), life)
    return np.random.default_rng(np.random.SeedSequence(scenario.seed, spawn_key=key))


def team_key(scenario: Scenario) -> bytes:
    """Return the team's key: in a simulation it follows from the seed."""
    return b"ropeteam" + scenario.seed.to_bytes(8, "little") * 2
