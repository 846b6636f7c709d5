"""Ballots by learned utilities: the time that an agent's holding the wheels would save.

Innocenti (2009) leaves learning to future work. Here the kernel's side of an agent replaces the
utility of its bid by a linear function of what the agent knows of it. The weights are the agent's
parameter `social.utility`; `armadico learn --utilities` finds them from runs by `EXPLORING`. There
is no arbiter: each agent judges its own bids, and the rules of ballots decide.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import atan2, cos
from random import Random
from typing import Final

from armadico.core.config_errors import ConfigError
from armadico.core.coordination import Contender
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.individual import Individual
from armadico.core.mechanisms import terms
from armadico.core.messages import Cycle, Message
from armadico.core.parameters import TURN_MARGIN_M
from armadico.core.resources import WHEELS, Resource
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.offers import speeds_of
from armadico.mobile.swept_path import free_path

FEATURES: Final = ("one", "utility", "v", "turn", "measured", "free", "progress", "facing")
"""Of a bid: 1; the agent's own utility; its v, m/s, and |w|, rad/s; the measured v; the free way on
its arc, in `REACH_M`; the speed towards the steering point over the next second, m/s; the cosine of
the angle to that point then. Whether the agent holds the wheels is none: what its own holding
changes is no reason to go on."""

REACH_M: Final = 1.5
AHEAD_M: Final = 0.6  # distance of the steering point on the trajectory, as goto's
LEAST_M_S: Final = 0.1  # at least this speed is assumed for the arc of a bid

PARKS_M: Final = 1.0
"""Nearer to its goal the robot parks: progress is no measure of that, and own utilities count."""

LEAST, MOST = 0.05, 0.79
"""Bounds of a learned utility: it offers nothing for free, and is below what is urgent."""

PER_S: Final = 0.185
"""Utility for each second saved: two seconds reach a bound. The margin of 0.05 is 0.27 s."""

PERIOD, FORCED = 40, 20
"""Cycles of an exploring society after each of which, and for how many, bids are random."""


def ordinary(bid: Bid) -> bool:
    """Return whether a bid's utility may be replaced.

    An offer (0) stays one, and so does the largest bid there is: by that avoid frees a robot that
    is stuck. With a learned one below it, 4 of 40 runs stood until their end.
    """
    return 0.0 < bid.utility < 1.0 and not bid.critical


def features(agent: Individual, bid: Bid) -> tuple[float, ...] | None:
    """Return the numbers named by `FEATURES` for a bid.

    None: the agent is no behaviour, lacks a message or a trajectory, or the robot parks.
    """
    if not isinstance(agent, Behaviour) or not agent.route.waypoints:
        return None
    pose, obstacles = agent.latest(Pose), agent.latest(Obstacles)
    if pose is None or obstacles is None or agent.route.to_go(pose.x, pose.y) < PARKS_M:
        return None
    v, w = speeds_of(bid)
    to = agent.route.ahead(pose.x, pose.y, AHEAD_M)[0]
    bearing = wrap(atan2(to.y - pose.y, to.x - pose.x) - pose.theta)
    outline = agent.body.outline
    free = free_path(obstacles.points, max(v, LEAST_M_S), w, outline, TURN_MARGIN_M)
    progress, facing = v * cos(bearing - 0.5 * w), cos(bearing - w)
    reached = min(free / REACH_M, 1.0)
    return 1.0, bid.utility, v, abs(w), agent.measured[0], reached, progress, facing


def judged(agent: Individual, bid: Bid) -> Bid:
    """Return the bid with its learned utility, if it is an ordinary one."""
    weights = agent.p.social.utility
    if not weights or not ordinary(bid):
        return bid
    known = features(agent, bid)
    if known is None:
        return bid
    saved = sum(w * x for w, x in zip(weights, known, strict=True))
    return replace(bid, utility=min(max(0.5 * (LEAST + MOST) + PER_S * saved, LEAST), MOST))


def explored(agent: Individual, bid: Bid, cycle: Cycle) -> Bid:
    """Return the bid, in forced cycles with a random utility, which the agent keeps meanwhile."""
    if ordinary(bid) and cycle.number % PERIOD < FORCED:
        return replace(bid, utility=drawn(agent.name, cycle))
    return judged(agent, bid)


def drawn(name: str, cycle: Cycle) -> float:
    """Return the random utility of an agent in the period of a cycle, the same for everybody."""
    return Random(f"{cycle.epoch}/{cycle.number // PERIOD}/{name}").uniform(LEAST, MOST)


class LearnedContender(Contender):
    """A contender by ballots whose bids have other utilities than the agent gave them."""

    def __init__(
        self, agent: Individual, resource: Resource, clock: CycleClock, *, explores: bool
    ) -> None:
        super().__init__(*terms(resource, agent, clock))
        self._agent, self._explores = agent, explores

    def bid(
        self, cycle: Cycle, bid: Bid | None, now: float, inputs: Cycle | None = None
    ) -> list[Message]:
        if bid is not None:
            agent = self._agent
            bid = explored(agent, bid, cycle) if self._explores else judged(agent, bid)
        return super().bid(cycle, bid, now, inputs)


@dataclass(frozen=True)
class Learned:
    """A coordination of the wheels without an arbiter; agents without weights bid as ever."""

    about: str  # what decides, for people
    explores: bool = False  # whether bids are random at times
    arbiter: str = ""  # nobody
    library: str = ""  # none is needed
    tuned: bool = True  # its numbers are learnt, so that it is no arm of a study unless it is named
    resource: Resource = WHEELS  # what it decides about

    def lacking(self, agents: Mapping[str, Individual]) -> str:
        """Return that no agent has weights: the others would drive as by ballots."""
        if self.explores or any(agent.p.social.utility for agent in agents.values()):
            return ""
        return (
            "no agent has learned weights (social.utility), so all would bid as by ballots; add the"
            " shipped ones (--parameters learned) or your own (armadico learn --utilities)"
        )

    def contender(
        self, resource: Resource, agent: Individual, clock: CycleClock
    ) -> LearnedContender | None:
        """Return the contender's side. Raises ConfigError for weights of another number."""
        if resource != self.resource:
            return None
        weights = agent.p.social.utility
        if weights and len(weights) != len(FEATURES):
            raise ConfigError(
                f"{agent.name}: social.utility has {len(weights)} weights, expected"
                f" {len(FEATURES)}: {', '.join(FEATURES)}"
            )
        return LearnedContender(agent, resource, clock, explores=self.explores)


LEARNED: Final = Learned("ballots by learned utilities, those of social.utility")
EXPLORING: Final = Learned(
    "the same, each agent's utility random for 2 of every 4 s: armadico learn uses it",
    explores=True,
)
