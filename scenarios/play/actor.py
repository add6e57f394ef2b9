"""What the runner knows of each robot while it runs, and what it makes of it all at the end."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.messages import unpack_anchor
from scenarios.live import RobotNow
from scenarios.records.summary import Ending, Outcome, RobotFinal, State
from scenarios.records.tables import EventRow, LookRow, MapRow, Row, TxRow
from scenarios.schema import Scenario


@dataclass
class Actor:
    """One robot, as the runner sees it."""

    name: str
    role: str
    state: str = "alive"
    """waiting, alive, stopped, killed or left."""
    lives: int = 0
    looks: int = 0
    sent_bytes: int = 0
    next_number: int = 0
    """Number of the next frame, whatever the incarnation."""
    last_tx: TxRow | None = None
    last_map: MapRow | None = None
    down_since_s: float | None = None
    status: dict[str, Any] = field(default_factory=dict[str, Any])
    """The newest sample of itself that it reported."""
    events: list[EventRow] = field(default_factory=list[EventRow])
    death: str = ""
    """How it died, if nobody killed it."""
    fault: str = ""

    def learn(self, row: Row) -> None:
        """Take note of a row that it reported."""
        match row:
            case LookRow():
                self.looks += 1
            case TxRow():
                self.sent_bytes += row.bytes
                self.next_number = row.seq + 1
                self.last_tx = row
            case MapRow():
                self.last_map = row
            case EventRow():
                self.events.append(row)
            case _:
                pass

    def event_s(self, what: str) -> float | None:
        """Return when something first happened to it, by its own word."""
        return next((event.t_s for event in self.events if event.what == what), None)

    def now(self, t_s: float) -> RobotNow:
        """Return it as the live view shows it."""
        known = self.last_map
        return RobotNow(
            self.name,
            self.role,
            self.state,
            str(self.status.get("activity", "")),
            self.looks,
            known.own_cells if known else 0,
            known.team_cells if known else 0,
            self.sent_bytes,
            self.status.get("airtime_s", 0.0) / t_s if t_s > 0 else 0.0,
        )

    def final(self, told: dict[str, Any] | None) -> RobotFinal:
        """Return how it ended: by its last report, or by its newest sample where it died."""
        status = told or self.status
        state: State = "alive"
        if self.state in ("killed", "stopped"):
            state = "killed" if self.state == "killed" else "stopped"
        elif told is None or self.state == "left":
            state = "left"
        shape = tuple(told["shape"]) if told else ()
        grids = told["maps"] if told else {}
        maps = {key: np.frombuffer(data, np.float32).reshape(shape) for key, data in grids.items()}
        return RobotFinal(
            name=self.name,
            state=state,
            own_cells=status.get("own_cells", 0),
            team_cells=status.get("team_cells", 0),
            digest=status.get("digest", ""),
            payload_bytes=status.get("payload_bytes", 0),
            distance_m=status.get("distance_m", 0.0),
            hazards_hit=status.get("hazards", 0),
            received_bytes=status.get("received_bytes", 0),
            pose_error_rms_m=status.get("pose_error_rms_m"),
            dropped_frames=status.get("dropped", {}),
            elevation_m=maps.get("elevation"),
            sigma_m=maps.get("sigma"),
            log_odds=maps.get("log_odds"),
            moved=dict(unpack_anchor(packed) for packed in told["moved"]) if told else {},
        )


REASONS = {
    "limit": "the time limit was reached",
    "interrupted": "interrupted by the user",
    "fault": "a robot's own program failed",
    "nobody left": "no robot was left",
    "settled": "",
    "descended": "",
}


SETTLED = "the mission is over and the maps have settled"


def conclude(
    scenario: Scenario, actors: Sequence[Actor], ending: str, simulated_s: float
) -> Ending:
    """Return how a run ended, by why it ended and what its robots said."""
    mission = _mission(scenario, actors)
    shortcomings = [REASONS[ending]] if REASONS[ending] else []
    shortcomings += [f"{a.name}: {a.death}" for a in actors if a.death]
    dead = [a.name for a in actors if a.state == "killed" and not a.death]
    shortcomings += [f"{name} was killed" for name in dead]
    spent = [a.name for a in actors if a.event_s("looks spent") is not None]
    if spent and not mission:
        most = scenario.planner.max_looks
        shortcomings.append(
            f"{' and '.join(spent)} took all looks allowed (planner.max_looks = {most})"
        )
    if mission and not mission["cliffbot_reached"]:
        shortcomings.append(_why_not_down(mission))
    if mission and mission["hazards_hit"]:
        shortcomings.append(f"the Cliff-bot ran into {mission['hazards_hit']} hazards")
    worked = any(a.looks for a in actors)
    outcome: Outcome = "complete" if not shortcomings else "partial"
    if not worked or ending in ("fault", "nobody left"):
        outcome = "failed"
    over = "the Cliff-bot is down" if ending == "descended" else SETTLED
    reason = "; ".join(shortcomings) or over
    return Ending(simulated_s, outcome, reason, mission)


def _why_not_down(mission: dict[str, Any]) -> str:
    if mission["safe_path_at_s"] is None:
        return "no safe way down was found"
    return "the Cliff-bot did not get down"


def _mission(scenario: Scenario, actors: Sequence[Actor]) -> dict[str, Any]:
    bots = [actor for actor in actors if actor.role == "cliffbot"]
    if not bots:
        return {}
    bot = bots[0]
    return {
        "cliffbot_reached": bot.event_s("reached") is not None,
        "safe_path_at_s": bot.event_s("safe path"),
        "hazards_hit": int(bot.status.get("hazards", 0)),
    }
