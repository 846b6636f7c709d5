"""The encoder agent's pose: in the world, and continuous across restarts."""

from __future__ import annotations

import random
from math import hypot, isnan, nan, pi

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.agents.localization.encoder import (
    CREEP_M,
    CREEP_RAD,
    GIVEN,
    LEAP_M,
    ORIGIN_CYCLES,
    WAIT_CYCLES,
    YOUNG_EPOCH_CYCLES,
    Encoder,
    Parameters,
)
from armadico.agents.methods.odometry import ROLLED_M
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Log, RobotState, checked
from armadico.mobile.geometry import compose, relative
from armadico.mobile.messages import Correction, InitialPose, Origin, Pose
from armadico.testing import Alone
from tests.core.test_messages import of

metres, angles = st.floats(-20, 20), st.floats(-3.1, 3.1)
places = st.tuples(metres, metres, angles)
Place = tuple[float, float, float]


class Robot(Alone):
    """Publishes its odometry in each cycle."""

    def __init__(
        self, x: float = 0.0, y: float = 0.0, theta: float = 0.0, *, exact: bool = False
    ) -> None:
        self.parameters = Parameters(x=x, y=y, theta=theta, exact=exact)
        self.starts = 0
        super().__init__(self.new_encoder(), robot=None)
        self.poses: list[Pose] = []

    def new_encoder(self) -> Encoder:
        self.starts += 1
        identity = Identity(f"encoder-{self.starts}", rng=random.Random(self.starts))
        return Encoder(identity, self.parameters)

    def moved(self, x: float, y: float, theta: float, v: float = 0.0) -> Pose:
        self.odometry, self.speed = (x, y, theta), (v, 0.0)
        messages = self.state()
        self.poses = [message for message in messages if isinstance(message, Pose)]
        assert all(found.cycle == self.at for found in self.poses)
        return self.poses[0] if self.poses else Pose(self.at, nan, nan, nan)

    def origin(self) -> Origin:
        return self.last(Origin)

    def restart(self) -> None:
        """Another robot agent; a new epoch counts once the one before is silent."""
        self.epoch += 1
        self.number = 0
        self.now += 1.0

    def restart_encoder(self, *, remembered: bool = True) -> None:
        """Another encoder agent; other agents return the origin."""
        known = self.origin()
        self.agent = self.new_encoder()
        if remembered:
            self.agent.kernel.remember(known, self.now)
            self.agent.kernel.start(self.now)


@settings(max_examples=30)
@given(
    lies=st.lists(st.tuples(of(Origin), of(Correction), of(RobotState)), max_size=4),
    x=metres,
    y=metres,
)
def test_no_invalid_input_stops_its_pose(
    lies: list[tuple[Origin, Correction, RobotState]], x: float, y: float
) -> None:
    robot = Robot()
    for origin, correction, state in lies:
        robot.give(origin)
        here = replace(correction, cycle=Cycle(robot.epoch, max(robot.number, 1)))
        robot.give(here)
        checked(robot.moved(state.x, state.y, state.theta))
        robot.restart()
        checked(robot.moved(state.x, state.y, state.theta))
    robot.restart()
    for _ in range(WAIT_CYCLES + ORIGIN_CYCLES + 1):
        checked(robot.moved(x, y, 0.0))
    assert checked(robot.origin()) == robot.agent.memory.newest(Origin)


def pose(p: Pose) -> Place:
    return p.x, p.y, p.theta


def test_odometry_is_put_where_the_robot_stood() -> None:
    robot = Robot(x=3.4, y=0.6, theta=pi / 2)
    assert pose(robot.moved(0, 0, 0)) == pytest.approx((3.4, 0.6, pi / 2))
    assert pose(robot.moved(2.0, 0.5, -0.3)) == pytest.approx((2.9, 2.6, pi / 2 - 0.3))


def test_headings_stay_in_one_turn() -> None:
    robot = Robot(theta=3.0)
    robot.moved(0, 0, 0)
    assert -pi < robot.moved(0, 0, 3.0).theta <= pi


@given(places, places, places)
def test_a_robot_agent_whose_controller_counts_on_does_not_move_the_robot(
    begins: Place, before: Place, goes: Place
) -> None:
    """At any number of restarts: continuous odometry is the robot's motion."""
    robot = Robot(x=1.0, y=-2.0, theta=0.5)
    robot.moved(*begins)
    stood = robot.moved(*before)
    robot.restart()
    assert pose(robot.moved(*before)) == pytest.approx(pose(stood), abs=1e-9)
    moved = robot.moved(*goes)
    way = (moved.x - stood.x) ** 2 + (moved.y - stood.y) ** 2
    assert way == pytest.approx((goes[0] - before[0]) ** 2 + (goes[1] - before[1]) ** 2, abs=1e-6)


