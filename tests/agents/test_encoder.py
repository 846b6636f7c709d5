"""The encoder agent's pose: in the world, and continuous whoever restarts."""

from __future__ import annotations

from math import pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.agent import Identity, Publish
from armadico.agents.encoder import Encoder, Parameters
from armadico.messages import Cycle, Pose, RobotState

metres, angles = st.floats(-20, 20), st.floats(-3.1, 3.1)
places = st.tuples(metres, metres, angles)


class Robot:
    """Says where its odometry has got to, cycle by cycle."""

    def __init__(self, x: float = 0.0, y: float = 0.0, theta: float = 0.0) -> None:
        self.encoder = Encoder(Identity("encoder-1"), Parameters(x=x, y=y, theta=theta))
        self.epoch = 1
        self.number = 0

    def at(self, x: float, y: float, theta: float) -> Pose:
        self.number += 1
        cycle = Cycle(self.epoch, self.number)
        self.encoder.receive(
            RobotState(cycle, x, y, theta, 0, 0, 12, True, False), self.number / 10
        )
        (said,) = self.encoder.outbox
        self.encoder.outbox.clear()
        assert isinstance(said, Publish)
        assert isinstance(said.message, Pose)
        assert said.message.cycle == cycle
        return said.message

    def restart(self) -> None:
        self.epoch += 1
        self.number = 0


def pose(p: Pose) -> tuple[float, float, float]:
    return p.x, p.y, p.theta


def test_odometry_is_put_where_the_robot_stood() -> None:
    robot = Robot(x=3.4, y=0.6, theta=pi / 2)
    assert pose(robot.at(0, 0, 0)) == pytest.approx((3.4, 0.6, pi / 2))
    assert pose(robot.at(2.0, 0.5, -0.3)) == pytest.approx((2.9, 2.6, pi / 2 - 0.3))


def test_one_status_packet_one_pose_of_its_cycle() -> None:
    robot = Robot()
    assert [robot.at(0, 0, 0).cycle.number for _ in range(3)] == [1, 2, 3]
    robot.encoder.receive(RobotState(Cycle(1, 3), 9, 9, 0, 0, 0, 12, True, False), 0.3)
    assert robot.encoder.outbox == []


def test_headings_stay_in_one_turn() -> None:
    robot = Robot(theta=3.0)
    assert -pi < robot.at(0, 0, 3.0).theta <= pi


@given(places, places, places)
def test_a_restart_of_the_robot_agent_does_not_move_the_robot(
    before: tuple[float, float, float],
    begins: tuple[float, float, float],
    goes: tuple[float, float, float],
) -> None:
    robot = Robot(x=1.0, y=-2.0, theta=0.5)
    stood = robot.at(*before)
    robot.restart()
    assert pose(robot.at(*begins)) == pytest.approx(pose(stood), abs=1e-9)
    moved = robot.at(*goes)
    way = (moved.x - stood.x) ** 2 + (moved.y - stood.y) ** 2
    assert way == pytest.approx((goes[0] - begins[0]) ** 2 + (goes[1] - begins[1]) ** 2, abs=1e-6)


def test_restarts_add_up() -> None:
    robot = Robot()
    for _ in range(3):
        robot.at(0, 0, 0)
        stood = robot.at(1.0, 0.0, pi / 2)
        robot.restart()
    assert pose(stood) == pytest.approx((0.0, 1.0, -pi / 2))


def test_an_encoder_agent_that_restarts_takes_the_odometry_as_it_is() -> None:
    assert pose(Robot(x=1.0).at(2.0, 0.0, 0.0)) == pytest.approx((3.0, 0.0, 0.0))
