"""The iRobot Create 2 as a kind of robot: the section [create2] of a profile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar

from msgspec import Meta

from armadico.bridge.kind import RobotKind
from armadico.bridge.session import Session
from armadico.config.profile import ModelledRobot, Positive, Section, SonarRing

if TYPE_CHECKING:
    from armadico.bridge.simulator.robots import Stage
    from armadico.bridge.simulator.simulated import SimulatedRobot


class OpenInterface(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The section [create2] of a profile."""

    counts_per_m: Positive  # of a wheel's encoder
    light_at_10_cm: Annotated[float, Meta(ge=10, le=4000)]  # signal of a light bumper


class Create2(ModelledRobot, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A profile with a section [create2]."""

    section: ClassVar[str] = "create2"

    sonar: SonarRing  # its light bumpers
    create2: OpenInterface

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.sonar.sonars) != 6:
            raise ValueError("a Create 2 has 6 light bumpers: [sonar] needs 6 sonars")


def _session(profile: Create2, now: float, near: tuple[float, float]) -> Session:  # noqa: ARG001
    # Imported where it is needed: every agent reads the profile, one drives the robot.
    from armadico_create2.driver import Driver

    return Driver(profile, now)


def _simulated(profile: Create2, stage: Stage) -> SimulatedRobot:
    from armadico.bridge.simulator.streaming import simulated_robot
    from armadico_create2.simulator import Firmware

    return simulated_robot(profile, stage, lambda plant: Firmware(profile, plant))


CREATE2 = RobotKind(Create2, _session, _simulated)
