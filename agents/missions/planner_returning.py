"""A planner agent: handles a surprise, then returns to where it was (planner 1 of 3.6.1)."""

from __future__ import annotations

from armadico.agents.missions.messages import PlanStep, SubplanRequest
from armadico.agents.missions.planner import Planner, Surprise, leading, move


class PlannerReturning(Planner):
    """Returns to the room where the robot was, and leaves it by the planned path."""

    name = "planner-returning"
    plans = (Surprise.ALARM, Surprise.BATTERY)

    def steps(self, request: SubplanRequest) -> list[PlanStep] | str:
        """Return the plan of the thesis: {move(R1, R21), check-alarm, move(R21, R1), ...}."""
        if not request.room:
            return "the robot was in no room that has a name: there is nothing to go back to"
        after = leading(request.ahead)
        return [*request.before, move(request.room), *map(move, after[:-1][:1])]
