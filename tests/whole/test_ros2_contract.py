"""The contract of robots, for one that speaks ROS 2."""

from __future__ import annotations

from armadico.contracts.robots import RobotContract


class TestTurtleBot4(RobotContract):
    profile = "turtlebot4"
