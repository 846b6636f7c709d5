"""Scenarios 1 to 4 as real processes and on the virtual mesh: is it the same society?"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import msgspec

from armadico.measures import Result
from armadico.tools.experiments.driving import Cell, Sample
from armadico.tools.experiments.statistics import unpaired
from armadico.tools.experiments.tables import RULES, cell, p_of, row, spread_of

if TYPE_CHECKING:
    from armadico.tools.experiments.base import Context

TITLE: Final = "Live against virtual: scenarios 1 to 4"
RUNS: Final = 5
SCENARIOS: Final = ("sc1", "sc2", "sc3", "sc4")
MEASURED: Final = {
    "tt_s": "TT s",
    "td_m": "TD m",
    "exchanges": "exchanges",
    "min_clearance_m": "least clearance m",
}
LIMIT_S: Final = 300.0
NOTE: Final = (
    "The same agents and P2OS bytes: live, each agent, the robot agent and the simulator are"
    " processes of their own on one machine, over Zenoh and TCP in real time; virtual, one process"
    " under a virtual clock. The seed is the sensors' noise in both. p: Mann and Whitney,"
    " two-sided; with 5 against 5 it cannot fall below 0.008, so only large differences show."
)


def run(context: Context) -> None:
    """Virtual runs as ever; live ones one after the other, so that they have the machine."""
    cells = [Cell(scenario, scenario) for scenario in SCENARIOS]
    virtual = context.drive(cells)
    tasks = [(scenario, seed) for scenario in SCENARIOS for seed in context.seeds]
    jobs, context.jobs = context.jobs, 1
    results = context.map(live, tasks, "live runs")
    context.jobs = jobs
    fields = Result.__struct_fields__
    context.rows("live", fields, ([getattr(one, field) for field in fields] for one in results))
    lines = [row(["scenario", "measure", "live", "virtual", "p"]), row(["---"] * 5)]
    for scenario in SCENARIOS:
        mine = [one for one in results if one.scenario == scenario]
        lines += _compare(scenario, mine, virtual[scenario])
    context.table(f"# {TITLE}\n\n{NOTE}\n\n{RULES}\n\n" + "\n".join(lines) + "\n")


def live(task: tuple[str, int]) -> Result:
    """One run as `armadico run` makes it. Raises RuntimeError if it could not be made."""
    scenario, seed = task
    namespace = f"experiment-{os.getpid()}-{scenario}-{seed}"
    done = subprocess.run(
        [
            *(sys.executable, "-m", "armadico", "run", scenario, "--seed", str(seed)),
            *("--json", "--no-plot", "--namespace", namespace),
        ],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    try:
        return msgspec.convert(json.loads(done.stdout), Result)
    except ValueError:
        raise RuntimeError(f"{scenario} seed {seed}: {done.stderr.strip()[-500:]}") from None


def _compare(scenario: str, live_runs: list[Result], virtual: list[Sample]) -> list[str]:
    both: dict[str, Sequence[Result | Sample]] = {"live": live_runs, "virtual": virtual}
    reached = [f"{sum(one.reached for one in runs)} of {len(runs)}" for runs in both.values()]
    lines = [row([scenario, "reached", *reached, "-"])]
    for field, title in MEASURED.items():
        values = [
            [float(value) for one in runs if (value := getattr(one, field)) is not None]
            for runs in both.values()
        ]
        if all(values):
            shown = [cell(spread_of(runs, field)) for runs in both.values()]
            lines.append(row([scenario, title, *shown, p_of(unpaired(*values))]))
    return lines
