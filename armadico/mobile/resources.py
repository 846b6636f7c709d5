"""The resources of a mobile robot besides its wheels."""

from __future__ import annotations

import armadico.mobile.merging
import armadico.mobile.obstacles  # noqa: F401 - their row
from armadico.core.resources import Resource, declare
from armadico.mobile.messages import PlanTask, Way

TRAJECTORY = declare(
    Resource(
        name="trajectory",
        message=Way,
        exchange="merging",
        period_s=0.5,
        silence_s=30.0,  # the path of a holder that restarts within this time is still driven
        stops=False,
    )
)
"""The robot's path. The interface agent has the holder's path driven."""

PLANNER = declare(
    Resource(name="planner", message=PlanTask, exchange="abrupt", period_s=0.2, stops=False)
)
"""The path planning agent, which plans for the holder."""
