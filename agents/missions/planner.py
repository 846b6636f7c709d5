"""Planner agents: each proposes steps to do before a mission goes on (thesis figure 3.19).

The coordinator, in mission planning, queries all planner agents that are alive, are named
`planner-...` and declare that they plan for the surprise. The cheapest sub-plan is done. Planner
agents differ in one method, `steps`. They query the path planning agent for the cost of each leg up
to the mission's next objective, so that all sub-plans are compared over the same stretch. If the
path to that objective is blocked, only their own steps count. The request has all places needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from math import atan2
from typing import ClassVar

from msgspec.structs import replace

from armadico.agents.missions.messages import PlanStep, Subplan, SubplanRequest
from armadico.core.agent import Agent
from armadico.core.messages import Card, Message, line
from armadico.mobile.messages import Plan, PlanRequest, Waypoint


class Surprise(StrEnum):
    """An event that a mission's steps do not foresee."""

    ALARM = "alarm"  # in a room
    BATTERY = "battery"  # the energy does not suffice for the path ahead
    BLOCKED = "blocked"  # there is no path to where a step moves, as if a door is shut
    FAILED = "failed"  # a step has failed for another reason


class Planner(Agent, hooks=("steps",)):
    """A planner agent: answers each request with its steps and their cost.

    `plans` are the kinds of surprise that it plans for.
    """

    plans: ClassVar[tuple[Surprise, ...]] = (Surprise.ALARM,)
    receives: ClassVar[tuple[type[Message], ...]] = (SubplanRequest,)
    provides: ClassVar[tuple[type[Message], ...]] = (Subplan,)
    queries: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)

    def steps(self, request: SubplanRequest) -> Sequence[PlanStep] | str:
        """Return the steps to do before the mission goes on, or a text why there are none.

        `request.before` must be done; `request.ahead` are the mission's next steps. If the last
        step moves to where the first of those does, that one is left out. After a failed step,
        `before` is empty, and the failed step begins anew after these steps.
        """
        raise NotImplementedError("steps(self, request) must return the planner's steps")

    def on_subplan_request(self, request: SubplanRequest) -> None:
        """Compute the steps, query the cost of their legs, and publish the sub-plan."""
        if request.surprise not in self.plans:
            return
        found = self.steps(request)
        if isinstance(found, str):
            self._refuse(request.id, found)
            return
        known = {place.name: Waypoint(place.x, place.y, 0.0) for place in request.places}
        blocked = request.surprise == Surprise.BLOCKED
        names = visited(found) if blocked else until_objective(found, request.ahead)
        strange = next((name for name in names if name not in known), None)
        if strange is not None:
            self._refuse(request.id, f"no place {strange!r}")
            return
        stops = [request.at, *(known[name] for name in names)]
        self._add_costs(Subplan(request.id, self.instance, tuple(found)), stops)

    def fill_card(self, card: Card) -> Card:
        """Add the surprises that it plans for."""
        return replace(card, plans=tuple(map(str, self.plans)))

    def _add_costs(self, subplan: Subplan, stops: list[Waypoint]) -> None:
        """Query the cost of each leg between the stops; publish the sub-plan after the last."""
        if len(stops) == 1:
            self.publish(subplan)
            return
        start, goal, *_ = stops

        def planned(plan: Plan | None) -> None:
            if plan is None or plan.refusal:
                why = "no path planning agent answered" if plan is None else plan.refusal
                self._refuse(subplan.id, why)
                return
            length, energy = subplan.length + plan.length, subplan.energy + plan.energy
            self._add_costs(replace(subplan, length=length, energy=energy), stops[1:])

        heading = atan2(goal.y - start.y, goal.x - start.x)
        self.query(PlanRequest(start, Waypoint(goal.x, goal.y, heading), "a sub-plan"), planned)

    def _refuse(self, request: int, why: str) -> None:
        self.publish(Subplan(request, self.instance, (), refusal=line(why)))


def move(to: str) -> PlanStep:
    return PlanStep.of("move", to=to)


def leading(steps: Sequence[PlanStep]) -> list[str]:
    """Return the places of the first moves: the last is the objective's."""
    places: list[str] = []
    for step in steps:
        if not isinstance(step.place, str):
            break
        places.append(step.place)
    return places


def visited(steps: Sequence[PlanStep]) -> list[str]:
    """Return all places that are moved to, in order."""
    return [place for step in steps if isinstance(place := step.place, str)]


def until_objective(steps: Sequence[PlanStep], ahead: Sequence[PlanStep]) -> list[str]:
    """Return the places of a sub-plan, and of the mission from there to its next objective."""
    there, after = visited(steps), leading(ahead)
    if there and there[-1] in after[:1]:
        after = after[1:]
    return there + after
