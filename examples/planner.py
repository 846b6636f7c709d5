"""Two planner agents: one takes a photo of the cause of an alarm, one waits at closed doors."""

from collections.abc import Sequence

import armadico
from armadico.agents.missions.api import Planner, PlanStep, SubplanRequest, Surprise


class Evidence(Planner):
    """Checks the alarm, takes a photo there, and leaves the rest to the mission."""

    name = "planner-evidence"  # all agents "planner-..." are queried; the cheapest plan is done

    def steps(self, request: SubplanRequest) -> Sequence[PlanStep] | str:
        if not any(step.do == "check-alarm" for step in request.before):
            return f"no alarm to check: {request.why}"
        return [*request.before, PlanStep.of("take-photo", seconds=2.0)]


class Patience(Planner):
    """Waits at a closed door; then the step begins again."""

    name = "planner-patience"
    plans = (Surprise.BLOCKED,)

    def steps(self, request: SubplanRequest) -> Sequence[PlanStep]:
        return [*request.before, PlanStep.of("wait", seconds=40.0)]


if __name__ == "__main__":
    done = armadico.run("surveillance", virtual=True, sensors="ideal", joins=[Evidence, Patience])
    for task in done.measures.tasks or ():
        print(f"{task.at_s:5.1f} s  {task.step}: {task.note}")
