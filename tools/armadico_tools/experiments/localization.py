"""Real sensors, without and with the localization agent (thesis 3.6.3), in every scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import structs

from armadico_tools.experiments import carried
from armadico_tools.experiments.driving import LOCALIZING, Cell, Sample
from armadico_tools.experiments.real_robot import failures
from armadico_tools.experiments.tables import RULES, cell, spread_of
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from armadico_tools.experiments.base import Context

TITLE: Final = "Localization: real sensors, odometry alone and with the map"
SCENARIOS: Final = (
    *("sc1", "sc2", "sc3", "sc4", "rooms-a", "rooms-b", "house", "offices", "floor"),
)
ARMS: Final = {"odometry": (), "localized": LOCALIZING}
"""Who takes part besides the scenario's own."""

NOTE: Final = (
    "Sensors `real` ([worlds](worlds.md)): odometry errors are drawn anew in each run, smooth walls"
    " are mirrors. The pose error is the distance of the published pose from the true one: its"
    " median over a run, and at the run's end. Scenario 1 has no walls, so there is nothing to know"
    " the place by; in 2 and 3 the map does not have the obstacle, in 2 it is all that there is."
    " Seeds 9001 to 9008 chose parameters."
)


def cells() -> list[Cell]:
    return [
        Cell(f"{scenario} {arm}", scenario, besides=besides, sensors="real")
        for scenario in SCENARIOS
        for arm, besides in ARMS.items()
    ]


def run(context: Context) -> None:
    """A row for each scenario and arm, and the runs that failed."""
    samples = context.drive(cells())
    head = ("scenario", "arm", "reached", "touched", "P %", "pose m", "at the end m", "deg", "TT s")
    rows = [
        (scenario, arm, *_row(samples[f"{scenario} {arm}"]))
        for scenario in SCENARIOS
        for arm in ARMS
    ]
    localized = [one for scenario in SCENARIOS for one in samples[f"{scenario} localized"]]
    context.summary = {
        arm: {
            "runs": sum(len(samples[f"{scenario} {arm}"]) for scenario in SCENARIOS),
            "reached": sum(o.reached for s in SCENARIOS for o in samples[f"{s} {arm}"]),
            "touched": sum(bool(o.collisions) for s in SCENARIOS for o in samples[f"{s} {arm}"]),
        }
        for arm in ARMS
    }
    tasks = [
        (arm, name, robot, seed)
        for arm in carried.ARMS
        for robot in carried.ROBOTS
        for name in carried.SCENARIOS
        for seed in context.seeds
    ]
    lifted = context.map(carried.drive, tasks, "carried")
    context.rows(
        "carried",
        carried.Carried.__struct_fields__,
        [structs.astuple(one) for one in lifted],
    )
    context.table(
        f"# {TITLE}\n\n{NOTE}\n\n{RULES}\n\n{table(head, rows)}\n\n{failures(localized)}\n\n"
        f"# Put down elsewhere\n\n{carried.section(lifted)}"
    )


def _row(samples: Sequence[Sample]) -> tuple[str, ...]:
    return (
        f"{sum(one.reached for one in samples)} of {len(samples)}",
        str(sum(bool(one.collisions) for one in samples)),
        *(
            cell(spread_of(samples, field))
            for field in ("p_percent", "pose_m", "pose_end_m", "pose_end_deg", "tt_s")
        ),
    )
