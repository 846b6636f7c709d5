"""Series of trials: run, counted, and kept as they come."""

from __future__ import annotations

import csv
import random
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Final

import msgspec
from msgspec import Struct

from armadico.config.hosts import HostTable
from armadico.config.loading import find, load
from armadico.config.profile import RobotProfile
from armadico.config.scenarios import Scenario
from armadico_tools.faults.checker import Checker, Violation
from armadico_tools.faults.real_faults import FAULTS
from armadico_tools.faults.real_society import ROAD, RealSociety, TrialError
from armadico_tools.faults.real_trials import TRIALS, TWIN, Figure, Trial, settle
from armadico_tools.faults.testbed import Loopback, Namespaces, Place
from armadico_tools.faults.world_state import bounds_of

ALL: Final[Mapping[str, Trial]] = {**TRIALS, **FAULTS}
"""Every kind of trial: those of the table, then the others."""

TABLE: Final = "demo"
"""The shipped host table whose hosts the trials with hosts are on."""

TWIN_HOST: Final = "lab3"
"""Where a second goto stands by, if there are hosts."""

ROWS: Final = "trials.csv"
SUMMARY: Final = "summary.json"
FIELDS: Final = ("kind", "trial", "figure", "value", "seed", "commit")

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


class Store:
    """Keeps each trial as soon as it is made. Raises OSError."""

    def __init__(self, folder: Path, seed: int) -> None:
        """Go on with the folder's file, or begin one."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._seed, self._commit = seed, commit()
        self._path = folder / ROWS
        if not self._path.exists():
            self._write([FIELDS])

    def add(self, kind: str, number: int, figures: Mapping[str, float]) -> None:
        """One trial's figures."""
        rows = [(kind, number, name, v, self._seed, self._commit) for name, v in figures.items()]
        self._write(rows)

    def finish(self, series: list[Series]) -> None:
        """The summary of what was run this time."""
        about = {
            "commit": self._commit,
            "seed": self._seed,
            "lines": [line for each in series for line in each.lines()],
            "failed": {each.trial.name: each.failed for each in series if each.failed},
            "violations": [
                {"kind": each.trial.name, "promise": v.promise, "text": v.text}
                for each in series
                for v in each.violations
            ],
        }
        text = msgspec.json.format(msgspec.json.encode(about), indent=2)
        (self.folder / SUMMARY).write_bytes(text + b"\n")

    def _write(self, rows: Sequence[tuple[object, ...]]) -> None:
        with self._path.open("a", newline="", encoding="utf-8") as out:
            csv.writer(out, lineterminator="\n").writerows(rows)


def commit() -> str:
    """The commit of the checkout, with a mark if it was changed since; empty outside of one."""
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip()


def run_series(
    trial: Trial,
    place: Place,
    logs: Path,
    count: int,
    *,
    table: HostTable | None = None,
    scenario: Scenario = ROAD,
    seed: int = 0,
    done: Callable[[int, dict[str, float]], None] = lambda *_: None,
    failed: Callable[[str], None] = lambda _: None,
) -> Series:
    """Make so many trials of one kind; `done` is shown each, `failed` is told what went wrong.

    The society stays up from trial to trial; after one that failed another is started.
    """
    series = Series(trial)
    rng = random.Random(f"{seed} {trial.name}")
    hosts: dict[str, str] = {}
    if trial.hosts and table is not None:
        hosts = {agent: name for name, host in table.hosts.items() for agent in host.agents}
    while len(series.rows) < count and len(series.failed) < AGAIN:
        checker = Checker(bounds_of(load(find("robots", scenario.robot), RobotProfile)))
        try:
            with RealSociety(
                place, logs, scenario=scenario, hosts=hosts, seed=seed, checker=checker
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
    """Loopback, unless one of them needs hosts. Raises OSError."""
    if any(trial.hosts for trial in trials):
        return Namespaces(table, TABLE, seed)
    return Loopback()
