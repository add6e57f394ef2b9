"""What a robot believes of its own pose, and of the poses that this hangs together with.

An extended Kalman filter on (x, y, z, yaw) whose state also holds former poses of the robot (where
its submaps are anchored) and team-mates that it took bearings on, with all covariances between
them. So one sighting corrects the way back to every anchor, each by as much as it shares of the
error, and what a team-mate is wrong by counts once, however often it is seen.

The form is stochastic cloning (Roumeliotis & Burdick, 2002) with Sujan & Meggiolaro's Eqs. 14-16;
covariances are kept in Joseph's form, which holds for whatever gain.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.fusion import (
    YAW,
    FusionError,
    Gaussian,
    best_share,
    checked_covariance,
    compose,
    ekf_predict,
    ekf_update,
    offset_between,
    pose_numbers,
    rotate_covariance,
    symmetric,
    yaw_matrix,
)
from agents.geometry import Floats, Pose, wrap_angle
from agents.ports import Odometry, Sighting

SIZE = 4
"""Numbers of one pose in the state: x, y, z, yaw."""
MOST_REMEMBERED = 48
"""Poses that are kept beside the present one; the oldest is let go, and stays where it is."""


@dataclass(frozen=True)
class Remembered:
    """Names a pose beside the robot's present one."""

    kind: str
    """"submap", "stop", "leg": where the robot stood; "mate": where a team-mate stands."""
    index: int


SLIP = Remembered("slip", 0)
"""Holds no pose: its first number is the share of every drive that slips."""


def _pose(numbers: Floats) -> Pose:
    x, y, z, yaw = (float(v) for v in numbers)
    return Pose(x, y, z, wrap_angle(yaw))


