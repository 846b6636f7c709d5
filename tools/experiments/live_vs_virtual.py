"""Scenarios 1 to 4 as real processes and on the virtual mesh: is it the same society?"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING, Final

import msgspec

from armadico.measures import Result
from armadico.tools.experiments import tables
from armadico.tools.experiments.driving import Cell, Sample
from armadico.tools.experiments.statistics import unpaired
from armadico.tools.experiments.tables import RULES, p_of, row, spread_of

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
    virtual = [Cell(scenario, scenario) for scenario in SCENARIOS]
    real = [Cell(f"{scenario} live", scenario) for scenario in SCENARIOS]
    tasks = [(cell, seed) for cell in (*virtual, *real) for seed in context.seeds]
    live_tasks = [task for task in tasks if task[0] in real]
    context.drive(virtual)
    context.drive_each(live_tasks, live, jobs=1)
    samples = context.drive_each(tasks)  # all are known: in order
    lines = [row(["scenario", "measure", "live", "virtual", "p"]), row(["---"] * 5)]
    for scenario in SCENARIOS:
        lines += _compare(scenario, samples[f"{scenario} live"], samples[scenario])
    context.table(f"# {TITLE}\n\n{NOTE}\n\n{RULES}\n\n" + "\n".join(lines) + "\n")


def live(task: tuple[Cell, int]) -> Sample:
    """One run as `armadico run` makes it. Raises RuntimeError if it could not be made."""
    cell, seed = task
    namespace = f"experiment-{os.getpid()}-{cell.scenario}-{seed}"
    done = subprocess.run(
        [
            *(sys.executable, "-m", "armadico", "run", cell.scenario, "--seed", str(seed)),
            *("--json", "--no-plot", "--namespace", namespace),
        ],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    try:
        result = msgspec.convert(json.loads(done.stdout), Result)
    except ValueError:
        said = done.stderr.strip()[-500:]
        raise RuntimeError(f"{cell.scenario} seed {seed}: {said}") from None
    measured = msgspec.structs.asdict(result)
    del measured["scenario"], measured["seed"]
    return Sample(cell=cell.name, seed=seed, arrived=result.reached, **measured)


def _compare(scenario: str, live_runs: list[Sample], virtual: list[Sample]) -> list[str]:
    both = {"live": live_runs, "virtual": virtual}
    reached = [f"{sum(one.reached for one in runs)} of {len(runs)}" for runs in both.values()]
    lines = [row([scenario, "reached", *reached, "-"])]
    for field, title in MEASURED.items():
        values = [
            [float(value) for one in runs if (value := getattr(one, field)) is not None]
            for runs in both.values()
        ]
        if all(values):
            shown = [tables.cell(spread_of(runs, field)) for runs in both.values()]
            lines.append(row([scenario, title, *shown, p_of(unpaired(*values))]))
    return lines
