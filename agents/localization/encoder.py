"""The encoder agent: estimates the pose in the world from the wheel encoders (thesis 3.4.1)."""

from __future__ import annotations

from math import hypot, radians
from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.agents.methods.odometry import WIDEST, may_apply, out_of_range, was_reset
from armadico.core import agent
from armadico.core.agent import WARNING, Agent
from armadico.core.messages import Message, RobotState, next_count
from armadico.mobile.geometry import STOOD, Pose2, compose, relative, wrap
from armadico.mobile.messages import COVARIANCE, Correction, InitialPose, Origin, Pose

Metres = Annotated[float, Meta(ge=-1e5, le=1e5)]

ORIGIN_CYCLES = 10
"""Cycles from one publication of the origin to the next."""

YOUNG_EPOCH_CYCLES = 30
"""Older epochs have had an encoder agent before, so another agent has its origin."""

BEFORE_CYCLES, OLDER_CYCLES = 10, 3
"""A correction from up to this many cycles before an initial pose, or after it, may have been
computed before that pose was known."""

WAIT_CYCLES = 10
"""In an older epoch, cycles without a pose while no origin is received. Otherwise, on a slow
network, the pose would be that of the parameters for half a second, and then jump."""

SURE = 0.5
"""A correction of less confidence does not move the pose."""

CREEP_M, CREEP_RAD = 0.02, 0.02
"""Greatest change of the pose by a correction in one cycle: behaviours follow the pose, and a
larger step would jerk the wheels."""

LEAP_M, LEAP_RAD = 0.5, 0.5
"""A pose with a larger error than this is corrected at once."""

GIVEN = (0.15**2, 0.0, 0.0, 0.15**2, 0.0, radians(6.0) ** 2)
"""Covariance of a pose that a person gave, until the localization agent corrects it: as its
`start_m` and `start_rad`. Where nothing ever corrected the pose, it stays unknown."""

GROWTH = 0.01
"""Growth of the pose's variance per metre without a correction (m^2 and rad^2). A Pioneer's
uncalibrated wheels drift by 0.1 m per metre at worst."""

UNCOUNTED_M = 25.0
"""Uncorrected distance that a reset of the odometry counts as: half a metre and half a radian of
uncounted motion."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Initial pose in the world if no agent has the origin: m, m, rad."""

    x: Metres = 0.0
    y: Metres = 0.0
    theta: Annotated[float, Meta(ge=-6.2832, le=6.2832)] = 0.0
    exact: bool = False  # the odometry and this pose have no error, as in some simulations


