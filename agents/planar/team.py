"""`team-information`: routes of several looks, from what rays are likely to meet in the unknown.

It differs from the paper's fifth method in seven ways:

- rays into the unknown end where the robot has learned that they do (`hazard`), so that the walls
  that go on and the shadows behind them are told from open floor;
- how far the chances of seeing a cell can be trusted is learned too, look by look (`trust`);
- a far cell that a look leaves half sure counts in part, and the rest when it is made sure;
- looks are chosen together: a route over several places, each with all that is worth looking at
  there, by what it shows less what it costs (`routes`); the robot takes its first look, and then
  chooses anew. What shows little, or lies far, waits while much is to be had elsewhere: prices are
  set by the best look anywhere, and come down until some route is worth them;
- pockets of the unknown that would have to be come back for count more than what lies in the midst
  of it (`pockets`);
- the places are refined, down to single cells and degrees;
- cells that team-mates said they will look at, or stand nearer to, count less. Nobody leads: a
  team-mate that falls silent drops out of the view, and with it what it claimed.
"""

import numpy as np

from agents.geometry import Floats, Ints
from agents.ground import paths
from agents.planar.casting import Star, gains, windows, yaw_of
from agents.planar.hazard import Hazard
from agents.planar.looksets import COARSE, look_sets, sectors
from agents.planar.methods import Memory, look_at, seen_by
from agents.planar.pockets import ALONE, pocket_weights
from agents.planar.prospects import Prospects
from agents.planar.routes import Prices, Route, Router
from agents.planar.scene import Means, Scene
from agents.planar.trust import STEPS, Trust
from agents.planar.view import PlanarLook, PlanarView

BLAMED = 4.0
"""Of what was expected and not seen, what was nearly sure to be seen is to blame: this power of
its chances counts. A gap in a wall that is none after all loses interest, not the room behind."""
LOOK_PRICE = 0.3
"""What a look costs, as a share of what the best one anywhere shows ..."""
METRE_PRICE = 0.1
"""... and a metre of the way."""
LOOK_CHEAPER, METRE_CHEAPER = 0.75, 0.5
"""Where no route is worth its price, prices come down by these factors."""
REFINED = ((6, 2), (2, 1))
"""Half widths and steps, in cells, of the squares in which a place is refined."""
THIN = 4
"""Every so manieth ray is cast to tell which places promise anything."""
CLAIMED = 0.1
"""What a cell counts that a team-mate said it will look at."""
THEIRS = 0.5
"""What a cell counts that a team-mate stands nearer to."""


class TeamInformation:
    """Ours; see above."""

    def __init__(self, means: Means) -> None:
        """Begin with nothing seen and nothing learned."""
        self._means = means
        self._memory = Memory(means.planner.beta, sure=BLAMED)
        self._hazard = Hazard()
        self._trust = Trust()

    def choose(self, view: PlanarView, rng: np.random.Generator) -> PlanarLook | None:
        """Return the next look, or None when no look is expected to map `min_gain_cells` cells."""
        frame, means = view.frame, self._means
        interest = self._memory.interest(view)
        solid_p = self._hazard.take(view)
        pass_p = interest * (1.0 - solid_p)
        worth = interest * _not_theirs(view)
        self._trust.take(view.log_odds)
        trust = self._trust.table()
        least = max(means.planner.min_gain_cells, 1e-9)
        open_p = np.where(view.mapped, 0.0, pass_p)
        weights = pocket_weights(open_p, frame.cell_m, means.sensor.range_m)
        scene = Scene(view, means, worth * weights, pass_p=pass_p)
        places = scene.lattice(rng)
        prospects = Prospects(scene, _promising(scene, places, trust), trust)
        if prospects.best() < ALONE * least:  # scraps are left: all of them count alike
            weights = np.ones_like(weights)
            scene = Scene(view, means, worth, pass_p=pass_p)
            prospects = Prospects(scene, _promising(scene, places, trust), trust)
        if prospects.best() < least:  # the lattice may have stepped over a passage
            prospects = Prospects(scene, _promising(scene, scene.everywhere(), trust), trust)
        best = prospects.best()
        if best < least:
            return None
        router = Router(scene, prospects)
        prices, route = _dearest(router, best, least)
        cell, first, gain = _refined(scene, router, prospects, route, prices, trust, weights)
        seen_p = seen_by(scene, cell, first)
        self._trust.expect(seen_p, view.log_odds)
        self._memory.expect_seen(view, trust[np.rint(seen_p * STEPS).astype(np.int64)])
        yaw_rad = float(yaw_of(np.array(first), scene.rays.width))
        return look_at(scene, cell, yaw_rad, gain)


