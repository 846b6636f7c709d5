"""Series of trials: run, counted, and kept as they come."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Final

from msgspec import Struct

from armadico.config.hosts import HostTable
from armadico.config.scenarios import Scenario
from armadico.observe.conditions import software
from armadico.observe.recorder import part
from armadico_tools.faults.checker import Checker, Violation
from armadico_tools.faults.event_log import HEARD_S
from armadico_tools.faults.real_faults import FAULTS
from armadico_tools.faults.real_society import ROAD, RealSociety, TrialError
from armadico_tools.faults.real_trials import TRIALS, TWIN, Figure, Trial, settle
from armadico_tools.faults.world_state import bounds_of
from armadico_tools.results import Rows, write_json
from armadico_tools.testbed import Namespaces, Place

ALL: Final[Mapping[str, Trial]] = {**TRIALS, **FAULTS}
"""Every kind of trial: those of the table, then the others."""

TWIN_HOST: Final = "lab3"
"""Where a second goto stands by, if there are hosts."""

ROWS: Final = "trials.csv"
SUMMARY: Final = "summary.json"

AGAIN: Final = 3
"""So many trials of a kind may fail before the rest of them are given up."""


class Line(Struct, frozen=True):
    """What a series came to for one figure; times are ms."""

    kind: str
    figure: str
    counts: str
    trials: int
    median: float
    worst: float
    aim_median: float | None
    aim_worst: float | None

    @property
    def kept(self) -> bool:
        """Whether what was aimed at was reached."""
        within = self.aim_worst is None or self.worst <= self.aim_worst
        return within and (self.aim_median is None or self.median <= self.aim_median)


@dataclass
class Series:
    """The trials of one kind."""

    trial: Trial
    rows: list[dict[str, float]] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    violations: list[Violation] = field(default_factory=list)

    def lines(self) -> list[Line]:
        """A line for each figure that was measured."""
        return [line for figure in self.trial.figures if (line := self._line(figure)) is not None]

    @property
    def kept(self) -> bool:
        """Whether every trial could be made, no promise was broken and every aim reached."""
        sound = bool(self.rows) and not self.failed and not self.violations
        return sound and all(line.kept for line in self.lines())

    def _line(self, figure: Figure) -> Line | None:
        values = [row[figure.name] for row in self.rows if figure.name in row]
        if not values:
            return None
        return Line(
            self.trial.name,
            figure.name,
            figure.text,
            len(values),
            round(median(values), 1),
            max(values),
            figure.median,
            figure.worst,
        )


class Measured(Struct, frozen=True):
    """One figure of one trial, as it is kept."""

    kind: str
    trial: int
    figure: str
    value: float
    seed: int
    commit: str


class Store:
    """Keeps each trial as soon as it is made. Raises OSError."""

    def __init__(self, folder: Path, seed: int) -> None:
        """Go on with the folder's file, or begin one."""
        self.folder = folder
        self._seed, self._commit = seed, software().commit
        self._rows = Rows(folder / ROWS, Measured)

    def add(self, kind: str, number: int, figures: Mapping[str, float]) -> None:
        about = (self._seed, self._commit)
        self._rows.add(*(Measured(kind, number, name, v, *about) for name, v in figures.items()))

    def finish(self, series: list[Series]) -> None:
        """The summary of what was run this time."""
        about = {
            "software": software(),
            "seed": self._seed,
            "lines": [line for each in series for line in each.lines()],
            "failed": {each.trial.name: each.failed for each in series if each.failed},
            "violations": [
                {"kind": each.trial.name, "promise": v.promise, "text": v.text}
                for each in series
                for v in each.violations
            ],
        }
        write_json(self.folder / SUMMARY, about)


def run_series(
    trial: Trial,
    place: Place,
    count: int,
    *,
    table: HostTable | None = None,
    scenario: Scenario = ROAD,
    seed: int = 0,
    done: Callable[[int, dict[str, float]], None] = lambda *_: None,
    failed: Callable[[str], None] = lambda _: None,
    record: Path | None = None,
) -> Series:
    """Make so many trials of one kind; `done` is shown each, `failed` is given what went wrong.

    They are recorded in a file, if it is named; a further society's in one beside it.

    The society stays up from trial to trial; after one that failed another is started.
    """
    series = Series(trial)
    rng = random.Random(f"{seed} {trial.name}")
    hosts: dict[str, str] = {}
    if trial.hosts and table is not None:
        hosts = {agent: name for name, host in table.hosts.items() for agent in host.agents}
    while len(series.rows) < count and len(series.failed) < AGAIN:
        checker = Checker(replace(bounds_of(scenario), heard_s=HEARD_S))
        again = len(series.failed)
        path = part(record, again) if record is not None and again else record
        try:
            with RealSociety(
                place, scenario=scenario, hosts=hosts, seed=seed, checker=checker, record=path
            ) as society:
                society.start()
                if trial.twin:
                    society.add(TWIN, "goto", TWIN_HOST if trial.hosts else society.place.hosts[0])
                society.count = len(series.rows)
                while len(series.rows) < count:
                    settle(society)
                    figures = trial.make(society, rng)
                    series.rows.append(figures)
                    done(len(series.rows), figures)
        except TrialError as error:
            series.failed.append(str(error))
            failed(str(error))
        series.violations += checker.violations
    return series


def place_for(trials: list[Trial], table: HostTable, seed: int) -> Place:
    """This machine, unless one of them needs hosts. Raises OSError."""
    if any(trial.hosts for trial in trials):
        return Namespaces(table, seed)
    return Place("trials")
