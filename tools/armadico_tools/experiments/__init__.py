"""The list of experiments, with the module of each.

`docs/results/README.md` lists removed experiments, with their results and the last commit that has
them.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Entry(NamedTuple):
    """An experiment; its module is imported only to run it."""

    title: str
    where: str  # "module:NAME" of an `Experiment` in this package
    on_request: bool = False  # not included in `all`


EXPERIMENTS: Final = {
    "table-5.1": Entry(
        "Table 5.1: three controllers of goto in scenarios 1 to 4", "thesis:TABLE_5_1"
    ),
    "table-5.2": Entry("Table 5.2: abrupt and smooth exchange", "thesis:TABLE_5_2"),
    "table-5.3": Entry("Table 5.3: adding gothrough", "thesis:TABLE_5_3"),
    "table-5.4": Entry("Table 5.4: experiment 1, two offices", "thesis:TABLE_5_4"),
    "table-5.5": Entry("Table 5.5: experiment 2, the whole floor", "thesis:TABLE_5_5"),
    "localization": Entry(
        "Localization: real sensors, odometry alone and with the map", "thesis:LOCALIZATION"
    ),
    "logs": Entry(
        "Logs of real robots: the localization agent beside a plain filter", "logs:LOGS", True
    ),
    "random-rooms": Entry(
        "Random rooms: generated floor plans with furniture", "foreign_worlds:RANDOM_ROOMS"
    ),
    "floors": Entry(
        "Floors: generated floor plans with people, real sensors", "foreign_worlds:FLOORS"
    ),
    "exploration": Entry(
        "Explorations by SLAM: shipped worlds and generated floor plans, real sensors",
        "exploration:EXPLORATION",
        True,
    ),
    "sonar-exploration": Entry(
        "Explorations by sonars at the pose of the odometry, real sensors",
        "exploration:SONAR_EXPLORATION",
        True,
    ),
    "other-maps": Entry(
        "Maps of other formats: goals between free places", "foreign_worlds:OTHER_MAPS"
    ),
    "fleet": Entry("Fleets: tasks shared between robots", "fleet:FLEET"),
    "narrow": Entry("Fleets in narrow worlds", "narrow:NARROW"),
    "surveillance": Entry("A day of surveillance", "surveillance:SURVEILLANCE"),
    "use-cases": Entry("The use cases of thesis 3.2", "use_cases:USE_CASES"),
    "barn": Entry("The BARN challenge: fields of cylinders, no map", "barn:BARN"),
}
"""Experiments by name, in the order of `all`."""

RUNS: Final = 30
FIRST_SEED: Final = 1000
"""Seeds below this one were used to choose parameters; results are reported from it on."""
