"""Promises about recovery: a command is obeyed, the robot moves again, a mission is kept."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, hypot, inf

from armadico.core.messages import RobotState
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import MissionState, MissionStatus, Trajectory
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.observations import Asked, Observation, Published
from armadico_tools.faults.record import Bounds, Record, moves

STANDS_BACK_S = 4.0
"""The longest that a holder stands back, s (`armadico.core.coordination.STAND_BACK`)."""

FRICTION_S = 2.0
"""Time for the speed loops to start a slow turn of 0.1 rad/s from rest; 1.2 s was measured."""

CRAWL_M, CRAWL_RAD = 0.005, 0.02
"""It has moved if it is farther from its place than this: six counts of the odometry."""

FORGOTTEN_S = 2.0
"""A restarted interface agent receives the mission within this, in a whole network, s."""

SHARED_S = 1.5
"""In a whole network all agents have a mission after this: relinking, and a repetition, s."""

SAME_M, SAME_RAD = 0.01, 0.01
"""A goal keeps its place within this, m, and its heading, rad."""

TURN_S = 1.0
"""In a whole network every contender has a turn within this, s."""


class CommandObeyed:
    """In a whole network a command is obeyed within 5 s, if an agent bids without a stop."""

    promise = Promise.OBEYED
    on = (Observation,)

    def __init__(self, bounds: Bounds) -> None:
        self._obeyed_s = bounds.obeyed_s
        self._since = inf
        self._bid_at = -inf

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """As time passes: since when an agent bids and no command is obeyed."""
        if now.bidders():
            self._bid_at = seen.at
        quiet = seen.at - self._bid_at > TURN_S  # a moment without a bid does not count
        excused = now.whole_for() < 0 or now.owner.stopped() or quiet
        if excused or now.owner.obeyed_at >= self._since:
            self._since = inf
        if excused:
            return
        if self._since == inf and now.owner.obeyed_at < seen.at - 0.3:
            self._since = seen.at
        if seen.at - self._since > self._obeyed_s:
            self._since = inf
            bidders = ", ".join(sorted(now.bidders()))
            yield f"no command is obeyed for {self._obeyed_s:.1f} s, though these bid: {bidders}"


class Moves:
    """After healing the robot moves within 2 s, or every bid has a reason not to.

    The limit is 5 s if a holder has released for lack of obedience and stands back, or is about to
    because its bids are nonsense. It starts after the nonsense if no other agent bid. The robot
    need not move if it is stopped, has no mission, or obeys a command of rest with a reason; or
    creeps to its goal so slowly that friction holds the wheels for a while.
    """

    promise = Promise.MOVES
    on = (Observation,)

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._healed: float | None = None  # the healing that is awaited
        self._known = -inf  # the healing that was last settled
        self._from: RobotState | None = None  # the last state before
        self.longest: float | None = None

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """As time passes, from the end of the last excuse."""
        if now.faults.free_since == inf:
            self._healed = None
            return
        if now.faults.healed_at > self._known:
            self._healed = self._known = now.faults.healed_at
            self._from = now.owner.state
        if self._healed is None:
            return
        then, state = self._from, now.owner.state
        if state is not None and (then is None or then.cycle.epoch != state.cycle.epoch):
            self._from = state  # a new robot agent has another origin
        self._healed = max(self._healed, now.contest.nonsense_back_at)
        if now.owner.driven() and self._moves(now):
            took = max(now.owner.state_at - self._healed, 0.0)
            self.longest = max(took, self.longest or 0.0)
            self._healed = None
        elif seen.at - self._healed > self._allowed(now):
            waited, self._healed = seen.at - self._healed, None
            why = self._why_it_need_not(now)
            if why is None:
                yield f"it stands {waited:.2f} s after healing: {self._bidding(now)}"

    def _moves(self, now: Record) -> bool:
        """Whether it moves, if only at a crawl, as before a turn on its goal."""
        assert self._healed is not None, "healing is awaited"
        if now.body.moved_at >= self._healed:
            return True
        then, state = self._from, now.owner.state
        if then is None or state is None:
            return False
        turned = abs(wrap(state.theta - then.theta))
        return hypot(state.x - then.x, state.y - then.y) > CRAWL_M or turned > CRAWL_RAD

    def _allowed(self, now: Record) -> float:
        assert self._healed is not None, "healing is awaited"
        stood_back = now.contest.stood_back_at > self._healed - STANDS_BACK_S
        stood_back = stood_back or now.nonsense_in_vain(self._bounds.unobeyed_s)
        allowed = self._bounds.stood_back_s if stood_back else self._bounds.moves_s
        order = now.owner.ordered
        driven = order is not None and (order.v != 0.0 or order.w != 0.0)
        return allowed + FRICTION_S if driven and now.owner.driven() else allowed

    @staticmethod
    def _why_it_need_not(now: Record) -> str | None:
        if not now.driving or now.owner.stopped():
            return "no mission, or stopped"
        if not now.bidders():
            blind = now.faults.befalls("robot", "silent-sonar")  # users of obstacles have no turn
            silent = [
                instance
                for instance, (at, record) in now.contest.bids.items()
                if not (record.reason or now.faults.bids_nonsense(instance))
                or (now.now - at > TURN_S and not blind)
            ]
            return "no bids" if not silent else None
        order = now.owner.ordered
        rests = order is None or not moves(order.v, order.w)
        held = now.owner.state is not None and now.owner.state.stalled
        if now.owner.driven() and (held or (rests and _says_why(now))):
            return "the obeyed agent commands rest, or nearly, or a wall holds the robot"
        return None

    @staticmethod
    def _bidding(now: Record) -> str:
        if not now.contest.bids:
            return "bids are not seen"
        return "; ".join(
            f"{instance.rpartition('-')[0]} {record.utility} ({record.reason})"
            for instance, (_, record) in sorted(now.contest.bids.items())
        )


class Remembered:
    """A mission is not forgotten. The auditor judges whether it arrives in time.

    It counts once its client has received the acceptance, which follows the mission on the same
    link, or once it is driven in a whole network. Before, its interface agent may be disconnected,
    and have the only copy.
    """

    promise = Promise.ARRIVES
    on = (Observation,)

    def __init__(self) -> None:
        self._accepted = 0  # the last mission whose acceptance was received
        self._under_way = False
        self._none_at: float | None = None  # since when there is none

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At each status of the mission."""
        if isinstance(seen, Asked):
            self._accepted = seen.mission
        if not isinstance(seen, Published) or not isinstance(seen.message, MissionStatus):
            return
        state = seen.message.state
        if state is MissionState.NONE and self._under_way:
            self._none_at = (
                seen.at if self._none_at is None or now.whole_for() < 0 else self._none_at
            )
            if seen.at - self._none_at > FORGOTTEN_S:
                self._under_way = False
                yield f"the mission is forgotten for {FORGOTTEN_S:.0f} s"
        elif state is MissionState.DRIVING:
            shared = now.whole_for() > SHARED_S or seen.message.mission == self._accepted
            self._under_way, self._none_at = self._under_way or shared, None
        elif state in (MissionState.REACHED, MissionState.FAILED):
            self._under_way = False