class Encoder(Agent):
    """Converts the controller's odometry into a pose in the world frame.

    The pose of the odometry's origin is a latched state: it survives a restart of this process and
    of the robot agent. The parameters count only if no agent has it.
    """

    name = "encoder"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (Correction, InitialPose)
    provides: ClassVar[tuple[type[Message], ...]] = (Pose, Origin)
    parameters = Parameters
    launched_with = ("x", "y", "theta", "exact")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._id = self.rng.getrandbits(63)
        self._counter, self._by = 0, self._id  # of the origin
        self._origin: Pose2 | None = None  # its pose in the world; None: not known yet
        self._known = 0, STOOD  # the origin's epoch, and the last odometry of that epoch
        self._published = 0
        # Whether confidence was lost, or the origin jumped, since it was published.
        self._unpublished = False
        self._waited = 0  # cycles without an origin
        self._correction: Correction | None = None
        self._revision = 0  # of the map that the origin belongs to
        self._covariance: tuple[float, ...] = COVARIANCE * (0.0,) if self.p.exact else ()
        self._initial_pose_at = 0, 0  # the newest cycle, epoch and number, at the last initial pose

    def on_origin(self, origin: Origin) -> None:
        """Adopt the origin of a peer that has known it for longer."""
        if self._origin is None or self._known[0] != origin.epoch:
            # Not in an epoch of which this agent received odometry itself: that is newer. The
            # origin is published once a second, so a moving robot would be set back.
            self._known = origin.epoch, (origin.at_x, origin.at_y, origin.at_theta)
        self._origin = origin.x, origin.y, origin.theta
        self._counter, self._by = origin.counter, origin.by
        if self.p.exact or not self._covariance:
            known = len(origin.covariance) == COVARIANCE
            self._covariance = origin.covariance if known else ()

    def on_correction(self, correction: Correction) -> None:
        """Apply a correction from a map (thesis 3.4.1)."""
        xx, _, _, yy, _, tt = correction.covariance
        initial = self._initial_pose_at
        late = correction.cycle.number - initial[1] if correction.cycle.epoch == initial[0] else 0
        if initial[1] and -BEFORE_CYCLES <= late <= OLDER_CYCLES:
            return  # computed from the pose before the initial pose
        if min(xx, yy, tt) < 0.0 or out_of_range(correction.x, correction.y):
            return  # invalid: a negative variance, or a position out of range
        self._covariance = correction.covariance
        sure = correction.confidence >= SURE or correction.revision != self._revision
        self._unpublished |= not sure and self._correction is not None
        self._correction = correction if sure else None

    def on_initial_pose(self, initial: InitialPose) -> None:
        """Set the pose from the operator, passed on by the interface agent (thesis 5.2.5)."""
        state = self.latest(RobotState)
        if state is None or self._origin is None or not may_apply(initial, state):
            return
        odometry = (state.x, state.y, state.theta)
        self._initial_pose_at = state.cycle.epoch, state.cycle.number
        self._correction, self._covariance = None, GIVEN if self._covariance else ()
        self._origin = self._begin((initial.x, initial.y, initial.theta), odometry)
        self._publish_origin(self._origin, odometry, state.cycle.epoch)
        self.log(f"initial pose set: ({initial.x:.2f}, {initial.y:.2f})")

    def on_robot_state(self, state: RobotState) -> None:
        """Publish one pose per status packet."""
        odometry, epoch = (state.x, state.y, state.theta), state.cycle.epoch
        begins = self._origin is None or self._known[0] != epoch
        if self._origin is None:
            self._waited += 1
            if state.cycle.number > YOUNG_EPOCH_CYCLES and self._waited <= WAIT_CYCLES:
                return
            self._counter = 1
            origin = self._begin((self.p.x, self.p.y, self.p.theta), odometry)
        else:
            origin = self._continue(self._origin, odometry, epoch)
        self._origin = origin = self._corrected(origin, odometry, epoch)
        self._known = epoch, odometry
        place = compose(origin, odometry)
        self.publish(Pose(state.cycle, *place, self._covariance, self._revision))
        self._published += 1
        if begins or self._unpublished or self._published % ORIGIN_CYCLES == 0:
            self._publish_origin(origin, odometry, epoch)

    def _corrected(self, origin: Pose2, odometry: Pose2, epoch: int) -> Pose2:
        """The origin, moved towards the newest correction by at most one cycle's step."""
        to = self._correction
        if to is None or to.cycle.epoch != epoch:
            return origin
        here = compose(origin, odometry)
        there = compose((to.x, to.y, to.theta), odometry)
        off, turned = hypot(there[0] - here[0], there[1] - here[1]), wrap(there[2] - here[2])
        if to.revision != self._revision:  # the pose must lie on the map of its time
            share, self._unpublished = 1.0, True
        elif off > LEAP_M or abs(turned) > LEAP_RAD:
            self.log(f"the pose was {off:.2f} m and {abs(turned):.2f} rad off", WARNING)
            share, self._unpublished = 1.0, True
        else:
            share = min(1.0, CREEP_M / max(off, 1e-9), CREEP_RAD / max(abs(turned), 1e-9))
        self._revision = to.revision
        place = (
            here[0] + share * (there[0] - here[0]),
            here[1] + share * (there[1] - here[1]),
            here[2] + share * turned,
        )
        return compose(place, relative(odometry, STOOD))

    def _publish_origin(self, origin: Pose2, odometry: Pose2, epoch: int) -> None:
        """Publish the origin and the present odometry, with a greater counter."""
        self._unpublished = False
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
        """The origin for which the robot's present pose is `place`."""
        if out_of_range(*place[:2]):
            place = (self.p.x, self.p.y, self.p.theta)
        self._by = self._id
        return compose(place, relative(odometry, STOOD))

    def _continue(self, origin: Pose2, odometry: Pose2, epoch: int) -> Pose2:
        """The origin with another robot agent, or after the odometry was reset."""
        before, was = self._known
        if before == epoch or not was_reset(was, odometry):
            if not self.p.exact:
                self._covariance = grown(self._covariance, relative(was, odometry))
            return origin
        uncounted = UNCOUNTED_M, 0.0, 0.0
        self._covariance = () if self.p.exact else grown(self._covariance, uncounted)
        # The robot has not jumped. Its motion meanwhile was not counted.
        self.log("the controller's odometry was reset: the pose continues from here", WARNING)
        return self._begin(compose(origin, was), odometry)


def grown(covariance: tuple[float, ...], motion: Pose2) -> tuple[float, ...]:
    """The covariance of a pose after an uncorrected motion; () if it was unknown."""
    if not covariance:
        return ()
    more = GROWTH * hypot(motion[0], motion[1])
    xx, xy, xt, yy, yt, tt = covariance
    return (min(xx + more, WIDEST), xy, xt, min(yy + more, WIDEST), yt, min(tt + more, WIDEST))