far = st.tuples(st.floats(-20, 20).filter(lambda x: abs(x) > ROLLED_M), metres, angles)


@given(far, places)
def test_a_controller_that_zeroes_its_odometry_does_not_move_the_robot_either(
    before: Place, goes: Place
) -> None:
    robot = Robot(x=1.0, y=-2.0, theta=0.5)
    robot.moved(0.0, 0.0, 0.0)
    stood = robot.moved(*before)
    robot.restart()
    assert pose(robot.moved(0.0, 0.0, 0.0)) == pytest.approx(pose(stood), abs=1e-6)
    assert any(
        isinstance(message, Log) and "odometry" in message.text for message in robot.published
    )
    expected = compose(pose(stood), goes)
    assert pose(robot.moved(*goes))[:2] == pytest.approx(expected[:2], abs=1e-6)


@pytest.mark.parametrize("x", [0.4, 1.0, 2.9])
def test_a_controller_at_zero_has_begun_anew_though_it_was_not_far(x: float) -> None:
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    stood = robot.moved(x, 0.0, 0.0)
    robot.restart()
    assert pose(robot.moved(0.0, 0.0, 0.0)) == pytest.approx(pose(stood), abs=1e-9)


def test_what_it_rolled_while_no_robot_agent_listened_is_part_of_its_way() -> None:
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    robot.moved(4.0, 0.0, 0.0)
    robot.restart()
    assert pose(robot.moved(4.5, 0.0, 0.0)) == pytest.approx((4.5, 0.0, 0.0))


@given(places, places, places)
def test_an_encoder_agent_that_restarts_goes_on_by_what_the_others_remember(
    begins: Place, before: Place, goes: Place
) -> None:
    robot = Robot(x=1.0, y=-2.0, theta=0.5)
    robot.moved(*begins)
    stood = robot.moved(*before)
    robot.restart_encoder()
    assert pose(robot.moved(*before)) == pytest.approx(pose(stood), abs=1e-9)
    expected = compose(pose(stood), relative(before, goes))
    assert pose(robot.moved(*goes))[:2] == pytest.approx(expected[:2], abs=1e-6)


@pytest.mark.parametrize("first", ["robot", "encoder"])
@pytest.mark.parametrize("zeroes", [False, True])
def test_both_may_restart_in_either_order(first: str, zeroes: bool) -> None:
    robot = Robot(x=1.0, y=-2.0, theta=0.5)
    robot.moved(0.0, 0.0, 0.0)
    for _ in range(ORIGIN_CYCLES):
        stood = robot.moved(3.5, 1.0, 0.7)
    if first == "robot":
        robot.restart()
        robot.restart_encoder()
    else:
        robot.restart_encoder()
        robot.restart()
    after = robot.moved(0.0, 0.0, 0.0) if zeroes else robot.moved(3.5, 1.0, 0.7)
    assert pose(after) == pytest.approx(pose(stood), abs=1e-9)


def test_without_a_remembered_origin_the_parameters_count() -> None:
    """The odometry begins where the controller's is; before, its zero was put there."""
    robot = Robot(x=1.0)
    robot.moved(0.0, 0.0, 0.0)
    robot.moved(2.0, 0.0, 0.0)
    robot.restart_encoder(remembered=False)
    assert pose(robot.moved(2.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))


def test_a_late_agent_waits_a_while_for_the_origin() -> None:
    robot = Robot(x=5.0)
    for _ in range(YOUNG_EPOCH_CYCLES):
        robot.moved(1.0, 0, 0)
    known = robot.origin()
    robot.restart_encoder(remembered=False)
    robot.agent.kernel.start(robot.now)
    messages = [robot.moved(1.0, 0, 0) for _ in range(WAIT_CYCLES)]
    assert all(isnan(pose.x) for pose in messages)
    robot.give(known)
    assert pose(robot.moved(1.0, 0, 0)) == pytest.approx((5.0, 0, 0))


def test_a_late_agent_without_an_origin_begins_by_itself() -> None:
    robot = Robot(x=5.0)
    robot.number = YOUNG_EPOCH_CYCLES
    for _ in range(WAIT_CYCLES):
        robot.moved(1.0, 0, 0)
    assert pose(robot.moved(1.0, 0, 0)) == pytest.approx((5.0, 0, 0))


