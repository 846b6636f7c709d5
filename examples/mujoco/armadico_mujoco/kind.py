"""A robot in MuJoCo as a kind of robot: the section [mujoco] of a profile."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from armadico.bridge.kind import RobotKind
from armadico.bridge.session import Session
from armadico.config.profile import Laser, ModelledRobot, NonNegative, Positive, Section

if TYPE_CHECKING:
    from armadico.bridge.simulator.robots import Stage
    from armadico.bridge.simulator.simulated import SimulatedRobot


class Physics(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The section [mujoco] of a profile."""

    counts_per_m: Positive  # of a wheel's encoder
    torque_nm: Positive  # most of each motor
    damping_nms: Positive  # Nm per rad/s by which a wheel misses its speed: the motors' controller
    friction: Positive  # of the tyres on the floor
    wall_friction: NonNegative  # of the hull on walls
    laser_z_m: Positive


class MujocoRobot(ModelledRobot, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A profile with a section [mujoco]; [drive] gives its use of energy only."""

    section: ClassVar[str] = "mujoco"

    laser: Laser
    mujoco: Physics


def _session(profile: MujocoRobot, now: float, near: tuple[float, float]) -> Session:  # noqa: ARG001
    from armadico_mujoco.driver import Driver

    return Driver(profile, now)


def _simulated(profile: MujocoRobot, stage: Stage) -> SimulatedRobot:
    from armadico.bridge.simulator.streaming import simulated_robot
    from armadico_mujoco.physics import MujocoPlant
    from armadico_mujoco.simulator import Firmware

    return simulated_robot(profile, stage, lambda plant: Firmware(profile, plant), MujocoPlant)


MUJOCO = RobotKind(MujocoRobot, _session, _simulated, needs={"mujoco": "mujoco"})
