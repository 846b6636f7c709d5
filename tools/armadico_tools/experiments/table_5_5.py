"""Table 5.5, figures 5.16 and 5.17: across the whole floor, with ideal and with real sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from armadico_tools.experiments import real_robot

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Table 5.5: experiment 2, the whole floor"
NOTE: Final = (
    "v at most 0.4 m/s, all agents take part, as table 5.4. The thesis's TT of 152.71 s over 51 m"
    " is 0.33 m/s. P and FO are by the true pose: the interface agent believes the encoders, so a"
    " run may end far from the goal with the robot sure that it is there, as the thesis's real one"
    " did. The real columns are `floor-people`: five people walk, a box is left in the corridor,"
    " and the way is planned."
)


def run(context: Context) -> None:
    real_robot.measure(context, TITLE, "5.5", NOTE, "floor", "floor-people")
