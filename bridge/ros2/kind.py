"""Robots that speak ROS 2: the section [ros2] of a profile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from armadico.bridge.kind import Network, RobotKind
from armadico.bridge.ros2.addresses import SCHEMES
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.bridge.session import Session

if TYPE_CHECKING:
    from armadico.bridge.simulator.robots import Stage
    from armadico.bridge.simulator.simulated import SimulatedRobot


def _session(profile: Ros2Robot, now: float, near: tuple[float, float]) -> Session:  # noqa: ARG001
    from armadico.bridge.ros2 import session

    return session.Session(profile, now)


def _simulated(profile: Ros2Robot, stage: Stage) -> SimulatedRobot:
    from armadico.bridge.ros2.simulated import Ros2SimulatedRobot

    return Ros2SimulatedRobot(profile, stage)


def _network() -> Network[Ros2Robot]:
    from armadico.bridge.ros2 import network

    return network


ROS2: Final = RobotKind(
    Ros2Robot,
    _session,
    _simulated,
    schemes=(*SCHEMES, "serial", "tcp"),  # over the latter two it is one of ours that is simulated
    network=_network,
    needs={"pycdr2": "armadico[ros2]"},
)
