"""Routes over several places, chosen together: what all their looks show, less what they cost.

A route is worth

    sum of gains - look price x looks - metre price x metres

where what one look shows counts for no other. It's an orienteering problem with a submodular
reward, so it is built by the best insertion (a place with its best set of looks, or more looks at a
place that is on the way already, wherever in the order that costs the shortest detour), its order
is mended by turning stretches round and moving single stops, and then each stop in turn is taken
out and the best that can be put in without it is put in, as long as that is worth more. So a
pocket beside the way is swept when the robot passes, and none is gone back for that isn't worth it.
"""

from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Ints
from agents.ground import paths
from agents.planar.prospects import Prospects
from agents.planar.scene import Scene

MOST_LOOKS = 5
"""Looks that are put in at one place at a time."""
MOST_STOPS = 12
"""Places on a route."""
SWEEPS = 2
"""How often each stop is taken out and tried anew."""
LEAST = 1e-6
"""A change that betters a route by less is none."""


@dataclass(frozen=True)
class Prices:
    """What effort costs, in cells."""

    look: float
    metre: float


@dataclass(frozen=True)
class Stop:
    """A place (index) and the first sectors of the looks there."""

    place: int
    looks: tuple[int, ...]


@dataclass(frozen=True)
class _Insertion:
    net: float
    stop: Stop
    at: int


Route = tuple[Stop, ...]


class Router:
    """Finds routes over places from where the robot stands."""

    def __init__(self, scene: Scene, prospects: Prospects) -> None:
        """Take what there is to be seen."""
        self._scene = scene
        self._prospects = prospects
        places = prospects.places
        self._way_m = scene.way_m[places[:, 0], places[:, 1]]
        self._onward: dict[int, Floats] = {}

    def best(self, prices: Prices) -> Route:
        """Return the best route found; empty if none is worth its price."""
        route, left = (), self._prospects.worth.copy()
        route = self._ordered(self._filled(route, left, prices, MOST_STOPS))
        for _ in range(SWEEPS):
            before = route
            for stop in reversed(before):
                route = self._retried(route, stop, prices)
            route = self._ordered(route)
            if route == before:
                break
        return route

    def left_by(self, route: Route) -> Floats:
        """Return what is left of each cell's worth (flat) after all looks of a route."""
        left = self._prospects.worth.copy()
        for stop in route:
            self._prospects.take(left, stop.place, stop.looks)
        return left

    def length_m(self, route: Route) -> float:
        """Return how long a route is."""
        way_m, total_m = self._way_m, 0.0
        for stop in route:
            total_m += float(way_m[stop.place])
            way_m = self._onward_m(stop.place)
        return total_m

    def worth(self, route: Route, prices: Prices) -> float:
        """Return what a route's looks show, less what it costs."""
        left = self._prospects.worth.copy()
        gain = sum(self._prospects.take(left, stop.place, stop.looks) for stop in route)
        looks = sum(len(stop.looks) for stop in route)
        return gain - prices.look * looks - prices.metre * self.length_m(route)

    def _onward_m(self, place: int) -> Floats:
        """Return how far (E,) all places are from one."""
        if place not in self._onward:
            cells, cell_m = self._prospects.places, self._scene.view.frame.cell_m
            field_m, _ = paths.travel_field(self._scene.cost, cells[place][None], cell_m)
            self._onward[place] = field_m[cells[:, 0], cells[:, 1]]
        return self._onward[place]

    def _filled(self, route: Route, left: Floats, prices: Prices, most: int) -> Route:
        """Return a route with the best stops put in, one by one; `left` is brought up to date."""
        for _ in range(most):
            found = self._insertion(route, left, prices)
            if found.net <= LEAST:
                break
            self._prospects.take(left, found.stop.place, found.stop.looks)
            route = _with(route, found)
        return route

    def _insertion(self, route: Route, left: Floats, prices: Prices) -> _Insertion:
        gain, first = self._prospects.sets(left, MOST_LOOKS)
        looks = np.count_nonzero(gain, axis=2)
        detour_m, at = self._detours_m(route)
        net = gain.sum(axis=2) - prices.look * looks - (prices.metre * detour_m)[:, None]
        place, most = np.unravel_index(int(np.argmax(net)), net.shape)
        chosen = tuple(int(f) for f in first[place, most][gain[place, most] > 0])
        return _Insertion(float(net[place, most]), Stop(int(place), chosen), int(at[place]))

    def _detours_m(self, route: Route) -> tuple[Floats, Ints]:
        """Return how much longer (E,) each place makes a route, and before which stop to put it."""
        count = len(self._way_m)
        least_m, at = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
        from_m = self._way_m
        for k in range(len(route) + 1):
            longer_m = from_m
            if k < len(route):
                onward_m = self._onward_m(route[k].place)
                longer_m = from_m + onward_m - from_m[route[k].place]
                from_m = onward_m
            better = longer_m < least_m - 1e-9
            least_m[better], at[better] = longer_m[better], k
        return np.maximum(least_m, 0.0), at

    def _retried(self, route: Route, stop: Stop, prices: Prices) -> Route:
        """Return a route without one stop and with what is best instead, if that is better."""
        without = tuple(other for other in route if other != stop)
        left = self.left_by(without)
        tried = self._filled(without, left, prices, MOST_STOPS + 1 - len(without))
        return tried if self.worth(tried, prices) > self.worth(route, prices) + LEAST else route

    def _ordered(self, route: Route) -> Route:
        """Return the same stops in a shorter order, as far as single changes find one."""
        length_m = self.length_m(route)
        better = True
        while better:
            better = False
            for other in _neighbours(route):
                other_m = self.length_m(other)
                if other_m < length_m - LEAST:
                    route, length_m, better = other, other_m, True
                    break
        return route


def _with(route: Route, found: _Insertion) -> Route:
    """Return a route with a stop put in; looks at a place that is on it already join its own."""
    for k, stop in enumerate(route):
        if stop.place == found.stop.place:
            joined = Stop(stop.place, (*stop.looks, *found.stop.looks))
            return (*route[:k], joined, *route[k + 1 :])
    return (*route[: found.at], found.stop, *route[found.at :])


def _neighbours(route: Route) -> list[Route]:
    """Return all routes with one stretch turned round or one stop moved."""
    found: list[Route] = []
    for i in range(len(route)):
        for j in range(i + 1, len(route)):
            found.append((*route[:i], *route[i : j + 1][::-1], *route[j + 1 :]))
    for i, stop in enumerate(route):
        rest = (*route[:i], *route[i + 1 :])
        found += [(*rest[:j], stop, *rest[j:]) for j in range(len(route)) if j != i]
    return found
