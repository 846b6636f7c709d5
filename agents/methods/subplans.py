"""Sub-plans: what planner agents would do before a mission goes on, and the choice among them.

The holonic society of thesis figure 3.19. Planner agents differ in one method, `steps`; what their
plan takes they ask of the path planning agent, leg by leg, up to the mission's next objective, so
that all of them are compared over the same stretch. Whoever has a better idea joins as an agent of
its own: all that are alive and called `planner-...` are asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import atan2
from typing import Any, ClassVar, Final

from armadico.config.errors import ConfigError
from armadico.config.places import Places
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import Agent
from armadico.core.messages import (
    Message,
    Plan,
    PlanRequest,
    PlanStep,
    Subplan,
    SubplanRequest,
    Told,
    Waypoint,
    line,
)

PLANNERS: Final = "planner-"
"""What a planner agent's name begins with."""

ANSWER_S: Final = 5.0
"""What the planners may take, together; who has not answered by then is not waited for."""


def place_of(step: PlanStep) -> str | None:
    """Where a step moves to; None: it does something else."""
    told = {each.name: each.value for each in step.told}
    to = told.get("to") if step.do == "move" else None
    return to if isinstance(to, str) else None


def move(to: str) -> PlanStep:
    """A step that moves to a place."""
    return PlanStep("move", (Told.of("to", to),))


def leading(steps: Sequence[PlanStep]) -> list[str]:
    """The places that are moved to before anything else is done: the last is the objective's."""
    places: list[str] = []
    for step in steps:
        place = place_of(step)
        if place is None:
            break
        places.append(place)
    return places


def visited(steps: Sequence[PlanStep]) -> list[str]:
    """All places that are moved to, in order."""
    return [place for step in steps if (place := place_of(step)) is not None]


def until_objective(steps: Sequence[PlanStep], ahead: Sequence[PlanStep]) -> list[str]:
    """The places of a sub-plan, and of the mission from there up to its next objective."""
    there, after = visited(steps), leading(ahead)
    if there and there[-1] in after[:1]:
        after = after[1:]
    return there + after


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The world whose places it plans with, and the robot that has to stand there."""

    world: str = "empty"
    profile: str = "pioneer-2dx"


class Planner(Agent):
    """A planner agent: answers each request with the steps that it would do, and their cost."""

    hears: ClassVar[tuple[type[Message], ...]] = (SubplanRequest,)
    provides: ClassVar[tuple[type[Message], ...]] = (Subplan,)
    asks: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    parameters = Parameters
    launched_with = ("world", "profile")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._places = Places(load_world(self.p.world), load_profile(self.p.profile).body)

    def steps(self, request: SubplanRequest) -> list[PlanStep] | str:
        """What it would do before the mission goes on; a text: why it knows of nothing."""
        raise NotImplementedError("steps(self, request) says what the planner would do")

    def on_subplan_request(self, request: SubplanRequest) -> None:
        """Plan, have the legs planned, and answer."""
        found = self.steps(request)
        if isinstance(found, str):
            self._refuse(request, found)
            return
        try:
            stops = [standing(self._places, name) for name in until_objective(found, request.ahead)]
        except ConfigError as error:
            self._refuse(request, error.message)
            return
        _Legs(self, request, found, [request.at, *stops]).go_on()

    def _refuse(self, request: SubplanRequest, why: str) -> None:
        self.publish(Subplan(request.id, self.instance, (), refusal=line(why)))


def standing(places: Places, name: str) -> Waypoint:
    """Where the robot stands at a place, heading anywhere unless that is said."""
    x, y, theta = places.of(name)
    return Waypoint(x, y, theta or 0.0)


class _Legs:
    """What a sub-plan takes, asked for leg by leg."""

    def __init__(
        self,
        planner: Planner,
        request: SubplanRequest,
        steps: list[PlanStep],
        stops: list[Waypoint],
    ) -> None:
        self._planner, self._request, self._steps = planner, request, tuple(steps)
        self._legs = list(pairwise(stops))
        self._length = self._energy = 0.0

    def go_on(self) -> None:
        """Ask for the next leg; answer after the last."""
        if not self._legs:
            plan = (self._length, self._energy)
            who = (self._request.id, self._planner.instance, self._steps)
            self._planner.publish(Subplan(*who, *plan))
            return
        start, goal = self._legs.pop(0)
        heading = atan2(goal.y - start.y, goal.x - start.x)
        self._planner.ask(
            PlanRequest(start, Waypoint(goal.x, goal.y, heading), "a sub-plan"), self._planned
        )

    def _planned(self, plan: Plan | None) -> None:
        if plan is None or plan.refusal:
            why = "nobody plans" if plan is None else plan.refusal
            self._planner.publish(
                Subplan(self._request.id, self._planner.instance, (), refusal=line(why))
            )
            return
        self._length += plan.length
        self._energy += plan.energy
        self.go_on()


@dataclass
class Enquiry:
    """One request to the planner agents, and what they have answered."""

    request: SubplanRequest
    asked: frozenset[str]  # the planners that were alive
    until: float  # s
    chosen: Callable[[Subplan | None], None]
    answers: dict[str, Subplan] = field(default_factory=dict)


class Coordinator:
    """Asks all planner agents that are alive, and chooses the cheapest sub-plan."""

    def __init__(self) -> None:
        self.planners: set[str] = set()  # instances that are alive
        self._enquiry: Enquiry | None = None

    @property
    def busy(self) -> bool:
        """Whether answers are waited for."""
        return self._enquiry is not None

    def ask(
        self, request: SubplanRequest, now: float, chosen: Callable[[Subplan | None], None]
    ) -> None:
        """Ask; `chosen` is told the cheapest answer in time, or None if there is none."""
        self._enquiry = Enquiry(request, frozenset(self.planners), now + ANSWER_S, chosen)

    def appeared(self, name: str, instance: str) -> None:
        """An agent has joined."""
        if name.startswith(PLANNERS):
            self.planners.add(instance)

    def gone(self, instance: str, now: float) -> None:
        """An agent is gone: it is not waited for any more."""
        self.planners.discard(instance)
        self.look(now)

    def take(self, subplan: Subplan, now: float) -> None:
        """An answer."""
        enquiry = self._enquiry
        if enquiry is not None and subplan.id == enquiry.request.id:
            enquiry.answers[subplan.planner] = subplan
            self.look(now)

    def drop(self) -> None:
        """Nobody needs the answers any more."""
        self._enquiry = None

    def look(self, now: float) -> None:
        """Choose, once all have answered that are alive, or the time is over."""
        enquiry = self._enquiry
        if enquiry is None:
            return
        waited_for = (enquiry.asked & self.planners) - enquiry.answers.keys()
        if waited_for and now < enquiry.until:
            return
        self._enquiry = None
        plans = [plan for plan in enquiry.answers.values() if not plan.refusal]
        enquiry.chosen(min(plans, key=lambda p: (p.energy, p.length, p.planner), default=None))

    @property
    def answers(self) -> dict[str, Subplan]:
        """What has been answered so far."""
        return {} if self._enquiry is None else dict(self._enquiry.answers)
