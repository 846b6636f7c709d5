"""Scenarios 1 to 4 as real processes and on the virtual mesh: is it the same society?"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import msgspec

from armadico.observe.measures import Result
from armadico_tools.experiments import tables
from armadico_tools.experiments.driving import Cell, Sample, columns, of_thesis
from armadico_tools.experiments.statistics import holm, shift, spread, unpaired
from armadico_tools.experiments.tables import RULES, number, p_of
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Live against virtual: scenarios 1 to 4"
RUNS: Final = 5
VIRTUAL_RUNS: Final = 6  # for each live one
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
    " under a virtual clock. The seed is the sensors' noise in both. Each live run has six virtual"
    " ones beside it. *live - virtual*: the median of all differences [95 % interval] (Hodges and"
    " Lehmann). p: Mann and Whitney, two-sided, and in brackets what Holm's correction makes of it"
    " in so many tests: below 0.05 the two are not one distribution."
)


def run(context: Context) -> None:
    """Virtual runs as ever; live ones one after the other, so that they have the machine."""
    first = context.first_seed
    many = range(first, first + VIRTUAL_RUNS * context.runs)
    virtual = [(Cell(scenario, scenario), seed) for scenario in SCENARIOS for seed in many]
    real = [
        (Cell(f"{scenario} live", scenario), seed)
        for seed in context.seeds
        for scenario in SCENARIOS
    ]
    context.drive_each(virtual)
    context.drive_each(real, live, "live", jobs=1)
    samples = context.drive_each([*virtual, *real])  # all are known: in order
    text = compare([(samples[f"{name} live"], samples[name]) for name in SCENARIOS])
    context.table(f"# {TITLE}\n\n{NOTE}\n\n{RULES}\n\n{text}")


def live(task: tuple[Cell, int]) -> Sample:
    """One run as `armadico run` makes it. Raises RuntimeError if it could not be made."""
    cell, seed = task
    namespace = f"experiment-{os.getpid()}-{cell.scenario}-{seed}"
    done = subprocess.run(
        [
            *(sys.executable, "-P", "-m", "armadico", "run", cell.scenario, "--seed", str(seed)),
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
        why = done.stderr.strip()[-500:]
        raise RuntimeError(f"{cell.scenario} seed {seed}: {why}") from None
    measured, shares = columns(result)
    measured |= of_thesis(shares, shares)
    return Sample(cell=cell.name, seed=seed, arrived=bool(result.reached), **measured)


def compare(pairs: Sequence[tuple[list[Sample], list[Sample]]]) -> str:
    """A table of live and virtual runs of each scenario, with one test for each measure."""
    tests: list[tuple[str, str, list[float], list[float]]] = []
    rows = []
    for real, virtual in pairs:
        scenario = virtual[0].cell
        both = [f"{sum(s.reached for s in runs)} of {len(runs)}" for runs in (real, virtual)]
        rows.append([scenario, "reached", *both, "-", "-"])
        for field, title in MEASURED.items():
            values = (_values(real, field), _values(virtual, field))
            if all(values):
                tests.append((scenario, title, *values))
    ps = [unpaired(real, virtual) for *_, real, virtual in tests]
    for test, p, q in zip(tests, ps, holm(ps), strict=True):
        corrected = "-" if q is None else f"{q:.3f}"
        rows.append([*test[:2], *_shown(*test[2:]), f"{p_of(p)} ({corrected})"])
    return (
        table(["scenario", "measure", "live", "virtual", "live - virtual", "p (Holm)"], rows) + "\n"
    )


def _values(runs: Sequence[Sample], field: str) -> list[float]:
    return [float(value) for one in runs if (value := getattr(one, field)) is not None]


def _shown(real: Sequence[float], virtual: Sequence[float]) -> list[str]:
    middle, low, high = map(number, shift(real, virtual))
    return [
        *(tables.cell(spread(values)) for values in (real, virtual)),
        f"{middle} [{low}, {high}]",
    ]
