"""The agents of the transcripts: they do what the first line of a file has, and no more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final

from msgspec import Struct

from armadico.core.agent import Agent, Identity, Parameters, Social, Subscription
from armadico.core.coordination import Owner, Verdict
from armadico.core.cycles import PERIOD, CycleCounter
from armadico.core.exchange import Bid
from armadico.core.messages import Command, Description, Message, RobotState, Stop
from armadico.core.resources import WHEELS, Resource
from armadico.mesh.virtual import VirtualMesh

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


class Judge(Agent):
    """An owner whose resource does at once what is asked."""

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.does = {resource.name: resource.neutral for resource in self.owns}
        for resource in self.owns:
            self._overhear(self.owner(resource))

    def _overhear(self, owner: Owner) -> None:
        judge = owner.judge

        def judged(command: Command, now: float, **about: Any) -> Verdict:
            verdict = judge(command, now, **about)
            self.judged(command, verdict)
            return verdict

        vars(owner)["judge"] = judged

    def judged(self, command: Command, verdict: Verdict) -> None:
        """A hook for the verdict on each command."""

    def obey(self, resource: Resource, action: Any) -> None:
        """The action is reached at once."""
        self.does[resource.name] = action

    def rest(self, resource: Resource) -> None:
        """Back to the neutral action at once."""
        self.does[resource.name] = resource.neutral

    def measure(self, resource: Resource) -> Any:
        """The last action that it obeyed."""
        return self.does[resource.name]

    def beyond(self, resource: Resource, action: Any) -> str:
        """Its limits: of the wheels as described, of the lift 2 m."""
        most = (DESCRIPTION.v_max, DESCRIPTION.w_max) if resource == WHEELS else (HIGHEST,)
        fast = any(abs(number) > limit for number, limit in zip(action, most, strict=True))
        return "beyond its limits" if fast else ""


class Driven(Judge):
    """The robot agent: it makes the cycles, as a controller's status packets would."""

    name = "robot"
    owns = (WHEELS,)
    describes: ClassVar[Description | None] = DESCRIPTION
    provides: ClassVar[tuple[type[Message], ...]] = (RobotState, Description)

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.counter = CycleCounter(self.rng.getrandbits(63), PERIOD)

    @classmethod
    def subscriptions(cls) -> tuple[Subscription, ...]:
        return tuple(s for s in super().subscriptions() if s.message not in cls.provides)

    def on_start(self) -> None:
        self.on_wakeup()

    def on_wakeup(self) -> None:
        """One cycle: the state, then the ack."""
        self.wake_at(self.now + PERIOD)
        cycle = self.counter.next(self.now)
        self.cycles.advance(cycle, self.now)
        self.tenure += 1
        v, w = self.does["wheels"]
        stop = self.memory.newest(Stop) or Stop()
        self.publish(RobotState(cycle, 0.0, 0.0, 0.0, v, w, 12.0, True, False, stop))
        self.acknowledge()
        if self.describes is not None and cycle.number % 10 == 1:
            self.publish(self.describes)


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
    base = Planned if not owned else Driven if WHEELS in owned else Judge
    if wanted and WHEELS in wanted:
        attributes["needs"] = (RobotState,)
    kind: type[Agent] = type(part.name.title(), (base,), attributes)
    identity = VirtualMesh(seed).identity(part.name, part.start)
    return kind(identity, Parameters(social=Social(exchange="abrupt")))
