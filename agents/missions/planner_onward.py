"""A planner agent: does what has come up and leaves for the next objective (planner 2 of 3.6.1)."""

from __future__ import annotations

from armadico.agents.missions.messages import PlanStep, SubplanRequest
from armadico.agents.missions.planner import Planner, Surprise, leading, move


class PlannerOnward(Planner):
    """Leaves by the way to what the mission is about next, and goes back nowhere."""

    name = "planner-onward"
    plans = (Surprise.ALARM, Surprise.BATTERY)

    def steps(self, request: SubplanRequest) -> list[PlanStep] | str:
        """{move(R1, R21), check-alarm, move(R21, Hall)}."""
        return [*request.before, *map(move, leading(request.ahead)[:-1][:1])]
