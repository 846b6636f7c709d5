"""The contract of the robot in MuJoCo."""

from armadico.contracts import RobotContract


class TestMujoco(RobotContract):
    profile = "mujoco-bot"
