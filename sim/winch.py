"""A tether drum whose brake closes by itself."""

from collections.abc import Callable

from agents.geometry import Pose
from agents.settings import TetherSettings
from comms.timebase import from_s, now_ns
from sim.motion import Segment


class SimWinch:
    """`agents.ports.Winch`: publishes how its tether's length runs, as segments.

    One command moves the drum for at most `settings.command_timeout_s`; then the brake closes by
    itself, so that a tether holds when whoever commands it falls silent.
    """

    def __init__(
        self,
        name: str,
        settings: TetherSettings,
        pose_at: Callable[[int], Pose],
        publish: Callable[[Segment], None],
        *,
        length_m: float = 0.0,
        start_ns: int = 0,
    ) -> None:
        """Hold a length. `pose_at(t_ns)` is where the Anchor-bot truly stands."""
        self._name = name
        self._settings = settings
        self._pose_at = pose_at
        self._publish = publish
        self._run = self._emit(start_ns, start_ns, length_m, length_m, "brake")

    @property
    def length_m(self) -> float:
        """Length of tether that is out now, in metres."""
        return self.length_at(now_ns())

    def length_at(self, t_ns: int) -> float:
        """Return the length that is out at a time of the present run, or after it."""
        return self._run.tether_at(t_ns)

    def pay_out(self, target_m: float, rate_mps: float) -> None:
        """Run the drum towards a length, no faster and no farther than it can."""
        t_ns = now_ns()
        start_m = self.length_at(t_ns)
        goal_m = min(max(target_m, 0.0), self._settings.max_length_m)
        rate = min(abs(rate_mps), self._settings.rate_mps)
        most_m = rate * self._settings.command_timeout_s
        end_m = min(max(goal_m, start_m - most_m), start_m + most_m)
        span_ns = from_s(abs(end_m - start_m) / rate) if rate > 0 else 0
        if span_ns == 0:
            end_m = start_m
        self._run = self._emit(t_ns, t_ns + span_ns, start_m, end_m, "pay out")

    def brake(self) -> None:
        """Stop the drum now."""
        t_ns = now_ns()
        length_m = self.length_at(t_ns)
        self._run = self._emit(t_ns, t_ns, length_m, length_m, "brake")

    def _emit(self, start_ns: int, end_ns: int, start_m: float, end_m: float, note: str) -> Segment:
        pose = self._pose_at(start_ns)
        segment = Segment(self._name, start_ns, end_ns, pose, pose, start_m, end_m, note)
        self._publish(segment)
        return segment
