"""Table 5.4, figures 5.13 and 5.14: two offices, with ideal and with real sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from armadico_tools.experiments import real_robot

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Table 5.4: experiment 1, two offices"
NOTE: Final = (
    "v at most 0.4 m/s, all agents take part. The thesis drove each column once, on a real Pioneer"
    " for *real*; ours is a simulation with the sensors `real` ([worlds](worlds.md#sensors)), and"
    " *localized* has the agent of 3.6.3 as well. There is less furniture than in the text."
)


def run(context: Context) -> None:
    real_robot.measure(context, TITLE, "5.4", NOTE, "offices", "offices")