def test_the_origin_is_published_at_once_and_each_second_with_the_odometry() -> None:
    robot = Robot(x=1.0)
    cycles = 4 * ORIGIN_CYCLES
    for number in range(cycles):
        robot.moved(0.01 * number, 0.0, 0.0)
    messages = [message for message in robot.published if isinstance(message, Origin)]
    assert len(messages) == 1 + cycles // ORIGIN_CYCLES
    assert [origin.counter for origin in messages] == sorted(
        {origin.counter for origin in messages}
    )
    assert {(origin.x, origin.y, origin.theta, origin.by) for origin in messages} == {
        (1.0, 0.0, 0.0, messages[0].by)
    }
    assert messages[-1].at_x == pytest.approx(0.01 * (cycles - 1))


def test_of_two_origins_the_one_that_has_been_known_for_longer_is_everybodys() -> None:
    old, young = Robot(x=1.0), Robot(x=50.0)
    for _ in range(3 * ORIGIN_CYCLES):
        old.moved(0.0, 0.0, 0.0)
    young.moved(0.0, 0.0, 0.0)
    known = old.origin()
    old.give(young.origin())
    young.give(known)
    assert pose(old.moved(0.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))
    assert pose(young.moved(0.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))


# Corrections (thesis 3.4.1) -----------------------------------------------------------------------

SURE = (0.01, 0.0, 0.0, 0.01, 0.0, 0.001)


def correct(
    robot: Robot, origin: Place, confidence: float = 1.0, covariance: tuple[float, ...] = SURE
) -> None:
    cycle = Cycle(robot.epoch, robot.number)
    robot.give(Correction(cycle, *origin, covariance, confidence))


@given(st.floats(-LEAP_M / 2, LEAP_M / 2), st.floats(-LEAP_M / 2, LEAP_M / 2), st.floats(-0.4, 0.4))
def test_a_correction_moves_the_pose_by_steps_and_gets_there(
    x: float, y: float, theta: float
) -> None:
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    before = pose(robot.moved(2.0, 1.0, 0.3))
    there = compose((x, y, theta), (2.0, 1.0, 0.3))
    assume(hypot(there[0] - 2.0, there[1] - 1.0) < LEAP_M)
    correct(robot, (x, y, theta))
    for _ in range(60):
        now = pose(robot.moved(2.0, 1.0, 0.3))
        assert abs(now[0] - before[0]) <= CREEP_M + 1e-9
        assert abs(now[1] - before[1]) <= CREEP_M + 1e-9
        assert abs(now[2] - before[2]) <= CREEP_RAD + 1e-9
        before = now
    assert before == pytest.approx(there, abs=1e-6)


def test_a_pose_with_a_large_error_is_corrected_at_once_and_logged() -> None:
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    correct(robot, (5.0, 0.0, 1.0))
    assert pose(robot.moved(0.0, 0.0, 0.0)) == pytest.approx((5.0, 0.0, 1.0))
    assert any(isinstance(message, Log) and "5.00 m" in message.text for message in robot.published)


def test_a_guess_without_confidence_moves_nothing_and_is_no_secret() -> None:
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    correct(robot, (5.0, 0.0, 1.0), confidence=0.0)
    found = robot.moved(0.0, 0.0, 0.0)
    assert pose(found) == (0.0, 0.0, 0.0)
    assert found.covariance == SURE


@pytest.mark.parametrize(
    ("origin", "covariance"),
    [((5.0, 0.0, 0.0), (-1.0, 0.0, 0.0, -1.0, 0.0, -1.0)), ((4e5, 0.0, 0.0), SURE)],
)
def test_a_correction_that_cannot_be_true_is_none(
    origin: Place, covariance: tuple[float, ...]
) -> None:
    """A negative variance is no certainty, and 400 km away there is no room to drive in."""
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    correct(robot, origin, covariance=covariance)
    found = robot.moved(0.0, 0.0, 0.0)
    assert (*pose(found), found.covariance) == (0.0, 0.0, 0.0, ())


