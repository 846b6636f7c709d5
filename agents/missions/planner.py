"""Planner agents: what each would do before a mission goes on (thesis figure 3.19).

The coordinator, in mission planning, asks all that are alive, called `planner-...` and declare that
they plan for such a surprise, and has the cheapest answer done. They differ in one method, `steps`;
what their steps take they ask of the path planning agent, leg by leg, up to the mission's next
objective, so that all of them are compared over the same stretch. Where the way to that objective
is shut, only their own steps count. All that they have to know of the world is in the request.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from itertools import pairwise
from math import atan2
from typing import ClassVar

from msgspec.structs import replace

from armadico.agents.missions.messages import PlanStep, Subplan, SubplanRequest
from armadico.core.agent import Agent
from armadico.core.messages import Card, Message, line
from armadico.mobile.messages import Plan, PlanRequest, Waypoint


class Surprise(StrEnum):
    """What a mission's steps did not foresee."""

    ALARM = "alarm"  # in a room
    BATTERY = "battery"  # the energy will not do for the way ahead
    BLOCKED = "blocked"  # there is no way to where a step moves: a door is shut
    FAILED = "failed"  # a step has failed otherwise


class Planner(Agent):
    """A planner agent: answers each request with the steps that it would do, and their cost.

    `plans` are the kinds of surprise that it plans for.
    """

    plans: ClassVar[tuple[Surprise, ...]] = (Surprise.ALARM,)
    hears: ClassVar[tuple[type[Message], ...]] = (SubplanRequest,)
    provides: ClassVar[tuple[type[Message], ...]] = (Subplan,)
    asks: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)

    def steps(self, request: SubplanRequest) -> Sequence[PlanStep] | str:
        """What it would do before the mission goes on; a text: why it knows of nothing.

        `request.before` is to be done, `request.ahead` what the mission would do next. If the last
        step moves to where the first of those does, the mission does not move there again. After
        a step that failed, nothing is to be done before, and it is begun anew after these steps.
        """
        raise NotImplementedError("steps(self, request) says what the planner would do")

    def on_subplan_request(self, request: SubplanRequest) -> None:
        """Plan, have the legs planned, and answer."""
        if request.surprise not in self.plans:
            return
        found = self.steps(request)
        if isinstance(found, str):
            self._refuse(request, found)
            return
        known = {place.name: Waypoint(place.x, place.y, 0.0) for place in request.places}
        blocked = request.surprise == Surprise.BLOCKED
        names = visited(found) if blocked else until_objective(found, request.ahead)
        strange = next((name for name in names if name not in known), None)
        if strange is not None:
            self._refuse(request, f"no place {strange!r}")
            return
        _Legs(self, request, found, [request.at, *(known[name] for name in names)]).go_on()

    def card(self) -> Card:
        """With what it plans for."""
        return replace(super().card(), plans=tuple(map(str, self.plans)))

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