class PoseFilter:
    """What a robot believes about its own pose: an extended Kalman filter on (x, y, z, yaw)."""

    def __init__(self, pose: Pose, covariance: Floats) -> None:
        """Begin at a pose with a covariance (4, 4) of (x, y, z, yaw), metres and radians."""
        self._state = Gaussian(pose_numbers(pose), checked_covariance(covariance, SIZE))
        self._names: list[Remembered] = []
        self.moves = 0
        """How often it was told of a drive."""

    # --- what is believed ---------------------------------------------------------------------

    @property
    def pose(self) -> Pose:
        """The most likely pose."""
        return _pose(self._state.mean[:SIZE])

    @property
    def covariance(self) -> Floats:
        """(4, 4) of (x, y, z, yaw), metres and radians; a copy."""
        return self._state.covariance[:SIZE, :SIZE].copy()

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the horizontal position, the longer axis."""
        return math.sqrt(max(0.0, float(np.linalg.eigvalsh(self._state.covariance[:2, :2])[1])))

    def holds(self, name: Remembered) -> bool:
        """Say whether a pose is remembered."""
        return name in self._names

    def remembered(self, name: Remembered) -> Gaussian:
        """Return what is believed now of a remembered pose: mean (4,) and covariance (4, 4)."""
        at = self._slice(name)
        return Gaussian(self._state.mean[at].copy(), self._state.covariance[at, at].copy())

    def pose_of(self, name: Remembered) -> Pose:
        """Return where a remembered pose is believed to be now."""
        return _pose(self._state.mean[self._slice(name)])

    def from_remembered(self, name: Remembered) -> Gaussian:
        """Return the present pose in the frame of a remembered one, and how sure that is."""
        at = self._slice(name)
        offset, to_base, to_other = offset_between(self.pose_of(name), self.pose)
        h = np.zeros((SIZE, len(self._state.mean)))
        h[:, at], h[:, :SIZE] = to_base, to_other
        return Gaussian(offset, symmetric(h @ self._state.covariance @ h.T))

    def _slice(self, name: Remembered) -> slice:
        first = SIZE * (1 + self._names.index(name))
        return slice(first, first + SIZE)

    # --- remembering ----------------------------------------------------------------------------

    def remember(self, name: Remembered, blur: Floats | None = None) -> None:
        """Keep the present pose under a name: what is learnt later corrects it too.

        `blur` (4, 4) is the covariance of what stands for the pose later, a drawing made from it,
        against the pose itself: however often that is measured, it does not get surer than this.
        """
        mean, covariance = self._state.mean, self._state.covariance
        own = covariance[:SIZE, :SIZE]
        own = own if blur is None else own + checked_covariance(blur, SIZE)
        self._grow(name, mean[:SIZE], own, covariance[:SIZE])

    def introduce(self, name: Remembered, pose: Pose, covariance: Floats) -> None:
        """Keep somebody's pose, whose error (4, 4) is independent of all that is known so far."""
        own = checked_covariance(covariance, SIZE)
        self._grow(name, pose_numbers(pose), own, np.zeros((SIZE, len(self._state.mean))))

    def forget(self, name: Remembered) -> None:
        """Let go of a remembered pose; what it told of the others stays."""
        self._forget(self._names.index(name))

    def doubt_slip(self, sigma: float) -> None:
        """Reckon with a share of every drive that slips, always the same, of this deviation.

        What is the same on every leg grows with the way, not with its root; and once the robot
        learns where it is, it learns by how much its wheels deceive it.
        """
        if sigma > 0:
            self.introduce(SLIP, Pose(0.0, 0.0, 0.0, 0.0), np.diag([sigma**2, 0.0, 0.0, 0.0]))

    def _grow(self, name: Remembered, mean: Floats, own: Floats, across: Floats) -> None:
        assert name not in self._names
        grown = np.block([[self._state.covariance, across.T], [across, own]])
        self._state = Gaussian(np.concatenate((self._state.mean, mean)), grown)
        self._names.append(name)
        if len(self._names) > MOST_REMEMBERED:
            # Whoever let go of a team-mate would take its error for a new one the next time.
            self._forget(next(n for n, old in enumerate(self._names) if old.kind == "submap"))

    def _forget(self, place: int) -> None:
        kept = np.ones(len(self._state.mean), dtype=np.bool_)
        kept[SIZE * (1 + place) : SIZE * (2 + place)] = False
        self._state = Gaussian(self._state.mean[kept], self._state.covariance[np.ix_(kept, kept)])
        del self._names[place]

    def settle(self, pose: Pose, covariance: Floats) -> None:
        """Learn for the first time where it is: all former poses come along, as if in one piece.

        Until then the filter was about a frame of the robot's own, which the covariance (4, 4) of
        the pose now ties to the team's.
        """
        own, n = checked_covariance(covariance, SIZE), len(self._state.mean)
        relative = np.zeros((n, n))
        carried = np.zeros((n, SIZE))
        carried[:SIZE] = np.eye(SIZE)
        mean = np.concatenate((pose_numbers(pose), self._state.mean[SIZE:]))
        for name in self._names:
            at = self._slice(name)
            if name == SLIP:
                relative[at, at] = np.eye(SIZE)
                continue
            offset, to_pose, to_other = offset_between(self.pose, self.pose_of(name))
            placed, _ = compose(pose, np.zeros((4, 4)), tuple(offset.tolist()), np.zeros((4, 4)))
            mean[at] = pose_numbers(placed)
            turn = yaw_matrix(pose.yaw_rad)
            relative[at, :SIZE], relative[at, at] = turn @ to_pose, turn @ to_other
            carried[at] = np.eye(SIZE)
            carried[at][0, YAW] = pose.y_m - placed.y_m
            carried[at][1, YAW] = placed.x_m - pose.x_m
        spread = relative @ self._state.covariance @ relative.T + carried @ own @ carried.T
        self._state = Gaussian(mean, symmetric(spread))

    # --- moving and measuring -------------------------------------------------------------------

    def predict(self, odometry: Odometry) -> None:
        """Move by what odometry says (Eq. 14)."""
        self.moves += 1
        offset = (odometry.forward_m, odometry.left_m, odometry.up_m, odometry.turn_rad)
        noise = checked_covariance(odometry.covariance, SIZE)
        here, n = self.pose, len(self._state.mean)
        move = np.eye(n)
        if self.holds(SLIP):
            at, turn = self._slice(SLIP), yaw_matrix(here.yaw_rad)
            driven = np.array((odometry.forward_m, odometry.left_m, 0.0, 0.0))
            slipped = driven * self._state.mean[at][0]
            offset = (offset[0] - slipped[0], offset[1] - slipped[1], offset[2], offset[3])
            move[:SIZE, at.start] = -(turn @ driven)
        pose, _ = compose(here, self.covariance, offset, noise)
        move[0, YAW], move[1, YAW] = here.y_m - pose.y_m, pose.x_m - here.x_m
        process = np.zeros((n, n))
        process[:SIZE, :SIZE] = rotate_covariance(noise, yaw_matrix(here.yaw_rad))
        mean = self._state.mean.copy()
        mean[:SIZE] = pose_numbers(pose)
        self._state = ekf_predict(self._state, mean, move, process)

    def fix(self, measured: Pose, covariance: Floats, *, gate: float = math.inf) -> float:
        """Take in a measured pose (Eqs. 15, 16); return its normalised innovation squared.

        A measurement whose value exceeds `gate` (chi-squared, 4 degrees of freedom) is not
        believed and changes nothing.
        """
        innovation = pose_numbers(measured) - pose_numbers(self.pose)
        innovation[YAW] = wrap_angle(float(innovation[YAW]))
        noise = checked_covariance(covariance, SIZE)
        return self._take(innovation, np.eye(SIZE), noise, gate)

    def fix_former(
        self, name: Remembered, measured: Pose, covariance: Floats, *, gate: float = math.inf
    ) -> float:
        """Take in where the robot was when it remembered a pose; return as `fix` does."""
        innovation = pose_numbers(measured) - pose_numbers(self.pose_of(name))
        innovation[YAW] = wrap_angle(float(innovation[YAW]))
        noise = checked_covariance(covariance, SIZE)
        return self._take(innovation, np.zeros((SIZE, SIZE)), noise, gate, (name, np.eye(SIZE)))

    def fix_against(
        self, name: Remembered, offset: Floats, covariance: Floats, *, gate: float = math.inf
    ) -> float:
        """Take in the pose (4,) in the frame of a remembered one; return as `fix` does.

        What is measured against the robot's own map says where it is on that map, and nothing of
        where the map is.
        """
        expected, to_base, to_pose = offset_between(self.pose_of(name), self.pose)
        innovation = offset - expected
        innovation[YAW] = wrap_angle(float(innovation[YAW]))
        return self._take(
            innovation, to_pose, checked_covariance(covariance, SIZE), gate, (name, to_base)
        )

    def seen_by(
        self,
        observer: Pose,
        observer_covariance: Floats,
        sighting: Sighting,
        *,
        gate: float = math.inf,
    ) -> float:
        """Take in that a team-mate at a known pose saw this robot; return as `fix` does.

        The observer's error must be independent of this robot's own: two robots that fix each
        other in turn without new outside knowledge would grow sure of nothing.
        """
        offset = (*sighting.offset_m, sighting.bearing_rad)
        noise = checked_covariance(sighting.covariance, SIZE)
        measured, covariance = compose(
            observer, checked_covariance(observer_covariance, SIZE), offset, noise
        )
        return self.fix(measured, covariance, gate=gate)

    def saw(
        self, mate: Pose, mate_covariance: Floats, sighting: Sighting, *, gate: float = math.inf
    ) -> float:
        """Take in that this robot saw a team-mate (or landmark) at a known pose; as `fix`.

        The measurement is where the mate stands in this robot's frame and its relative yaw.
        The mate's error must be independent of this robot's own.
        """
        innovation, h, turn = self._sighted(mate, sighting)
        turned = rotate_covariance(checked_covariance(mate_covariance, SIZE), turn)
        noise = checked_covariance(sighting.covariance, SIZE) + turned
        return self._take(innovation, h, noise, gate)

    def saw_again(self, name: Remembered, sighting: Sighting, *, gate: float = math.inf) -> float:
        """Take in that this robot saw a team-mate that it remembers (see `introduce`); as `fix`."""
        innovation, h, turn = self._sighted(self.pose_of(name), sighting)
        noise = checked_covariance(sighting.covariance, SIZE)
        return self._take(innovation, h, noise, gate, (name, turn))

    def saw_dependent(
        self, mate: Pose, mate_covariance: Floats, sighting: Sighting, *, gate: float = math.inf
    ) -> float:
        """Take in a sighting of a mate whose error may be this robot's own, come round; as `fix`.

        By covariance intersection (Julier & Uhlmann, 1997): with both covariances stretched, by
        1/w and 1/(1-w), the outcome is right whatever they share. Where no w makes the pose surer,
        nothing is taken in.
        """
        innovation, h, turn = self._sighted(mate, sighting)
        turned = rotate_covariance(checked_covariance(mate_covariance, SIZE), turn)
        seen = checked_covariance(sighting.covariance, SIZE)
        share = best_share(self.covariance, h, seen, turned)
        if share is None:
            return 0.0
        before = self._state
        self._state = Gaussian(before.mean, before.covariance / share)
        nis = self._take(innovation, h, seen + turned / (1.0 - share), gate)
        if nis > gate:
            self._state = before
        return nis

    def _sighted(self, mate: Pose, sighting: Sighting) -> tuple[Floats, Floats, Floats]:
        """Return measured less expected (4,), and Jacobians to this robot and to the mate."""
        expected, h, turn = offset_between(self.pose, mate)
        innovation = np.array((*sighting.offset_m, sighting.bearing_rad)) - expected
        innovation[YAW] = wrap_angle(float(innovation[YAW]))
        return innovation, h, turn

    def range_fix(
        self,
        anchor_xyz: tuple[float, float, float],
        length_m: float,
        sigma_m: float,
        *,
        gate: float = math.inf,
    ) -> float:
        """Take in the distance to a known point, e.g. by a *taut* tether; return as `fix` does.

        Raises:
            FusionError: the robot stands on the point (no direction), or a number is impossible.
        """
        if not (length_m >= 0 and sigma_m > 0):
            raise FusionError(f"length {length_m} m must be >= 0 and its sigma {sigma_m} m > 0")
        apart = self._state.mean[:3] - np.asarray(anchor_xyz, dtype=np.float64)
        distance = float(np.linalg.norm(apart))
        if distance < 1e-6:
            raise FusionError(f"a range to {anchor_xyz} says nothing about a robot that is there")
        h = np.zeros((1, SIZE))
        h[0, :3] = apart / distance
        innovation = np.array((length_m - distance,))
        return self._take(innovation, h, np.array(((sigma_m * sigma_m,),)), gate)

    def _take(
        self,
        innovation: Floats,
        h: Floats,
        noise: Floats,
        gate: float,
        besides: tuple[Remembered, Floats] | None = None,
    ) -> float:
        """Update all poses by a measurement of the present one, and of one `besides`."""
        whole = np.zeros((len(innovation), len(self._state.mean)))
        whole[:, :SIZE] = h
        if besides is not None:
            whole[:, self._slice(besides[0])] = besides[1]
        state, nis = ekf_update(self._state, innovation, whole, noise)
        if nis <= gate:
            mean = state.mean.copy()
            mean[YAW::SIZE] = [wrap_angle(float(yaw)) for yaw in mean[YAW::SIZE]]
            self._state = Gaussian(mean, state.covariance)
        return nis
