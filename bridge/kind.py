"""A kind of robot, which a package registers as an entry point of `armadico.robots`.

The entry point's name is that of a section of robot profiles: `p2os`, `ros2`. It refers to a
`RobotKind`, with the profile section, the protocol session and the simulator of such robots. No
other part of Armadico depends on the kinds there are. docs/own-robot.md shows a kind in a package
of its own.

A module with a `RobotKind` is imported by every agent that reads a profile. It should import its
session and simulator within its functions, so that only processes that need them load them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from armadico.bridge.session import Session, Unfit
from armadico.bridge.simulator.traps import KIND, Trap
from armadico.config.profile import RobotProfile, load_kind, load_profile
from armadico.core.config_errors import ConfigError

if TYPE_CHECKING:
    from armadico.bridge.simulator.plant import Streams
    from armadico.bridge.simulator.robots import Stage
    from armadico.bridge.simulator.server import Line
    from armadico.bridge.simulator.simulated import SimulatedRobot
    from armadico.config.scenarios import Scenario

P = TypeVar("P", bound=RobotProfile)
P_contra = TypeVar("P_contra", bound=RobotProfile, contravariant=True)


class Network(Protocol[P_contra]):
    """A network of robots of a kind, such as that of ROS 2's nodes."""

    def node(self, address: str, robot: str, namespace: str | None) -> str:
        """The name of a new robot of this profile; `namespace` is that of a further robot.

        Raises ValueError for an address that cannot be used.
        """

    def beside(self, address: str, namespace: str) -> str:
        """The address of another robot in the same network."""

    def line(self, address: str, profile: P_contra, name: str, stack: ExitStack) -> Line:
        """The line of the robot with this name, closed by `stack`. Raises ValueError or OSError."""


def _no_remedy(profile: RobotProfile, unfit: Unfit) -> str:  # noqa: ARG001 - a default for others
    return f"the profile {profile.name} is for another one"


@dataclass(frozen=True)
class RobotKind(Generic[P]):
    """A kind of robot: profile section, protocol session, and simulator."""

    profile: type[P]
    """The class of its profiles, with the section as a field. Errors in it are reported with file,
    line and value; a ValueError of `__post_init__` with the file's name."""

    session: Callable[[P, float, tuple[float, float]], Session]
    """Makes a session that begins at a time (s, any clock), for a robot whose odometry was last
    known to be near a position (m)."""

    simulated: Callable[[P, Stage], SimulatedRobot]
    """Makes the simulated robot: a plant, and a controller that exchanges the robot's bytes."""

    schemes: tuple[str, ...] = ("serial", "tcp")
    """Schemes of the addresses of such robots; `armadico.transports` opens them."""

    unfit: Callable[[P, Unfit], str] = _no_remedy
    """The remedy for a robot that answers and does not match the profile: the one that does."""

    unkind: frozenset[Trap] = KIND
    """Traps that its simulated controller supports: behaviour that breaks some clients."""

    network: Callable[[], Network[P]] | None = None
    """Loads the network in which other programs may drive a simulated robot, besides TCP."""

    needs: Mapping[str, str] = field(default_factory=dict)
    """Modules that its session and its simulator import and some installations lack, and what to
    install for each."""

    def in_scenario(
        self,
        scenario: Scenario,
        streams: Streams,
        name: str = "",
        *,
        traps: frozenset[Trap] = KIND,
        clock_s: float = 0.0,
    ) -> SimulatedRobot:
        """The robot that a scenario names, where the scenario puts it.

        Its controller has a name of its own where other simulators may be about; it is the id in
        the published truth, too. `clock_s` is what the robot's clock shows when it begins.
        """
        # A robot agent reads profiles, and needs no simulator.
        from armadico.bridge.simulator.robots import staged

        self.check()
        profile, stage = staged(scenario, streams, name, traps & self.unkind, clock_s)
        robot = self.simulated(self._own(profile), stage)
        robot.simulator = name or robot.simulator  # whatever name its driver gave it
        return robot

    def check(self) -> None:
        """Raise ConfigError, with the remedy, if a required module is missing."""
        for module, package in self.needs.items():
            if find_spec(module) is None:
                raise ConfigError(
                    f"a robot with a table [{self.profile.section}] in its profile needs the module"
                    f" {module}, which is not installed: pip install '{package}'"
                )

    def _own(self, profile: RobotProfile) -> P:
        if not isinstance(profile, self.profile):
            raise TypeError(f"{profile.name} is of another kind than {self.profile.section}")
        return profile


def kind_of(profile: P) -> RobotKind[P]:
    """The kind of a profile. Raises UnknownNameError, ImportError."""
    kind: RobotKind[P] = load_kind(profile.section)
    return kind


def simulated(
    scenario: Scenario,
    streams: Streams,
    name: str = "",
    *,
    traps: frozenset[Trap] = KIND,
    clock_s: float = 0.0,
) -> SimulatedRobot:
    """The simulated robot of a scenario, of any kind; see `RobotKind.in_scenario`."""
    kind = kind_of(load_profile(scenario.robot))
    return kind.in_scenario(scenario, streams, name, traps=traps, clock_s=clock_s)
