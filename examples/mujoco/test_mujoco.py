"""The contract of the robot in MuJoCo."""

from armadico.testing.robots import RobotContract


class TestMujoco(RobotContract):
    profile = "mujoco-bot"
