"""Ways to choose looks at the ground: rasters, the straight edge, ours and what it is made of."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from test_agents_strategies import FRAME, PLANNER, choose, cliff, partly_known, view_of

from agents.geometry import Pose, wrap_angle
from agents.outlook.line import behind_line
from agents.outlook.survey import Look, Survey, after
from agents.outlook.trust import trust
from agents.planning import strategies
from agents.planning.scene import Scene


def wavy(depth: float):
    """Return a plateau north of a wavy edge, and its heights: the pit lies 1 m lower."""
    y, x = np.mgrid[:80, :120] * 0.1
    plateau = y >= 4.0 + depth * np.sin(1.5 * x)
    return plateau, np.where(plateau, 0.0, -1.0)


@pytest.mark.parametrize("depth", [0.0, 0.6])
def test_a_straight_edge_lies_on_the_plateau_all_along(depth):
    plateau, heights = wavy(depth)
    behind = behind_line(plateau, heights, (70, 60), wheel_m=0.2, cell_m=0.1)
    assert behind[70, 60]
    assert plateau[behind].all()
    highest = int(np.nonzero(~plateau)[0].max())
    assert behind[highest + 8 :].all()
    assert behind[:, 5].sum() == pytest.approx(79 - highest, abs=9)


def test_without_a_fall_that_was_measured_there_is_no_line():
    plateau, heights = wavy(0.6)
    unknown = np.where(plateau, heights, np.nan)
    assert behind_line(plateau, unknown, (70, 60), wheel_m=0.2, cell_m=0.1).all()
    assert behind_line(plateau, heights * 0.2, (70, 60), wheel_m=0.2, cell_m=0.1).all()


def test_a_robot_is_on_its_own_side_of_the_line_wherever_it_stands():
    plateau, heights = wavy(0.8)
    spur = (36, int(np.argmax(plateau[36])))
    assert plateau[spur]
    assert behind_line(plateau, heights, spur, wheel_m=0.2, cell_m=0.1)[spur]


def test_method_3_keeps_farther_from_a_wavy_edge_than_method_4():
    view = view_of(np.where(cliff() > -3, cliff(), np.nan))
    line, edge = Scene(view, straight_edge=True), Scene(view)
    behind, inside = np.isfinite(line.cost), np.isfinite(edge.cost)
    assert behind.sum() < 0.95 * inside.sum()
    assert not (behind & ~inside).any()


def raster(name: str, count: int):
    """Return where and which way a raster looks over open ground, one look after another."""
    method, rng = strategies.strategy(name), np.random.default_rng(0)
    view, told = view_of(np.zeros(FRAME.shape), np.zeros(FRAME.shape, dtype=np.int64)), []
    for _ in range(count):
        plan = method.choose(view, rng)
        told.append((plan.target_m, plan.heading_rad))
        view = replace(view, pose=Pose(*plan.target_m, 0.0, plan.heading_rad))
    return told


def test_a_raster_without_yaw_looks_one_way_from_ever_new_places():
    told = raster("raster", 6)
    assert {round(heading, 6) for _, heading in told} == {-1.5}
    places = np.array([place for place, _ in told])
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    assert apart[~np.eye(6, dtype=bool)].min() >= 0.9 * PLANNER.candidate_step_m


def test_a_raster_with_yaw_looks_all_round_before_it_goes_on():
    told = raster("raster-yaw", 13)
    places = [place for place, _ in told]
    assert len(set(places[:6])) == 1
    assert len(set(places[6:12])) == 1
    assert places[6] != places[0]
    assert places[12] not in (places[0], places[6])
    turns = [wrap_angle(b - a) for (_, a), (_, b) in pairwise(told[:6])]
    assert turns == pytest.approx([math.pi / 3] * 5)


@pytest.fixture(scope="module")
def survey() -> Survey:
    return Survey(Scene(view_of(partly_known())))


def test_a_surveyed_gain_is_the_sum_over_what_the_look_shows(survey):
    site = survey.site(survey.scene.cell)
    gains = survey.gains(site, survey.worth)
    for k, t in ((0, 0), (45, 3), (20, 6)):
        look = Look(float(survey.headings_rad[k]), float(survey.tilts_rad[t]), 0.0)
        cells, chance = survey.shown(site, look)
        direct = float((chance * survey.worth[cells]).sum())
        assert gains[k, t] == pytest.approx(direct, rel=0.1, abs=20)


def test_what_a_look_shows_is_worth_nothing_after_it(survey):
    site = survey.site(survey.scene.cell)
    look = survey.best(site, survey.worth)
    left = after(survey.worth, survey.shown(site, look))
    assert (left <= survey.worth).all()
    assert survey.worth.sum() - left.sum() == pytest.approx(look.gain, rel=0.1)
    again = survey.gains(site, left)
    assert again.max() < survey.gains(site, survey.worth).max()


def test_refining_never_loses(survey):
    site = survey.site(survey.scene.cell)
    look = survey.best(site, survey.worth)
    assert survey.refined(site, survey.worth, look).gain >= look.gain - 1e-9


def test_worth_is_the_same_however_coarse_the_grid(survey):
    worth = np.random.default_rng(0).random(FRAME.shape)
    assert survey.joined(worth).sum() == pytest.approx(worth.sum())


def test_ground_is_trusted_until_what_lies_about_it_fails():
    view = view_of(np.full(FRAME.shape, np.nan))
    assert trust(view) == pytest.approx(1.0)
    interest = np.ones(FRAME.shape)
    interest[40:80, 40:80] = math.exp(-1.0)
    failed = trust(replace(view, interest=interest))
    assert 0.2 / 1.2 < failed[60, 60] < 0.25
    assert failed[60, 85] < 0.7
    assert failed[5, 5] == pytest.approx(1.0, abs=0.01)
    measured = np.zeros(FRAME.shape, dtype=np.int64)
    measured[:, 80:] = 1
    better = trust(replace(view, interest=interest, looks=measured))
    assert better[60, 78] > failed[60, 78]


def test_ours_turns_from_ground_that_was_claimed():
    view = view_of(np.where(np.isnan(partly_known()), np.nan, 0.0))
    free = choose(view, "team-information")
    x, y = free.target_m
    claim = (x + 2.5 * math.cos(free.heading_rad), y + 2.5 * math.sin(free.heading_rad), 2.5)
    kept = choose(replace(view, claims=[claim]), "team-information")
    a, b = (
        strategies.expected_visibility(view, Pose(*p.target_m, 0.0, 0.0), p.heading_rad, p.tilt_rad)
        for p in (free, kept)
    )
    inside = Scene(replace(view, claims=[claim])).worth < 0.9 * Scene(view).worth
    assert b[inside].sum() < 0.6 * a[inside].sum()


def test_ours_is_done_when_all_is_mapped_and_decides_alike_twice():
    assert choose(view_of(cliff(), np.full(FRAME.shape, 3)), "team-information") is None
    one, two = (choose(view_of(partly_known()), "team-information") for _ in range(2))
    assert np.array_equal(one.path_m, two.path_m)
    assert replace(one, path_m=two.path_m) == two


def test_a_silent_team_mate_claims_nothing_and_one_that_stands_in_view_is_no_ground():
    view = view_of(partly_known(), others=[Pose(7.5, 9.0, 0.0, 0.0)])
    plan = choose(view, "team-information")
    assert math.dist(plan.target_m, (7.5, 9.0)) > 0.8
