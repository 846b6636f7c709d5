"""The agents of the transcripts: they do what the first line of a file has, and no more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final

from msgspec import Struct

from armadico.core.agent import Agent, Parameters, Social
from armadico.core.cycles import PERIOD
from armadico.core.exchange import Bid
from armadico.core.messages import Description, Message, RobotState
from armadico.core.resources import WHEELS, Resource
from armadico.mesh.virtual import VirtualMesh
from armadico.testing.society import ResourceOwner, RobotOwner

LIFT: Final = Resource("lift", ("height",), (1.0,), (0.0,), period_s=0.2)
"""A second resource, with cycles of its own: m."""

RESOURCES: Final = {resource.name: resource for resource in (WHEELS, LIFT)}

DESCRIPTION: Final = Description(
    robot="transcript",
    cycle_s=PERIOD,
    front=0.2,
    rear=0.2,
    half_width=0.2,
    v_max=1.0,
    w_max=2.0,
    v_accel=0.5,
    v_decel=0.5,
    w_accel=1.0,
    w_decel=1.0,
    silence_s=0.3,
    watchdog_s=2.0,
)

HIGHEST: Final = 2.0
"""The lift obeys up to this, m."""


class Step(Struct, frozen=True, omit_defaults=True):
    """What is bid from a cycle's number on, until the next step: no utility, no bid."""

    from_cycle: int
    utility: float | None
    action: tuple[float, ...] = ()
    critical: bool = False


class Part(Struct, frozen=True, omit_defaults=True):
    """One process of a scene, as the first line of a file has it."""

    name: str
    starts: float  # s
    instance: str = ""
    start: int = 0  # which of the processes of that name it is, from 0
    owns: tuple[str, ...] = ()
    competes_for: tuple[str, ...] = ()
    bids: Mapping[str, tuple[Step, ...]] = {}  # by resource

    @property
    def label(self) -> str:
        """What it is called in the file."""
        return self.name if not self.start else f"{self.name}{self.start + 1}"


class Limited(ResourceOwner):
    """An owner with limits: of the wheels as described, of the lift 2 m."""

    def beyond(self, resource: Resource, action: Any) -> str:
        """Which limit an action is beyond; empty: none."""
        most = (DESCRIPTION.v_max, DESCRIPTION.w_max) if resource == WHEELS else (HIGHEST,)
        fast = any(abs(number) > limit for number, limit in zip(action, most, strict=True))
        return "beyond its limits" if fast else ""


class Driven(Limited, RobotOwner):
    """The robot agent, which describes its robot."""

    describes: ClassVar[Description | None] = DESCRIPTION
    provides: ClassVar[tuple[type[Message], ...]] = (RobotState, Description)


class Planned(Agent):
    """A contender that bids what the file has for a cycle's number."""

    plan: ClassVar[Mapping[str, tuple[Step, ...]]] = {}

    def bid_for(self, resource: Resource, message: Any) -> Bid | None:
        """The last step that has begun."""
        begun = [s for s in self.plan[resource.name] if s.from_cycle <= message.cycle.number]
        if not begun or begun[-1].utility is None:
            return None
        step = begun[-1]
        assert step.utility is not None, "it was looked at"
        return Bid(step.utility, step.action, step.critical)


def agent_of(part: Part, seed: int) -> Agent:
    """The agent of a part. It changes hands abruptly: how to blend is each agent's own choice."""
    owned = tuple(RESOURCES[name] for name in part.owns)
    wanted = tuple(RESOURCES[name] for name in part.competes_for)
    attributes = {"name": part.name, "owns": owned, "competes_for": wanted, "plan": part.bids}
    base = Planned if not owned else Driven if WHEELS in owned else Limited
    if wanted and WHEELS in wanted:
        attributes["needs"] = (RobotState,)
    kind: type[Agent] = type(part.name.title(), (base,), attributes)
    identity = VirtualMesh(seed).identity(part.name, part.start)
    return kind(identity, Parameters(social=Social(exchange="abrupt")))
