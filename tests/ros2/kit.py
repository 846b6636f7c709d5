"""What tests of ROS 2 robots have in common: their profiles."""

from __future__ import annotations

from armadico.bridge.ros2.profile import Ros2Robot
from armadico.config.profile import load_profile


def ros2_profile(name: str) -> Ros2Robot:
    profile = load_profile(name)
    assert isinstance(profile, Ros2Robot)
    return profile


BURGER, JACKAL = ros2_profile("turtlebot3-burger"), ros2_profile("jackal")
SONARS, CREATE3 = ros2_profile("jackal-sonars"), ros2_profile("create3")
