"""The encoder agent: where the robot is in the world, by its encoders (thesis 3.4.1)."""

from __future__ import annotations

from math import hypot
from typing import Annotated, Any, ClassVar

from msgspec import Meta
from msgspec.structs import replace

from armadico.core import agent
from armadico.core.agent import WARNING, Agent
from armadico.core.geometry import Pose2, compose, relative, wrap
from armadico.core.messages import Correction, Message, Origin, Pose, RobotState, next_count

Metres = Annotated[float, Meta(ge=-1e5, le=1e5)]

AGAIN_CYCLES = 10
"""Cycles from one publication of the origin to the next."""

YOUNG_CYCLES = 30
"""An older epoch has had an encoder agent before: some agent remembers its origin."""

TOLD_CYCLES = 10
"""In an older epoch, cycles without a pose while no origin was received: on a slow network the pose
would be that of the parameters first, and the right one half a second later."""

ROLLED_M = 3.0
"""So far may a robot have come between two robot agents: a second of driving until the last status
packet, two until the controller's watchdog, and braking."""

ZERO_M, ZERO_RAD = 0.05, 0.1
"""An odometry within this of zero has just begun, unless it was near zero before."""

NEAR_M, NEAR_RAD = 0.3, 0.5
"""Within this of zero it was near zero before."""


SURE = 0.5
"""A correction of less confidence than this moves nothing."""

CREEP_M, CREEP_RAD = 0.02, 0.02
"""So far a correction moves the pose in one cycle: behaviours follow it as they follow the robot,
and no wheel jerks."""

LEAP_M, LEAP_RAD = 0.5, 0.5
"""A pose that is further off than this is wrong altogether: it is corrected at once."""

GROWS = 0.01
"""The variance of the pose grows by this for each metre that nobody corrects (m^2 and rad^2): a
Pioneer's wheels, uncalibrated, drift 0.1 m in a metre at worst."""

WIDEST = 1e4
"""No variance grows beyond this: m^2, rad^2."""

NOWHERE_M = 2e5
"""A place beyond this is no place: what led there was not true, and the parameters count again."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Where the robot stands in the world when no agent remembers: m, m, rad."""

    x: Metres = 0.0
    y: Metres = 0.0
    theta: Annotated[float, Meta(ge=-6.2832, le=6.2832)] = 0.0


