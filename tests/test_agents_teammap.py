"""The team map: nobody's measurement counts twice, and no news makes it worse."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from team_helpers import (
    FRAME,
    GRID,
    KINDS,
    LOOKS,
    MAX_ERROR_M,
    START,
    SURE,
    certainty,
    chunks_of,
    cut,
    hear,
    hear_anchors,
    layer,
    look,
    looks_in,
    mask_of,
    payload_of,
    team_map,
    truth_m,
)

from agents.fusion import Gaussian, merge
from agents.geometry import GridFrame, Pose
from agents.layers import Anchor, OwnLayer
from agents.maps.elevation import (
    UNIFORM,
    Estimate,
    Submap,
    blank,
    cell_variance,
    fuse_origins,
    slope_of,
    surest,
)
from agents.maps.elevationlook import LookCells
from agents.maps.kind import EVERYWHERE
from agents.payloads import Pyramid
from agents.store import AnchorKey, Chunk, Origin, Store, TileKey
from agents.teammap import TeamMap, TileGrid
from agents.voxel.frame import VoxelFrame
from agents.voxel.tiles import VoxelTiles
from comms.codec import encode_tile

quick = settings(max_examples=25, deadline=None)
seeds = st.integers(0, 2**32 - 1)
ME, MATE, THIRD = Origin(0, 0), Origin(1, 0), Origin(2, 0)


def same(one: Estimate, other: Estimate) -> bool:
    """Say whether two maps are equal to the last bit."""
    return (
        np.array_equal(one.elevation_m, other.elevation_m, equal_nan=True)
        and np.array_equal(one.variance_m2, other.variance_m2)
        and np.array_equal(one.looks, other.looks)
    )


# --- tiles ----------------------------------------------------------------------------------


@given(st.integers(1, 50), st.integers(1, 50), st.sampled_from([16, 32]), seeds)
@quick
def test_tiles_part_the_grid_and_are_found_by_their_cells(
    rows: int, cols: int, side: int, seed: int
) -> None:
    grid = TileGrid(GridFrame(0.0, 0.0, 1.0, rows, cols), side)
    covered = np.zeros((rows, cols), dtype=int)
    for tile in range(grid.count):
        covered[grid.window(tile)] += 1
        assert 0 < covered[grid.window(tile)].size <= side * side
    assert np.all(covered == 1)
    mask = np.random.default_rng(seed).random((rows, cols)) < 0.01
    assert grid.touched(mask) == [t for t in range(grid.count) if mask[grid.window(t)].any()]


@given(st.integers(1, 6), st.integers(1, 6), st.integers(0, 3), st.integers(0, 3), seeds)
@quick
def test_a_region_numbers_its_tiles_as_the_whole_does(
    rows: int, cols: int, row0: int, col0: int, seed: int
) -> None:
    side, cell_m = 16, 0.25
    whole = GridFrame(-3.0, 5.0, cell_m, (row0 + rows + 1) * side, (col0 + cols + 1) * side - 5)
    corner = (whole.x_m + col0 * side * cell_m, whole.y_m + row0 * side * cell_m)
    region = GridFrame(*corner, cell_m, rows * side, cols * side)
    all_of_it, part = TileGrid(whole, side), TileGrid(region, side, whole)
    mask = np.zeros(whole.shape, dtype=bool)
    inside = (
        slice(row0 * side, (row0 + rows) * side),
        slice(col0 * side, (col0 + cols) * side),
    )
    mask[inside] = np.random.default_rng(seed).random(region.shape) < 0.01
    assert part.touched(mask[inside]) == all_of_it.touched(mask)
    assert part.count == all_of_it.count
    for tile in all_of_it.tiles:
        window = all_of_it.window(tile)
        within = all(a.start <= b.start < a.stop for a, b in zip(inside, window, strict=True))
        assert part.holds(tile) == within
        if within:
            assert np.array_equal(mask[inside][part.window(tile)], mask[window])
            held = tuple(other for other in all_of_it.beside(tile) if part.holds(other))
            assert part.beside(tile) == held


@given(st.tuples(*[st.integers(1, 70)] * 3), st.sampled_from([16, 32]))
@quick
def test_cubes_part_space_and_share_faces_with_those_beside_them(
    voxels: tuple[int, int, int], side: int
) -> None:
    layers, rows, cols = voxels
    grid = VoxelTiles(VoxelFrame(0.0, 0.0, 1.0, rows, cols, 0.0, layers), side)
    covered = np.zeros(grid.cells, dtype=int)
    for tile in range(grid.count):
        covered[grid.window(tile)] += 1
        assert grid.shape(tile) == (side,) * 3
        assert grid.number(grid.place(tile)) == tile
        for other in grid.beside(tile):
            apart = np.abs(np.subtract(grid.place(tile), grid.place(other)))
            assert apart.sum() == 1
            assert tile in grid.beside(other)
    assert np.all(covered == 1)
    assert all(a <= b < a + side for a, b in zip(voxels, grid.cells, strict=True))


# --- adding up ------------------------------------------------------------------------------

cells = st.tuples(st.floats(-50, 50), st.floats(1e-6, 100) | st.just(math.inf))


def one_cell(mean: float, variance: float) -> Estimate:
    known = math.isfinite(variance)
    return Estimate(
        np.array([[mean if known else math.nan]]),
        np.array([[variance]]),
        np.array([[int(known)]], dtype=np.uint16),
    )


@given(st.lists(cells, min_size=1, max_size=5))
@quick
def test_origins_add_up_as_the_papers_gaussians_multiply(
    measured: list[tuple[float, float]],
) -> None:
    """Eqs. 20 and 21; who knows nothing adds nothing."""
    fused = fuse_origins([one_cell(*m) for m in measured], (1, 1))
    known = [m for m in measured if math.isfinite(m[1])]
    assert fused.looks[0, 0] == len(known)
    if not known:
        assert (math.isnan(fused.elevation_m[0, 0]), fused.known[0, 0]) == (True, False)
        return
    product = Gaussian(np.array([known[0][0]]), np.array([[known[0][1]]]))
    for mean, variance in known[1:]:
        product = merge(product, Gaussian(np.array([mean]), np.array([[variance]])))
    assert fused.elevation_m[0, 0] == pytest.approx(product.mean[0], abs=1e-6)
    assert fused.variance_m2[0, 0] == pytest.approx(product.covariance[0, 0])


@given(st.lists(cells, min_size=1, max_size=5))
@quick
def test_of_one_origin_the_surest_counts_and_nothing_adds_up(
    measured: list[tuple[float, float]],
) -> None:
    result = blank((1, 1))
    for m in measured:
        result = surest(result, one_cell(*m))
    best = min(variance for _, variance in measured)
    assert result.variance_m2[0, 0] == best
    if math.isfinite(best):
        assert result.elevation_m[0, 0] in [mean for mean, v in measured if v == best]


# --- the map of a team ----------------------------------------------------------------------


@given(seeds)
@quick
def test_a_payload_that_comes_round_again_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    theirs, third = layer(rng, submaps=2), layer(rng)
    team = team_map(ME, layer(rng))
    hear(team, [*chunks_of(theirs, MATE), *chunks_of(third, THIRD)])
    hear_anchors(team, theirs, MATE)
    hear_anchors(team, third, THIRD)
    fused, entries, digest = team.fused(), team.known_entries(), team.store.digest()
    relayed = [piece for chunk in chunks_of(theirs, MATE) for piece in cut(chunk, 19)]
    hear(team, relayed[::-1])
    hear_anchors(team, theirs, MATE)
    team.own_changed()
    assert same(team.fused(), fused)
    assert (team.known_entries(), team.store.digest()) == (entries, digest)


@given(seeds, st.randoms(use_true_random=False))
@quick
def test_equal_stores_give_equal_maps_whatever_the_order_of_arrival(seed: int, luck) -> None:
    rng = np.random.default_rng(seed)
    theirs, third = layer(rng), layer(rng)
    heard = [
        piece
        for chunk in [*chunks_of(theirs, MATE), *chunks_of(third, THIRD)]
        for piece in cut(chunk, 23)
    ]
    maps: list[TeamMap] = []
    for _ in range(2):
        maps.append(team_map(ME))
        hear(maps[-1], heard)
        hear_anchors(maps[-1], theirs, MATE)
        hear_anchors(maps[-1], third, THIRD)
        luck.shuffle(heard)
    assert maps[0].store.digest() == maps[1].store.digest()
    assert same(maps[0].fused(), maps[1].fused())


def measured_information(own: OwnLayer) -> np.ndarray:
    """Return what one origin truly measured: submaps share its drift, so the best one counts."""
    return np.max([submap.information for submap in own.submaps], axis=0)


@given(seeds)
@quick
def test_the_team_never_knows_more_than_its_robots_measured(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mine, theirs, third = layer(rng), layer(rng, submaps=2), layer(rng)
    team = team_map(ME, mine)
    hear(team, [*chunks_of(theirs, MATE), *chunks_of(third, THIRD)])
    hear_anchors(team, theirs, MATE)
    hear_anchors(team, third, THIRD)
    measured = sum(measured_information(own) for own in (mine, theirs, third))
    for fused in (team.fused(), team.as_heard()):
        assert np.all(1.0 / fused.variance_m2 <= measured * (1 + 1e-9))
        assert np.array_equal(fused.known, measured > 0)
    assert np.all(team.as_heard().variance_m2 >= team.fused().variance_m2 * (1 - 1e-12))
    assert team.known_entries() == sum(own.known_cells() for own in (mine, theirs, third))


@given(seeds)
@quick
def test_a_listener_can_know_of_a_layer_what_its_robot_counts_as_heard(seed: int) -> None:
    own = layer(np.random.default_rng(seed), submaps=2)
    teller, listener = team_map(MATE, own), team_map(ME)
    hear(listener, chunks_of(own, MATE))
    hear_anchors(listener, own, MATE)
    told, heard = teller.as_heard(), listener.fused()
    assert np.array_equal(told.known, heard.known)
    # All but equal: the slopes that the anchor's variance is spread by are those of what is known.
    assert np.allclose(told.variance_m2[told.known], heard.variance_m2[told.known], rtol=0.02)
    difference = np.abs(told.elevation_m - heard.elevation_m)[told.known]
    assert np.all(difference <= MAX_ERROR_M + 1e-6)


def test_within_an_origin_the_surest_submap_counts() -> None:
    own = OwnLayer(FRAME, Submap)
    for variance, west in ((0.0, 0), (0.5, 5)):
        own.begin_submap(START, SURE + np.diag([0, 0, variance, 0]))
        rows, cols = np.indices((10, 10)).reshape(2, -1)
        n = rows.size
        own.submaps[-1].observe(LookCells(rows, cols + west, np.zeros(n), np.full(n, 1e-3)))
    team = team_map(ME)
    hear(team, chunks_of(own, MATE))
    hear_anchors(team, own, MATE)
    first, second = (s.known for s in own.submaps)
    variance = team.fused().variance_m2
    assert np.all(variance[first] < 0.1), "the sure submap's, not a mixture with the unsure one"
    assert np.all(variance[second & ~first] > 0.5)


def test_a_submap_without_anchor_lies_nowhere_until_its_anchor_comes() -> None:
    own = layer(np.random.default_rng(5))
    team = team_map(ME)
    hear(team, chunks_of(own, MATE))
    assert not team.fused().known.any()
    assert team.known_entries() == own.known_cells()
    hear_anchors(team, own, MATE)
    assert np.array_equal(team.fused().known, own.submaps[0].known)


def test_what_was_measured_by_its_own_robot_is_not_taken_from_the_store_too() -> None:
    own = layer(np.random.default_rng(6))
    alone, told = team_map(ME, own), team_map(ME, own)
    hear(told, chunks_of(own, ME))
    hear_anchors(told, own, ME)
    assert same(alone.fused(), told.fused())
    assert told.known_entries() == own.known_cells()


def test_a_former_life_counts_beside_the_present_one() -> None:
    rng = np.random.default_rng(7)
    before, now = layer(rng), layer(rng)
    team = team_map(Origin(0, 1), now)
    hear(team, chunks_of(before, Origin(0, 0)))
    hear_anchors(team, before, Origin(0, 0))
    assert np.array_equal(team.fused().known, before.submaps[0].known | now.submaps[0].known)
    assert np.array_equal(team.published_mask(Origin(0, 0), 0), before.submaps[0].known)
    assert not team.published_mask(Origin(0, 1), 0).any()


# --- tile by tile ---------------------------------------------------------------------------


def equal(one: Any, other: Any) -> bool:
    """Say whether two maps of any kind are equal to the last bit."""
    if isinstance(one, Estimate):
        return same(one, other)
    return np.array_equal(certainty(one), certainty(other)) and np.array_equal(
        looks_in(one), looks_in(other)
    )


def laid_whole(team: TeamMap, layers: dict[Origin, OwnLayer], *, blurred: bool) -> Any:
    """Return the team map by slow code: every submap on the whole grid at once."""
    kind, grid = team.kind, team.grid
    folds: list[Any] = []
    for origin, own in sorted(layers.items()):
        fold = kind.blank(grid.cells)
        for index, submap in enumerate(own.submaps):
            anchor = submap.anchor
            if origin == team.me:
                drawing = kind.drawn(submap, EVERYWHERE)
            else:
                anchor = team.store.anchors.get(AnchorKey(*origin, index))
                drawing = kind.blank(grid.cells)
                for tile in range(grid.count):
                    heard = team.tile_estimate(TileKey(*origin, index, tile))
                    kind.paste(drawing, grid.window(tile), heard)
            if anchor is None:
                continue
            if anchor.is_moved:
                drawing = kind.moved(drawing, anchor, grid.frame)
            placed = kind.blurred(drawing, anchor, grid.frame) if blurred else drawing
            fold = kind.surest(fold, placed)
        folds.append(fold)
    return kind.fuse(folds, grid.cells)


@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_what_is_laid_tile_by_tile_is_what_is_laid_at_once_to_the_last_bit(
    kind: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    layers = {
        ME: layer(rng, submaps=2, kind=kind),
        MATE: layer(rng, submaps=2, kind=kind),
        THIRD: layer(rng, kind=kind),
    }
    team = team_map(ME, layers[ME], kind=kind)
    news = [*chunks_of(layers[MATE], MATE), *chunks_of(layers[THIRD], THIRD)]
    for chunk in rng.permutation(np.array(news, dtype=object)):
        hear(team, [chunk])
        for key in {AnchorKey(*MATE, 0), AnchorKey(*MATE, 1), AnchorKey(*THIRD, 0)}:
            anchor = layers[Origin(*key[:2])].submaps[key.submap].anchor
            if rng.random() < 0.2 and team.store.offer_anchor(key, anchor):
                team.anchor_changed(key)
        known = team.store.anchors.get(AnchorKey(*MATE, 1))
        if known is not None and rng.random() < 0.2:
            there = Pose(known.pose.x_m + 0.3, known.pose.y_m - 0.2, known.pose.z_m, 0.02)
            team.store.offer_anchor(AnchorKey(*MATE, 1), known.moved_to(there, known.variance))
            team.anchor_changed(AnchorKey(*MATE, 1))
        if rng.random() < 0.3:
            seen = LOOKS[kind](rng)
            layers[ME].submaps[-1].observe(seen)
            team.own_tiles_changed(1, team.grid.touched(mask_of(seen)))
        assert equal(team.fused(), laid_whole(team, layers, blurred=True))
        assert equal(team.relative(), laid_whole(team, layers, blurred=False))
    bits = team.layer_bits()
    team.own_changed()
    team.as_heard()
    assert team.layer_bits() == bits


# --- anchors --------------------------------------------------------------------------------


@given(seeds, st.integers(-4, 4), st.integers(-4, 4), st.integers(-900, 900))
@quick
def test_a_moved_anchor_moves_the_map(seed: int, east: int, north: int, up_mm: int) -> None:
    own = layer(np.random.default_rng(seed))
    team = team_map(ME)
    hear(team, chunks_of(own, MATE))
    hear_anchors(team, own, MATE)
    before = team.fused()
    anchor = own.submaps[0].anchor
    better = Pose(
        anchor.pose.x_m + east * FRAME.cell_m,
        anchor.pose.y_m + north * FRAME.cell_m,
        anchor.pose.z_m + up_mm / 1000,
        anchor.pose.yaw_rad,
    )
    key = AnchorKey(*MATE, 0)
    team.store.offer_anchor(key, anchor.moved_to(better, anchor.variance))
    team.own_changed()
    after = team.fused()
    for row, col in np.argwhere(before.known):
        to = (row + north, col + east)
        if FRAME.holds(*to):
            lifted = before.elevation_m[row, col] + up_mm / 1000
            assert after.elevation_m[to] == pytest.approx(lifted, abs=1e-6)
    assert np.count_nonzero(after.known) <= np.count_nonzero(before.known)
    # Told again at the old pose, with a higher version: everything lies where it lay.
    back = team.store.anchors[key].moved_to(anchor.pose, anchor.variance)
    team.store.offer_anchor(key, back)
    team.own_changed()
    assert np.array_equal(team.fused().elevation_m, before.elevation_m, equal_nan=True)


def test_an_unsure_anchor_makes_its_cells_unsure() -> None:
    own = layer(np.random.default_rng(8))
    team = team_map(ME)
    hear(team, chunks_of(own, MATE))
    unsure = Anchor.at(START, (0.04, 0.04, 0.09, 1e-4))
    team.store.offer_anchor(AnchorKey(*MATE, 0), unsure)
    drawing = team.as_heard()
    added = cell_variance(unsure, FRAME, slope_of(drawing.elevation_m, FRAME.cell_m))
    known = own.submaps[0].known
    assert np.all(drawing.variance_m2[known] >= (added + own.submaps[0].estimate(
        (slice(None), slice(None)))[1])[known])  # fmt: skip


# --- versions -------------------------------------------------------------------------------


def two_versions(seed: int) -> tuple[OwnLayer, list[Chunk], list[Chunk]]:
    rng = np.random.default_rng(seed)
    own = layer(rng)
    older = chunks_of(own, MATE, version=1)
    for _ in range(2):
        own.submaps[0].observe(look(rng))
    return own, older, chunks_of(own, MATE, version=2)


@given(seeds, st.integers(1, 40))
@quick
def test_a_newer_version_that_is_here_in_part_makes_no_cell_worse(seed: int, size: int) -> None:
    own, older, newer = two_versions(seed)
    team = team_map(ME)
    hear_anchors(team, own, MATE)
    hear(team, older)
    for chunk in newer:
        for piece in cut(chunk, size)[:-1]:
            before = team.tile_estimate(chunk.key)
            hear(team, [piece])
            after = team.tile_estimate(chunk.key)
            assert np.all(after.variance_m2 <= before.variance_m2)


@given(seeds, st.integers(1, 40))
@quick
def test_no_piece_of_news_loses_a_cell_or_breaks_the_error_bound(seed: int, size: int) -> None:
    own, older, newer = two_versions(seed)
    team = team_map(ME)
    hear_anchors(team, own, MATE)
    for chunk in [*older, *newer]:
        for piece in cut(chunk, size):
            known, entries = team.fused().known, team.known_entries()
            hear(team, [piece])
            assert not (known & ~team.fused().known).any()
            assert team.known_entries() >= entries
    submap = own.submaps[0]
    elevation, variance = submap.estimate((slice(None), slice(None)))
    heard = team.as_heard()
    assert np.array_equal(heard.known, submap.known), "the last level's mask is exact"
    assert np.all(np.abs(heard.elevation_m - elevation)[submap.known] <= MAX_ERROR_M + 1e-6)
    floor = variance + MAX_ERROR_M**2 * UNIFORM
    assert np.all(heard.variance_m2[submap.known] >= floor[submap.known] * (1 - 1e-5))


@given(seeds, st.integers(1, 60))
@quick
def test_every_prefix_says_truly_how_wrong_it_may_be(seed: int, size: int) -> None:
    own = layer(np.random.default_rng(seed))
    elevation = own.submaps[0].estimate((slice(None), slice(None)))[0]
    team = team_map(ME)
    for chunk in chunks_of(own, MATE):
        for piece in cut(chunk, size):
            hear(team, [piece])
            for version in team.store.versions(chunk.key):
                tile = Pyramid().decode(version.prefix, GRID.shape(chunk.key.tile))
                if tile is None or tile.level < 0:
                    continue
                error = np.abs(tile.elevation_m - elevation[GRID.window(chunk.key.tile)])
                assert np.all(error[tile.known] <= tile.bound_m + 1e-6)


def test_a_tile_that_is_cut_otherwise_than_the_teams_is_left_out() -> None:
    team = team_map(ME)
    shape = (8, 8)
    data = encode_tile(np.zeros(shape), np.ones(shape, bool), np.full(shape, 0.1), 0.05).data
    key = TileKey(*MATE, 0, 0)
    hear(team, [Chunk(key, 1, len(data), 0, data)])
    team.store.offer_anchor(AnchorKey(*MATE, 0), Anchor.at(START, (0.0, 0.0, 0.0, 0.0)))
    team.own_changed()
    assert not team.fused().known.any()
    assert team.known_entries() == 0


# --- counting -------------------------------------------------------------------------------


def test_information_is_counted_against_the_prior_and_never_negative() -> None:
    variance = np.array([[0.25, 1 / 64, 4.0, np.inf]])
    estimate = Estimate(np.zeros((1, 4)), variance, np.zeros((1, 4), dtype=np.uint16))
    assert estimate.information_bits(1.0) == pytest.approx(1 + 3)


def test_what_is_drawn_is_the_truth_within_noise() -> None:
    own = OwnLayer(FRAME, Submap)
    own.begin_submap(START, SURE)
    rng = np.random.default_rng(9)
    for _ in range(8):
        own.submaps[0].observe(look(rng, 0.01))
    team = team_map(ME, store=Store())
    hear(team, chunks_of(own, MATE))
    hear_anchors(team, own, MATE)
    fused = team.fused()
    assert np.all(np.abs(fused.elevation_m - truth_m())[fused.known] < MAX_ERROR_M + 0.06)
    assert len(payload_of(own.submaps[0], 0)) < 16 * 16
