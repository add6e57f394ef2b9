import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import Singles
from scenarios.records.summary import (
    Ending,
    HostCost,
    ProcessCost,
    RobotFinal,
    State,
    Truth,
    host_facts,
    score,
    summarise,
    survivors,
    union_map,
    write_json,
)
from scenarios.records.tables import LookRow, Records, RxRow, TxRow
from scenarios.schema import load

NAN = float("nan")


def grid(*rows: list[float]) -> Singles:
    return np.array(rows, np.float32)


def robot(
    name: str,
    elevation_m: Singles | None = None,
    sigma_m: Singles | None = None,
    state: State = "alive",
    digest: str = "aa",
) -> RobotFinal:
    return RobotFinal(
        name, state, 5, 9, digest, 1.5, 70, 0.25, {"lost": 2, "damaged": 1}, elevation_m, sigma_m
    )


TRUTH = Truth(grid([0, 0, 0], [1, 1, NAN]), np.array([[True, True, False], [True, True, False]]))


def test_the_score_of_a_hand_worked_map() -> None:
    sigma_m = grid([0.11, NAN, 0.1], [np.inf, NAN, 0.0])
    result = score(grid([0.3, NAN, 0.4], [1.0, NAN, 7.0]), sigma_m, TRUTH)
    assert result.mapped_cells == 2  # of the four observable ones
    assert result.coverage == 0.5
    assert result.rmse_m == pytest.approx(np.sqrt((0.09 + 0.16 + 0) / 3), rel=1e-6)
    assert result.p95_m == pytest.approx(np.percentile([0.3, 0.4, 0.0], 95), rel=1e-6)
    assert result.within_3_sigma == pytest.approx(2 / 3)  # 0.4 m is four of its own


def test_the_score_of_nothing() -> None:
    nothing = np.full((2, 3), np.nan, np.float32)
    result = score(nothing, nothing, TRUTH)
    assert (result.mapped_cells, result.coverage) == (0, 0.0)
    assert (result.rmse_m, result.p95_m, result.within_3_sigma) == (None, None, None)
    blind = Truth(TRUTH.elevation_m, np.zeros((2, 3), bool))
    flat = grid([0, 0, 0], [0, 0, 0])
    assert score(flat, flat, blind).coverage == 0.0


