"""What tasks and planner agents of one's own are made of; only these names are stable.

from armadico.agents.missions.api import Done, Drive, Going, Reach, Task
"""

from armadico.agents.missions.messages import PlanStep, SubplanRequest
from armadico.agents.missions.planner import Planner, Surprise
from armadico.agents.missions.task import (
    Beliefs,
    Charge,
    Done,
    Drive,
    Explore,
    Failed,
    Going,
    Progress,
    Reach,
    Stand,
    Task,
)

__all__ = [
    "Beliefs",
    "Charge",
    "Done",
    "Drive",
    "Explore",
    "Failed",
    "Going",
    "PlanStep",
    "Planner",
    "Progress",
    "Reach",
    "Stand",
    "SubplanRequest",
    "Surprise",
    "Task",
]
