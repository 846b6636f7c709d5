"""The contract of the robot in MuJoCo."""

from armadico.testing import RobotContract


class TestMujoco(RobotContract):
    profile = "mujoco-bot"
