"""The encoder agent: where the robot is in the world, by its encoders (thesis 3.4.1)."""

from __future__ import annotations

from math import hypot
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.methods.odometry import WIDEST, begun_anew, may_stand_at, nowhere
from armadico.core import agent
from armadico.core.agent import WARNING, Agent
from armadico.core.messages import Message, RobotState, next_count
from armadico.mobile.geometry import STOOD, Pose2, compose, relative, wrap
from armadico.mobile.messages import COVARIANCE, Correction, InitialPose, Origin, Pose

Metres = Annotated[float, Meta(ge=-1e5, le=1e5)]

AGAIN_CYCLES = 10
"""Cycles from one publication of the origin to the next."""

YOUNG_CYCLES = 30
"""An older epoch has had an encoder agent before: some agent remembers its origin."""

BEFORE_CYCLES, OLDER_CYCLES = 10, 3
"""A correction of so few cycles before an initial pose, and after it, may have been made before
that was known."""

TOLD_CYCLES = 10
"""In an older epoch, cycles without a pose while no origin was received: on a slow network the pose
would be that of the parameters first, and the right one half a second later."""

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

UNCOUNTED_M = 25.0
"""A controller that has begun anew has not counted what rolled meanwhile: half a metre and half a
radian, as if the robot had come so far uncorrected."""


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
    hears: ClassVar[tuple[type[Message], ...]] = (Correction, InitialPose)
    provides: ClassVar[tuple[type[Message], ...]] = (Pose, Origin)
    parameters = Parameters
    launched_with = ("x", "y", "theta")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._id = self.rng.getrandbits(63)
        self._counter, self._by = 0, self._id  # of the origin
        self._origin: Pose2 | None = None  # where it lies in the world; None: nobody has said
        self._known = 0, STOOD  # its epoch, and the odometry last known of that
        self._published = 0
        self._unsaid = False  # the origin was given up, or leapt, since it was published
        self._waited = 0  # cycles without an origin
        self._correction: Correction | None = None
        self._revision = 0  # of the map that the origin belongs to
        self._covariance: tuple[float, ...] = ()
        self._told_at = 0, 0  # the newest cycle, epoch and number, at the last initial pose

    def on_origin(self, origin: Origin) -> None:
        """A peer has known it for longer."""
        if self._origin is None or self._known[0] != origin.epoch:
            # Of an epoch of which this agent received odometry itself that is newer: the origin is
            # published once a second only, and a robot that drove on meanwhile would be set back.
            self._known = origin.epoch, (origin.at_x, origin.at_y, origin.at_theta)
        self._origin = origin.x, origin.y, origin.theta
        self._counter, self._by = origin.counter, origin.by
        if not self._covariance and len(origin.covariance) == COVARIANCE:
            self._covariance = origin.covariance

    def on_correction(self, correction: Correction) -> None:
        """Somebody knows better by a map (thesis 3.4.1)."""
        xx, _, _, yy, _, tt = correction.covariance
        told = self._told_at
        late = correction.cycle.number - told[1] if correction.cycle.epoch == told[0] else 0
        if told[1] and -BEFORE_CYCLES <= late <= OLDER_CYCLES:
            return  # of where the robot was taken to be before
        if min(xx, yy, tt) < 0.0 or nowhere(correction.x, correction.y):
            return  # no variance is negative, nor is any place there: it is not true
        self._covariance = correction.covariance
        sure = correction.confidence >= SURE
        self._unsaid |= not sure and self._correction is not None
        self._correction = correction if sure else None

    def on_initial_pose(self, told: InitialPose) -> None:
        """People know where the robot stands (thesis 5.2.5): the interface agent passes it on."""
        state = self.latest(RobotState)
        if state is None or self._origin is None or not may_stand_at(told, state):
            return
        odometry = (state.x, state.y, state.theta)
        self._told_at = state.cycle.epoch, state.cycle.number
        self._correction, self._covariance = None, ()
        self._origin = self._begin((told.x, told.y, told.theta), odometry)
        self._keep(self._origin, odometry, state.cycle.epoch)
        self.log(f"the robot stands at ({told.x:.2f}, {told.y:.2f}), as it was told")

    def on_robot_state(self, state: RobotState) -> None:
        """One status packet, one pose."""
        odometry, epoch = (state.x, state.y, state.theta), state.cycle.epoch
        begins = self._origin is None or self._known[0] != epoch
        if self._origin is None:
            self._waited += 1
            if state.cycle.number > YOUNG_CYCLES and self._waited <= TOLD_CYCLES:
                return
            self._counter = 1
            origin = self._begin((self.p.x, self.p.y, self.p.theta), odometry)
        else:
            origin = self._go_on(self._origin, odometry, epoch)
        self._origin = origin = self._corrected(origin, odometry, epoch)
        self._known = epoch, odometry
        self.publish(Pose(state.cycle, *compose(origin, odometry), self._covariance))
        self._published += 1
        if begins or self._unsaid or self._published % AGAIN_CYCLES == 0:
            self._keep(origin, odometry, epoch)

    def _corrected(self, origin: Pose2, odometry: Pose2, epoch: int) -> Pose2:
        """The origin, moved towards where the newest correction has it, as far as a cycle may."""
        to = self._correction
        if to is None or to.cycle.epoch != epoch:
            return origin
        here = compose(origin, odometry)
        there = compose((to.x, to.y, to.theta), odometry)
        off, turned = hypot(there[0] - here[0], there[1] - here[1]), wrap(there[2] - here[2])
        if off > LEAP_M or abs(turned) > LEAP_RAD:
            self.log(f"the pose was {off:.2f} m and {abs(turned):.2f} rad off", WARNING)
            share, self._unsaid = 1.0, True
        elif to.revision != self._revision:  # the pose must lie on the map of its time
            share, self._unsaid = 1.0, True
        else:
            share = min(1.0, CREEP_M / max(off, 1e-9), CREEP_RAD / max(abs(turned), 1e-9))
        self._revision = to.revision
        place = (
            here[0] + share * (there[0] - here[0]),
            here[1] + share * (there[1] - here[1]),
            here[2] + share * turned,
        )
        return compose(place, relative(odometry, STOOD))

    def _keep(self, origin: Pose2, odometry: Pose2, epoch: int) -> None:
        """Publish the origin, with where the odometry is now; the longer it is known the larger."""
        self._unsaid = False
        self._counter = next_count(self._counter)
        self.publish(
            Origin(
                self._counter,
                self._by,
                epoch,
                *origin,
                *odometry,
                covariance=self._covariance,
            )
        )

    def _begin(self, place: Pose2, odometry: Pose2) -> Pose2:
        """The origin by which the robot is at a place in the world now."""
        if nowhere(*place[:2]):
            place = (self.p.x, self.p.y, self.p.theta)
        self._by = self._id
        return compose(place, relative(odometry, STOOD))

    def _go_on(self, origin: Pose2, odometry: Pose2, epoch: int) -> Pose2:
        """With another robot agent the controller has counted on, or begun anew."""
        before, was = self._known
        if before == epoch or not begun_anew(was, odometry):
            self._covariance = grown(self._covariance, relative(was, odometry))
            return origin
        self._covariance = grown(self._covariance, (UNCOUNTED_M, 0.0, 0.0))
        # The robot has not jumped. What it rolled meanwhile was not counted.
        self.log("the controller's odometry has begun anew: the pose goes on from here", WARNING)
        return self._begin(compose(origin, was), odometry)


def grown(covariance: tuple[float, ...], motion: Pose2) -> tuple[float, ...]:
    """The covariance of a pose after a motion that nobody corrects; nobody's is nobody's."""
    if not covariance:
        return ()
    more = GROWS * hypot(motion[0], motion[1])
    xx, xy, xt, yy, yt, tt = covariance
    return (min(xx + more, WIDEST), xy, xt, min(yy + more, WIDEST), yt, min(tt + more, WIDEST))
