"""A kind of robot, which a package brings by an entry point of `armadico.robots`.

The entry point's name is that of a section of robot profiles: `p2os`, `ros2`. It leads to a
`RobotKind`, which says how the section is read, how such a robot is spoken to, and what stands in
for it in simulation. Nothing else of Armadico knows which kinds there are. docs/own-robot.md shows
one that is a package of its own.

A module with a `RobotKind` is imported wherever a profile is read, by every agent. It should import
the session and the simulator within its functions, so that only those who need them load them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from armadico.bridge.session import Session, Unfit
from armadico.bridge.simulator.traps import KIND, Trap
from armadico.config.errors import ConfigError
from armadico.config.profile import RobotProfile, load_kind, load_profile

if TYPE_CHECKING:
    from armadico.bridge.simulator.plant import Streams
    from armadico.bridge.simulator.robots import Stage
    from armadico.bridge.simulator.simulated import SimulatedRobot
    from armadico.config.scenarios import Scenario

P = TypeVar("P", bound=RobotProfile)


def _no_remedy(profile: RobotProfile, unfit: Unfit) -> str:  # noqa: ARG001 - a default for others
    return f"the profile {profile.name} is for another one"


@dataclass(frozen=True)
class RobotKind(Generic[P]):
    """Robots that are spoken to in one way."""

    profile: type[P]
    """The class of their profiles, with the section as a field. What a file has wrong in it is
    reported with file, line and value; a ValueError of `__post_init__` with the file's name."""

    session: Callable[[P, float, tuple[float, float]], Session]
    """A session that begins at a time (s, any clock), for a robot whose odometry was last known to
    be about here (m)."""

    simulated: Callable[[P, Stage], SimulatedRobot]
    """The simulated robot: a plant, and a controller that takes and gives the robot's bytes."""

    schemes: tuple[str, ...] = ("serial", "tcp")
    """What addresses of such robots begin with; `armadico.transports` opens them."""

    unfit: Callable[[P, Unfit], str] = _no_remedy
    """What to tell people of a robot that answers and does not fit the profile: what does."""

    unkind: frozenset[Trap] = KIND
    """What its simulated controller can do to a client that others do, if it is told to."""

    needs: Mapping[str, str] = field(default_factory=dict)
    """Modules that its session and its simulator import and not every installation has, and what
    to install for each."""

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

        Its controller has a name of its own where other simulators may be about. `clock_s` is what
        the robot's clock shows when it begins.
        """
        # A robot agent reads profiles, and needs no simulator.
        from armadico.bridge.simulator.robots import staged

        self.check()
        profile, stage = staged(scenario, streams, name, traps & self.unkind, clock_s)
        return self.simulated(self._own(profile), stage)

    def check(self) -> None:
        """Raise ConfigError, with the remedy, if a module is missing that such a robot needs."""
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


def kind_of(profile: RobotProfile) -> RobotKind[Any]:
    """The kind that a profile is of. Raises UnknownNameError, ImportError."""
    kind: RobotKind[Any] = load_kind(profile.section)
    return kind


def simulated(
    scenario: Scenario,
    streams: Streams,
    name: str = "",
    *,
    traps: frozenset[Trap] = KIND,
    clock_s: float = 0.0,
) -> SimulatedRobot:
    """The simulated robot of a scenario, of whichever kind; see `RobotKind.in_scenario`."""
    kind = kind_of(load_profile(scenario.robot))
    return kind.in_scenario(scenario, streams, name, traps=traps, clock_s=clock_s)