class Goes:
    """A mission's path ends at the goal that was asked for."""

    promise = Promise.REACHED
    on = (Asked, Trajectory)

    def __init__(self) -> None:
        self._asked: Asked | None = None

    def check(self, seen: Observation, now: Record) -> Iterator[str]:  # noqa: ARG002
        """At each path of the mission."""
        if isinstance(seen, Asked):
            self._asked = seen
        elif isinstance(seen, Published) and isinstance(seen.message, Trajectory):
            asked, path = self._asked, seen.message
            if asked is None or path.mission != asked.mission or not path.waypoints:
                return
            end = path.waypoints[-1]
            off = hypot(end.x - asked.goal.x, end.y - asked.goal.y)
            turned = abs(wrap(end.theta - asked.goal.theta))
            if off > SAME_M or turned > SAME_RAD:
                self._asked = None
                off_goal = f"{off:.2f} m and {degrees(turned):.0f} degrees"
                yield f"its path ends {off_goal} from the goal that was asked for"


def _says_why(now: Record) -> bool:
    """Whether the obeyed agent gives a reason, as far as its bids are observed."""
    assert now.owner.obeyed is not None, "a command is obeyed"
    _, record = now.contest.bids.get(now.owner.obeyed.instance, (0.0, None))
    return record is None or bool(record.reason)