def _not_theirs(view: PlanarView) -> Floats:
    """Return by how much cells (rows, cols) count, given what team-mates do."""
    frame, share = view.frame, np.ones(view.frame.shape)
    rows, cols = np.indices(frame.shape)
    x_m = frame.x_m + (cols + 0.5) * frame.cell_m
    y_m = frame.y_m + (rows + 0.5) * frame.cell_m
    own_m = np.hypot(x_m - view.pose.x_m, y_m - view.pose.y_m)
    for other in view.others:
        share[np.hypot(x_m - other.x_m, y_m - other.y_m) < own_m] = THEIRS
    for x, y, radius_m in view.claims:
        share[np.hypot(x_m - x, y_m - y) < radius_m] = CLAIMED
    return share


def _promising(scene: Scene, places: Ints, trust: Floats) -> Ints:
    """Return those of some places (E, 2) from which the most may be seen, its own first."""
    most = scene.means.planner.max_candidates
    if len(places) <= most:
        return places
    rays = _thinned(scene.rays)
    shown = gains(scene.through, scene.lacking, scene.worth, rays, places, trust=trust)
    promise = windows(shown, rays.width).max(axis=1)
    promise[0] = np.inf
    best = np.argsort(-promise, kind="stable")[:most]
    return places[np.sort(best[promise[best] > 0])]


def _thinned(rays: Star) -> Star:
    part = slice(THIN // 2, None, THIN)
    return Star(
        rays.steps[part], rays.counts[part], rays.range_m[part], rays.sure[part],
        max(1, rays.width // THIN),
    )  # fmt: skip


def _dearest(router: Router, best: float, least: float) -> tuple[Prices, Route]:
    """Return a route at the highest prices at which one is worth them.

    That of a look comes down more slowly: what shows little waits, while more is not too far.
    """
    prices = Prices(max(least, LOOK_PRICE * best), METRE_PRICE * best)
    while True:
        route = router.best(prices)
        if route:
            return prices, route
        prices = Prices(LOOK_CHEAPER * prices.look, METRE_CHEAPER * prices.metre)


def _refined(
    scene: Scene,
    router: Router,
    prospects: Prospects,
    route: Route,
    prices: Prices,
    trust: Floats,
    weights: Floats,
) -> tuple[tuple[int, int], int, float]:
    """Return the best cell about a route's first place, and its best look's first ray and gain.

    The gain is in cells: what cells count beyond one, by `weights` (rows, cols), is taken off.
    """
    stop, cell_m = route[0], scene.view.frame.cell_m
    left = router.left_by(route[1:]).reshape(scene.view.frame.shape)
    onward_m = np.zeros(scene.view.frame.shape)
    if len(route) > 1:
        after = prospects.places[route[1].place]
        onward_m, _ = paths.travel_field(scene.cost, after[None], cell_m)
    place, looks = prospects.places[stop.place], len(stop.looks)
    first = 0
    for half, step in REFINED:
        around = _around(scene, place, half, step)
        ring = sectors(gains(scene.through, scene.lacking, left, scene.rays, around, trust=trust))
        shown, firsts = look_sets(ring, prospects.width, looks)
        row, col = around[:, 0], around[:, 1]
        way_m = scene.way_m[row, col] + onward_m[row, col]
        best = int(np.argmax(shown[:, -1].sum(axis=1) - prices.metre * way_m))
        place = around[best]
        first = COARSE * int(firsts[best, -1, 0])
    cells = gains(
        scene.through, scene.lacking, left / weights, scene.rays, place[None], trust=trust
    )
    gain = float(windows(cells, scene.rays.width)[0, first])
    return (int(place[0]), int(place[1])), first, gain


def _around(scene: Scene, place: Ints, half: int, step: int) -> Ints:
    """Return the cells (N, 2) about a place that can be driven to, itself first."""
    side = np.arange(-half, half + 1, step)
    square = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    around = np.concatenate((place[None], place + square))
    inside = ((around >= 0) & (around < np.array(scene.view.frame.shape))).all(axis=1)
    around = around[inside]
    return around[np.isfinite(scene.way_m[around[:, 0], around[:, 1]])]
