"""The relocate agent: drives a robot that is lost until its sonars have found out where it is."""

from __future__ import annotations

from math import hypot, inf, radians, tau
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.core import agent
from armadico.core.agent import WARNING
from armadico.core.behaviour import LOST_M, Behaviour
from armadico.core.exchange import Bid
from armadico.core.messages import Message, Obstacles, Point, Pose, Sonar
from armadico.core.parameters import TURN_MARGIN_M, Safety
from armadico.core.resources import WHEELS
from armadico.core.swept_path import free_path, free_turn

Metres = Annotated[float, Meta(gt=0, le=10)]

AHEAD_RAD = radians(20)
"""A sonar that looks within this of the heading looks ahead."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """How it looks around, and for how long."""

    v: Annotated[float, Meta(gt=0, le=1)] = 0.25  # m/s
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # a scenario's limit
    v_back: Annotated[float, Meta(gt=0, le=1)] = (
        0.08  # backwards where it can neither turn nor go on
    )
    w: Annotated[float, Meta(gt=0, le=2)] = 0.5  # rad/s
    back_room_m: Metres = 0.1  # with more than this remembered free behind
    ahead_m: Metres = 0.35  # with less than this free ahead it turns,
    open_m: Metres = 0.9  # until so much is
    silent_s: Annotated[float, Meta(gt=0, le=60)] = 1.0  # nothing ahead has answered for so long
    leg_m: Metres = 3.0  # after so much straight ahead it looks around again
    give_up_s: Annotated[float, Meta(gt=0, le=3600)] = 120.0
    utility_least: Annotated[float, Meta(ge=0, le=1)] = 0.4  # just lost,
    utility_most_m: Metres = 2.0  # and 1 when the pose is so uncertain
    safety: Safety = Safety()


class Relocate(Behaviour):
    """Turns once on the spot, then drives on to where it is free, and turns again.

    It needs no pose, only what is near. What it sees is for the localization agent: a place is told
    from others like it by what comes after it.

    No map tells it of walls that do not answer. So it drives to where something answered: as far as
    that it is free. If all around nothing does, it drives on all the same.
    """

    name = "relocate"
    reacts_to = Obstacles
    hears: ClassVar[tuple[type[Message], ...]] = (*Behaviour.hears, Sonar)
    parameters = Parameters
    launched_with = ("v_max",)
    seeks = True
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._since = -inf  # when the robot was lost
        self._bid_at = -inf
        self._left = 0.0  # of the turn, rad
        self._way = 0.0  # of the leg, m
        self._sought = 0.0  # so far it has turned for a way that is free, rad
        self._answered_at: float | None = None  # when something ahead last did; None: no sonar yet
        self._side = 1.0
        self._gave_up = False

    def on_sonar(self, sonar: Sonar) -> None:
        """Whether anything ahead answers."""
        ahead = [e.range for e in sonar.echoes if abs(e.bearing) < AHEAD_RAD]
        if any(distance is not None for distance in ahead):
            self._answered_at = self.now
        elif self._answered_at is None:
            self._answered_at = -inf

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """Look around, or drive on."""
        self._begin()
        if self.now - self._since > self.p.give_up_s:
            self.why = f"not found in {self.p.give_up_s:g} s"
            if not self._gave_up:
                self._gave_up = True
                self.log(f"the robot is lost, and was {self.why}: it stands", WARNING)
            return None
        v, w, reason = self._act(obstacles)
        v, w = self.limited(v, w, obstacles, self.p.safety)
        share = min(1.0, (pose.deviation - LOST_M) / (self.p.utility_most_m - LOST_M))
        utility = self.p.utility_least + share * (1.0 - self.p.utility_least)
        return Bid(utility, (v, w), reason=reason)

    def _begin(self) -> None:
        """Count from when the robot was lost, and what has been turned and driven since."""
        cycle_s = self.body.cycle_s
        if self.now - self._bid_at > 10.0 * cycle_s:
            self._since, self._gave_up = self.now, False
            self._left, self._way, self._sought = tau, 0.0, -tau
        self._bid_at = self.now
        if self.holds(WHEELS):
            v, w = self.measured
            self._left = max(0.0, self._left - abs(w) * cycle_s)
            self._sought += abs(w) * cycle_s
            self._way += abs(v) * cycle_s

    @property
    def _silent(self) -> bool:
        """Whether nothing ahead answers, and it may do so elsewhere."""
        at = self._answered_at
        return at is not None and self.now - at > self.p.silent_s and self._sought < tau

    def _act(self, obstacles: Obstacles) -> tuple[float, float, str]:
        p, outline, points = self.p, self.body.outline, obstacles.points
        ahead = free_path(points, 1.0, 0.0, outline, p.safety.margin_m)
        if self._way > p.leg_m:
            self._left, self._way, self._sought = tau, 0.0, -tau
        silent = self._silent
        if self._left <= 0.0 and (ahead < p.ahead_m or silent):
            self._left = inf  # until there is room
            self._sought = 0.0
            left, right = (
                inf if o is None else hypot(o.x, o.y) for o in (obstacles.left, obstacles.right)
            )
            self._side = (
                1.0 if left > right or (left == right and self.rng.random() < 0.5) else -1.0
            )
        elif self._left == inf and ahead > p.open_m and not silent:
            self._left = 0.0
        if self._left > 0.0:
            for side in (self._side, -self._side):
                if free_turn(points, side, outline, TURN_MARGIN_M) > p.safety.turn_room:
                    self._side = side
                    return 0.0, side * p.w, "lost: look around"
            self._left = 0.0
        v = min(p.v, p.v_max or inf)
        if ahead >= p.ahead_m:
            return v, 0.0, "lost: drive on"
        mirrored = [Point(-point.x, -point.y) for point in points]
        behind = free_path(mirrored, 1.0, 0.0, outline.turned_round, p.safety.margin_m)
        if behind > p.back_room_m:  # it fits neither way round here: out as it came in
            self._left = tau
            return -min(p.v_back, v), 0.0, "lost: back out"
        return 0.0, 0.0, "lost: no way on"