def test_a_correction_of_another_epoch_moves_nothing() -> None:
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    correct(robot, (5.0, 0.0, 1.0))
    robot.restart()
    assert pose(robot.moved(0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)


def test_without_corrections_the_covariance_is_unknown_and_after_one_it_grows() -> None:
    robot = Robot()
    assert robot.moved(0.0, 0.0, 0.0).covariance == ()
    assert robot.moved(0.0, 0.0, 0.0).deviation == 0.0
    correct(robot, (0.0, 0.0, 0.0))
    first = robot.moved(0.0, 0.0, 0.0).deviation
    assert first == pytest.approx(0.02**0.5)
    assert robot.moved(1.0, 0.0, 0.0).deviation > first


def test_an_exact_odometry_makes_the_pose_known_until_it_is_reset() -> None:
    robot = Robot(exact=True)
    for x in (0.0, 50.0):
        assert robot.moved(x, 0.0, 0.0).covariance == (0.0,) * 6
    robot.restart()
    assert robot.moved(0.0, 0.0, 0.0).covariance == (), "the motion meanwhile was not counted"


def test_how_far_off_it_may_be_outlives_the_encoder_agent_and_grows_by_the_way_since() -> None:
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    correct(robot, (5.0, 0.0, 1.0), confidence=0.0)
    for _ in range(ORIGIN_CYCLES + 1):
        found = robot.moved(0.0, 0.0, 0.0)
    robot.restart_encoder()
    assert robot.moved(0.0, 0.0, 0.0).covariance == found.covariance
    robot.restart_encoder()
    assert robot.moved(1.0, 0.0, 0.0).deviation > found.deviation


@pytest.mark.parametrize(("at", "off"), [(0.0, 0.5), (2.0, 0.0)])
def test_what_a_reset_odometry_has_not_counted_widens_the_covariance(at: float, off: float) -> None:
    robot = Robot()
    robot.moved(2.0, 0.0, 0.0)
    correct(robot, (0.0, 0.0, 0.0))
    before = robot.moved(2.0, 0.0, 0.0)
    robot.restart()
    found = robot.moved(at, 0.0, 0.0)
    assert found.deviation**2 == pytest.approx(before.deviation**2 + 2.0 * off**2)
    assert found.heading_deviation**2 == pytest.approx(before.heading_deviation**2 + off**2)


def test_a_correction_does_not_have_the_origin_published_each_cycle() -> None:
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    correct(robot, (0.4, 0.0, 0.0))
    robot.published.clear()
    for _ in range(2 * ORIGIN_CYCLES):
        robot.moved(0.0, 0.0, 0.0)
    assert sum(isinstance(message, Origin) for message in robot.published) == 2


@pytest.mark.parametrize("x", [0.1, 5.0])
def test_an_encoder_agent_that_restarts_remembers_a_loss_or_a_leap_of_just_now(x: float) -> None:
    """Otherwise, for up to a second, the localization agent would start at a wrong pose."""
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    correct(robot, (0.0, 0.0, 0.0))
    robot.moved(0.0, 0.0, 0.0)
    if x > LEAP_M:
        correct(robot, (x, 0.0, 0.0))
    else:
        correct(robot, (0.0, 0.0, 0.0), confidence=0.0, covariance=(2.0, 0, 0, 2.0, 0, 1.0))
    before = robot.moved(0.0, 0.0, 0.0)
    robot.restart_encoder()
    after = robot.moved(0.0, 0.0, 0.0)
    assert pose(after) == pytest.approx(pose(before))
    assert after.covariance == pytest.approx(before.covariance)


def test_an_initial_pose_counts_at_once_and_is_remembered() -> None:
    robot = Robot(1.0, 2.0)
    robot.moved(0.5, 0.0, 0.0)
    wrong = Correction(Cycle(1, 2), 1.0, 2.0, 0.0, (0.01, 0, 0, 0.01, 0, 0.01), 1.0)
    correct(robot, (1.0, 2.0, 0.0))
    robot.give(InitialPose(7.0, 3.0, pi / 2))
    pose = robot.moved(0.5, 0.0, 0.0)
    assert (pose.x, pose.y, pose.theta) == pytest.approx((7.0, 3.0, pi / 2))
    assert pose.covariance == pytest.approx(GIVEN), "not that of the pose before"
    robot.give(wrong)  # it was under way already
    pose = robot.moved(0.6, 0.0, 0.0)
    assert (pose.x, pose.y, pose.theta) == pytest.approx((7.0, 3.1, pi / 2))
    assert robot.origin().counter > 1


def test_a_moving_robot_ignores_an_initial_pose() -> None:
    robot = Robot(1.0, 2.0)
    robot.moved(0.5, 0.0, 0.0, v=0.4)
    robot.give(InitialPose(7.0, 3.0, pi / 2))
    pose = robot.moved(0.5, 0.0, 0.0)
    assert (pose.x, pose.y) == pytest.approx((1.0, 2.0))


def test_a_correction_of_a_new_map_revision_counts_at_once() -> None:
    """The pose must lie on the map of its time; within a revision it moves by steps."""
    robot = Robot()
    robot.moved(0.0, 0.0, 0.0)
    moved = []
    for revision, x in ((1, 0.0), (1, 0.2), (2, 0.3), (2, 0.2)):
        cycle = Cycle(robot.epoch, robot.number)
        robot.give(Correction(cycle, x, 0.0, 0.0, SURE, 1.0, revision=revision))
        moved.append(robot.moved(0.0, 0.0, 0.0).x)
    assert moved == pytest.approx([0.0, CREEP_M, 0.3, 0.3 - CREEP_M])
