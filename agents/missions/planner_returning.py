"""A planner agent: does what has come up, goes back, and on as it was to (planner 1 of 3.6.1)."""

from __future__ import annotations

from armadico.agents.missions.messages import PlanStep, SubplanRequest
from armadico.agents.missions.planner import Planner, Surprise, leading, move


class PlannerReturning(Planner):
    """Goes back to the room where the robot was, and leaves it by the way that was planned."""

    name = "planner-returning"
    plans = (Surprise.ALARM, Surprise.BATTERY)

    def steps(self, request: SubplanRequest) -> list[PlanStep] | str:
        """{move(R1, R21), check-alarm, move(R21, R1), move(R1, Hall)}."""
        if not request.room:
            return "the robot was in no room that has a name: there is nothing to go back to"
        after = leading(request.ahead)
        return [*request.before, move(request.room), *map(move, after[:-1][:1])]
