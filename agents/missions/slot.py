"""The agents of missions and of explorations, and what their tasks need."""

from armadico.config.slots import Need, Slot

EXPLORING = Slot(
    without=("path-planning",),
    besides=("mapping", "explore"),
    needs={"explore": Need(like=("drive",), agents=("mapping", "explore"), plans=("frontiers",))},
)
"""An unknown world; without slam there is nothing to plan on."""

MISSIONS = Slot(
    besides=(
        *("mission-planning", "planner-returning", "planner-onward"),
        *("battery-sensor", "battery-charger", "dock"),
    ),
    # By the missions' tasks. A task of another package needs what every mission needs, or has its
    # own row.
    needs={
        "mission": Need(like=("move",), agents=("mission-planning",), missions=True),
        "check-alarm": Need(helps=("planner-returning", "planner-onward")),
        # Of missions whose `energy` is this, which is the default.
        "dock": Need(agents=("battery-sensor", "battery-charger", "dock"), energy=("charge",)),
    },
)
"""Missions of several tasks: the planners and the coordinator of 3.6.1."""
