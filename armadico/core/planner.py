"""Planner agents: what each would do before a mission goes on (thesis figure 3.19).

The coordinator, in mission planning, asks all that are alive and called `planner-...`, and has the
cheapest answer done. They differ in one method, `steps`; what their steps take they ask of the path
planning agent, leg by leg, up to the mission's next objective, so that all of them are compared
over the same stretch. All that they have to know of the world is in the request.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import atan2
from typing import ClassVar

from armadico.core.agent import Agent
from armadico.core.messages import (
    Message,
    Plan,
    PlanRequest,
    PlanStep,
    Subplan,
    SubplanRequest,
    Waypoint,
    line,
)


class Planner(Agent):
    """A planner agent: answers each request with the steps that it would do, and their cost."""

    hears: ClassVar[tuple[type[Message], ...]] = (SubplanRequest,)
    provides: ClassVar[tuple[type[Message], ...]] = (Subplan,)
    asks: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)

    def steps(self, request: SubplanRequest) -> Sequence[PlanStep] | str:
        """What it would do before the mission goes on; a text: why it knows of nothing.

        `request.before` is to be done, `request.ahead` what the mission would do next. If the last
        step moves to where the first of those does, the mission does not move there again.
        """
        raise NotImplementedError("steps(self, request) says what the planner would do")

    def on_subplan_request(self, request: SubplanRequest) -> None:
        """Plan, have the legs planned, and answer."""
        found = self.steps(request)
        if isinstance(found, str):
            self._refuse(request, found)
            return
        known = {place.name: Waypoint(place.x, place.y, 0.0) for place in request.places}
        names = until_objective(found, request.ahead)
        strange = next((name for name in names if name not in known), None)
        if strange is not None:
            self._refuse(request, f"no place {strange!r}")
            return
        _Legs(self, request, found, [request.at, *(known[name] for name in names)]).go_on()

    def _refuse(self, request: SubplanRequest, why: str) -> None:
        self.publish(Subplan(request.id, self.instance, (), refusal=line(why)))


def place_of(step: PlanStep) -> str | None:
    """Where a step moves to; None: it does something else."""
    told = {each.name: each.value for each in step.told}
    to = told.get("to") if step.do == "move" else None
    return to if isinstance(to, str) else None


def move(to: str) -> PlanStep:
    """A step that moves to a place."""
    return PlanStep.of("move", to=to)


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


class _Legs:
    """What a sub-plan takes, asked for leg by leg."""

    def __init__(
        self,
        planner: Planner,
        request: SubplanRequest,
        steps: Sequence[PlanStep],
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
