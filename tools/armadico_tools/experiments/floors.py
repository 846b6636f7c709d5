"""Random floor plans as an owner has them: real sensors, localized, people walking about."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico_tools.experiments.floor_plans import floor_plan, people, save
from armadico_tools.experiments.random_rooms import measure
from armadico_tools.experiments.real_robot import LOCALIZED

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Floors: generated floor plans with people, real sensors"
RUNS: Final = 200
PEOPLE: Final = 3

NOTE: Final = (
    "The floor plans of `random-rooms`; sensors `real`, the agents localization and relocate take"
    " part, default parameters. Three people walk about, straight to one place in sight after"
    " another, with 0.5 to 1.2 m/s; two of them heed the robot, the third walks into it."
    " They are not on the map. The seed is the plan's, the people's and the run's: plans, starts,"
    " goals, sensors and people are all samples. *Touched*: by the robot's own motion; who walks"
    " into it does not count. Aim: 99 % reached, nothing touched."
)


def make(task: tuple[Path, int]) -> Path:
    """Write the plan of a seed, and who walks there; the scenario's file."""
    folder, seed = task
    plan = floor_plan(seed)
    return save(plan, folder, people(plan, seed, PEOPLE))


def run(context: Context) -> None:
    """Drive them all; a table of what failed, and a picture of each failure."""
    measure(context, make, LOCALIZED, f"# {TITLE}\n\n{NOTE}")