def test_the_union_takes_the_surest_of_each_cell() -> None:
    one = robot("a", grid([1, NAN, 3]), grid([0.1, 0.1, 0.5]))
    two = robot("b", grid([2, 2, 4]), grid([0.2, 0.2, 0.2]))
    none = robot("c")
    for team in ([one, two, none], [two, none, one]):
        elevation_m, sigma_m = union_map(team, (1, 3))
        assert elevation_m.tolist() == [[1, 2, 4]]
        assert sigma_m.tolist() == grid([0.1, 0.2, 0.2]).tolist()
    assert np.isnan(union_map([none], (1, 3))[0]).all()


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_union_has_every_cell_that_anybody_has(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robots: list[RobotFinal] = []
    for name in "abc":
        elevation_m = rng.normal(size=(4, 5)).astype(np.float32)
        elevation_m[rng.random((4, 5)) < 0.5] = np.nan
        robots.append(robot(name, elevation_m, rng.random((4, 5)).astype(np.float32)))
    whole, _ = union_map(robots, (4, 5))
    known = [np.isfinite(r.elevation_m) for r in robots if r.elevation_m is not None]
    assert (np.isfinite(whole) == np.logical_or.reduce(known)).all()
    np.testing.assert_array_equal(whole, union_map(robots[::-1], (4, 5))[0])


def test_the_team_is_who_is_alive_or_all_where_nobody_is() -> None:
    dead = [robot("a", state="killed"), robot("b", state="stopped"), robot("c", state="left")]
    assert survivors([*dead, robot("d")]) == [robot("d")]
    assert survivors(dead) == dead


def rows() -> list[LookRow | TxRow | RxRow]:
    return [
        LookRow("recon", 15.0, 1, 2, 3, 0, 0, 10, 9, 9, 0.0, 0.1),
        LookRow("recon", 40.0, 1, 2, 3, 0, 0, 10, 9, 3, 2.0, 0.2),
        TxRow("recon", 0, "map", 100, 10.0, 10.0, 30.0),
        TxRow("recon", 1, "map", 50, 30.0, 30.0, 40.0),
        TxRow("cliffbot", 0, "tether", 30, 35.0, 35.0, 36.0),
        RxRow("cliffbot", "recon", 0, 30.1, "delivered"),
        RxRow("anchor-left", "recon", 0, 30.1, "lost"),
        RxRow("anchor-left", "recon", 1, 40.1, "delivered"),
    ]


def summary(seed: int = 0, digests: str = "aa") -> dict[str, Any]:
    records = Records(list(load("cliff").robots))
    made = rows()
    random.Random(seed).shuffle(made)
    for row in sorted(made, key=lambda row: isinstance(row, LookRow)):
        records.add(row)
    elevation_m = grid([0.3, NAN, 0.4], [1.0, NAN, 7.0])
    sigma_m = np.full((2, 3), 0.1, np.float32)
    finals = [
        robot("recon", np.zeros((2, 3), np.float32), sigma_m * 0.1, "killed", "00"),
        robot("cliffbot", elevation_m, sigma_m, digest="aa"),
        robot("anchor-left", elevation_m, sigma_m, digest=digests),
        robot("anchor-right", digest="aa"),
    ]
    random.Random(seed).shuffle(finals)
    mission = {"cliffbot_reached": True, "safe_path_at_s": 640.5, "hazards_hit": 0}
    ending = Ending(100.0, "partial", "the RECON-bot was killed", dict(mission))
    return summarise(load("cliff"), records, finals, TRUTH, ending)


def test_the_summary_has_exactly_the_keys_that_studies_read() -> None:
    found = summary()
    assert set(found) == {
        *("schema", "scenario", "seed", "clock", "simulated_s", "outcome", "outcome_reason"),
        *("robots", "team", "mission"),
    }
    assert set(found["robots"]["recon"]) == {
        *("role", "state", "looks", "distance_m", "sent_frames", "sent_bytes", "received_frames"),
        *("received_bytes", "dropped_frames", "link_busy_fraction", "own_cells", "team_cells"),
        *("team_map_digest", "map_payload_bytes", "pose_error_rms_m", "hazards_hit"),
    }
    assert set(found["team"]) == {
        *("observable_cells", "mapped_cells", "coverage", "elevation_rmse_m"),
        *("elevation_error_p95_m", "within_3_sigma", "maps_equal"),
    }
    head = {key: found[key] for key in ("schema", "scenario", "seed", "clock")}
    assert head == {"schema": 1, "scenario": "cliff", "seed": 1, "clock": "virtual"}


def test_a_hand_worked_summary() -> None:
    found = summary()
    recon, cliffbot = found["robots"]["recon"], found["robots"]["cliffbot"]
    assert (recon["role"], recon["state"], recon["looks"]) == ("recon", "killed", 2)
    assert (recon["sent_frames"], recon["sent_bytes"]) == (2, 150)
    assert recon["link_busy_fraction"] == pytest.approx(0.3)
    assert (cliffbot["received_frames"], cliffbot["received_bytes"]) == (1, 70)
    assert list(cliffbot["dropped_frames"]) == ["damaged", "lost"]
    assert found["robots"]["anchor-right"]["received_frames"] == 0
    team = found["team"]
    assert (team["observable_cells"], team["mapped_cells"], team["coverage"]) == (4, 2, 0.5)
    assert team["elevation_rmse_m"] > 0.1  # of the survivors: the dead robot's would be 0.58 / 5
    assert team["maps_equal"]
    assert found["mission"]["safe_path_at_s"] == 640.5


def test_maps_differ_where_one_survivor_has_another_digest() -> None:
    assert not summary(digests="bb")["team"]["maps_equal"]


@pytest.mark.parametrize("seed", range(4))
def test_the_file_is_the_same_byte_for_byte_in_whatever_order_things_came(
    seed: int, tmp_path: Path
) -> None:
    write_json(tmp_path / "one.json", summary())
    write_json(tmp_path / "two.json", summary(seed))
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()
    assert json.loads((tmp_path / "one.json").read_text()) == summary()


def test_what_json_does_not_know_is_written_plainly(tmp_path: Path) -> None:
    facts = {"a": np.float32(0.5), "b": np.int64(3), "c": NAN, "d": {"e": np.bool_(True)}}
    write_json(tmp_path / "x.json", facts)
    assert json.loads((tmp_path / "x.json").read_text()) == {
        "a": 0.5,
        "b": 3,
        "c": None,
        "d": {"e": True},
    }


def test_host_facts_tell_compilation_apart() -> None:
    cost = HostCost(20.0, 9.0, 2.5, 777, {"recon": ProcessCost(3.0, 10**8)})
    facts = host_facts(cost)
    assert (facts["wall_s"], facts["compile_s"], facts["startup_s"]) == (20.0, 9.0, 2.5)
    assert facts["grants"] == 777
    assert facts["processes"]["recon"] == {"cpu_s": 3.0, "peak_memory_bytes": 10**8}
