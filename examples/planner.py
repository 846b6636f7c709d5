"""Two planner agents: one has a photo taken of what set the alarm off, one waits at shut doors."""

from collections.abc import Sequence

import armadico
from armadico import Planner, PlanStep, SubplanRequest, Surprise


class Evidence(Planner):
    """Does what has come up, takes a photo there, and leaves the rest to the mission."""

    name = "planner-evidence"  # all are asked whose names begin so; the cheapest plan is done

    def steps(self, request: SubplanRequest) -> Sequence[PlanStep] | str:
        if not any(step.do == "check-alarm" for step in request.before):
            return f"there is nothing to be seen: {request.why}"
        return [*request.before, PlanStep.of("take-photo", seconds=2.0)]


class Patience(Planner):
    """Waits before a door that is shut, and has the step begun anew then."""

    name = "planner-patience"
    plans = (Surprise.BLOCKED,)

    def steps(self, request: SubplanRequest) -> Sequence[PlanStep]:
        return [*request.before, PlanStep.of("wait", seconds=40.0)]


if __name__ == "__main__":
    done = armadico.run("surveillance", virtual=True, sensors="ideal", joins=[Evidence, Patience])
    for task in done.measures.tasks or ():
        print(f"{task.at_s:5.1f} s  {task.step}: {task.said}")
