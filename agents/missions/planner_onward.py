"""A planner agent: handles a surprise, then goes on to the next objective (planner 2 of 3.6.1)."""

from __future__ import annotations

from armadico.agents.missions.messages import PlanStep, SubplanRequest
from armadico.agents.missions.planner import Planner, Surprise, leading, move


class PlannerOnward(Planner):
    """Goes on directly to the mission's next objective."""

    name = "planner-onward"
    plans = (Surprise.ALARM, Surprise.BATTERY)

    def steps(self, request: SubplanRequest) -> list[PlanStep] | str:
        """Return the plan of the thesis: {move(R1, R21), check-alarm, move(R21, Hall)}."""
        return [*request.before, *map(move, leading(request.ahead)[:-1][:1])]