class Encoder(Agent):
    """Turns the controller's odometry into a pose in the world frame.

    Where the odometry's origin lies is a latched state: it outlives this process, and the robot
    agent's. Only if no agent remembers it do the parameters count.
    """

    name = "encoder"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Correction,)
    provides: ClassVar[tuple[type[Message], ...]] = (Pose, Origin)
    parameters = Parameters
    launched_with = ("x", "y", "theta")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._origin: Origin | None = None
        self._id = self.rng.getrandbits(63)
        self._published = 0
        self._waited = 0  # cycles without an origin
        self._last: tuple[int, Pose2] | None = None  # the epoch, and the odometry last known of it
        self._correction: Correction | None = None
        self._covariance: tuple[float, ...] = ()

    def on_origin(self, origin: Origin) -> None:
        """A peer has known it for longer."""
        self._origin = origin

    def on_correction(self, correction: Correction) -> None:
        """Somebody knows better by a map (thesis 3.4.1)."""
        xx, _, _, yy, _, tt = correction.covariance
        if min(xx, yy, tt) < 0.0 or max(abs(correction.x), abs(correction.y)) > NOWHERE_M:
            return  # no variance is negative, nor is any place there: it is not true
        self._covariance = correction.covariance
        self._correction = correction if correction.confidence >= SURE else None

    def _corrected(self, known: Origin, odometry: Pose2) -> Origin:
        """The origin, moved towards where the newest correction has it, as far as a cycle may."""
        to = self._correction
        if to is None or to.cycle.epoch != known.epoch:
            return known
        here = compose((known.x, known.y, known.theta), odometry)
        there = compose((to.x, to.y, to.theta), odometry)
        off, turned = hypot(there[0] - here[0], there[1] - here[1]), wrap(there[2] - here[2])
        if off > LEAP_M or abs(turned) > LEAP_RAD:
            self.log(f"the pose was {off:.2f} m and {abs(turned):.2f} rad off", WARNING)
            share = 1.0
        else:
            share = min(1.0, CREEP_M / max(off, 1e-9), CREEP_RAD / max(abs(turned), 1e-9))
        place = (
            here[0] + share * (there[0] - here[0]),
            here[1] + share * (there[1] - here[1]),
            here[2] + share * turned,
        )
        x, y, theta = compose(place, relative(odometry, (0.0, 0.0, 0.0)))
        return replace(known, x=x, y=y, theta=theta)

    def on_robot_state(self, state: RobotState) -> None:
        """One status packet, one pose."""
        odometry = (state.x, state.y, state.theta)
        known = self._origin
        epoch = state.cycle.epoch
        if known is None:
            self._waited += 1
            if state.cycle.number > YOUNG_CYCLES and self._waited <= TOLD_CYCLES:
                return
            place = (self.p.x, self.p.y, self.p.theta)
            known = self._begin(place, odometry, epoch, 1)
        elif known.epoch != epoch:
            known = self._go_on(self._lately(known), odometry, epoch)
        begins = known is not self._origin
        self._origin = known = self._corrected(known, odometry)
        if self._covariance and self._last is not None and self._last[0] == epoch:
            self._covariance = grown(self._covariance, relative(self._last[1], odometry))
        self._last = (epoch, odometry)
        pose = compose((known.x, known.y, known.theta), odometry)
        self.publish(Pose(state.cycle, *pose, self._covariance))
        self._published += 1
        if begins or self._published % AGAIN_CYCLES == 0:
            self._keep(known, odometry)

    def _lately(self, known: Origin) -> Origin:
        """The origin, with the last odometry of its epoch that this agent received itself.

        It is published once a second only: a robot that drove on meanwhile would be set back.
        """
        if self._last is None or self._last[0] != known.epoch:
            return known
        x, y, theta = self._last[1]
        return replace(known, at_x=x, at_y=y, at_theta=theta)

    def _keep(self, origin: Origin, odometry: Pose2) -> None:
        """Publish the origin, with where the odometry is now; the longer it is known the larger."""
        self._origin = Origin(
            next_count(origin.counter),
            origin.by,
            origin.epoch,
            origin.x,
            origin.y,
            origin.theta,
            *odometry,
        )
        self.publish(self._origin)

    def _begin(self, place: Pose2, odometry: Pose2, epoch: int, counter: int) -> Origin:
        """The origin by which the robot is at a place in the world now."""
        if max(map(abs, place[:2])) > NOWHERE_M:
            place = (self.p.x, self.p.y, self.p.theta)
        origin = compose(place, relative(odometry, (0.0, 0.0, 0.0)))
        return Origin(counter, self._id, epoch, *origin, *odometry)

    def _go_on(self, known: Origin, odometry: Pose2, epoch: int) -> Origin:
        """Another robot agent: the controller has counted on, or begun anew."""
        x, y, theta = odometry
        away = hypot(x - known.at_x, y - known.at_y)
        turned = abs(wrap(theta - known.at_theta))
        at_zero = hypot(x, y) < ZERO_M and abs(theta) < ZERO_RAD
        anew = away > ROLLED_M or (at_zero and (away > NEAR_M or turned > NEAR_RAD))
        if not anew:
            return Origin(known.counter, known.by, epoch, known.x, known.y, known.theta, *odometry)
        # The robot has not jumped. What it rolled meanwhile was not counted.
        was = (known.at_x, known.at_y, known.at_theta)
        place = compose((known.x, known.y, known.theta), was)
        self.log("the controller's odometry has begun anew: the pose goes on from here", WARNING)
        return self._begin(place, odometry, epoch, known.counter)


def grown(covariance: tuple[float, ...], motion: Pose2) -> tuple[float, ...]:
    """The covariance of a pose after a motion that nobody corrects."""
    more = GROWS * hypot(motion[0], motion[1])
    xx, xy, xt, yy, yt, tt = covariance
    return (min(xx + more, WIDEST), xy, xt, min(yy + more, WIDEST), yt, min(tt + more, WIDEST))
