"""A planner agent of one's own: it has a photo taken of what has set the alarm off."""

from collections.abc import Sequence

import armadico
from armadico import Planner, PlanStep, SubplanRequest


class Evidence(Planner):
    """Does what has come up, takes a photo there, and leaves the rest to the mission."""

    name = "planner-evidence"  # all are asked whose names begin so; the cheapest plan is done

    def steps(self, request: SubplanRequest) -> Sequence[PlanStep] | str:
        if not any(step.do == "check-alarm" for step in request.before):
            return f"there is nothing to be seen: {request.why}"
        return [*request.before, PlanStep.of("take-photo", seconds=2.0)]


if __name__ == "__main__":
    done = armadico.run("surveillance", virtual=True, sensors="ideal", joins=[Evidence])
    for task in done.measures.tasks or ():
        print(f"{task.at_s:5.1f} s  {task.step}: {task.said}")
