"""Runs experiments, each of which declares its runs, measures and tables.

A folder of results belongs to one experiment with one first seed and one version of the code:

- `about.json`: experiment, seeds, software; `conditions.json`: conditions of each cell
- `found.csv`: each result as soon as it is known, under a hash of all that it depends on. An
  interrupted experiment continues from it.
- a CSV for each part of the experiment, `table.md`, pictures: written at the end, the same bytes
  for the same results

A folder with other seeds, or by other code, is renamed. No result is overwritten.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import msgspec
from msgspec import Struct

from armadico.cli import pool
from armadico.observe.conditions import Software, software, source_hash
from armadico_tools.experiments import FIRST_SEED, RUNS, Barn
from armadico_tools.experiments.driving import (
    Cell,
    Sample,
    Samples,
    conditions_of,
    drive,
    key_of,
)
from armadico_tools.results import Kept, write_csv, write_json

T = TypeVar("T")
R = TypeVar("R")

ABOUT: Final = "about.json"
CONDITIONS: Final = "conditions.json"
FOUND: Final = "found.csv"
BESIDES: Final = [
    Path(__file__).with_name(name) for name in ("driving.py", "lifted.py", "likelihood_filter.py")
]
"""Modules of this package that change results. The others only report them."""

Table = tuple[Sequence[str], Iterable[Sequence[object]]]
"""The header and the rows of a CSV file."""


def flat(found: Sequence[Any]) -> Table:
    """A row for each result, a column for each of its fields."""
    return found[0].__struct_fields__ if found else (), map(msgspec.structs.astuple, found)


# Declarations -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Part(Generic[T, R]):
    """A function that is applied to tasks, in processes."""

    name: str  # of its CSV, and of its results in `Context.found`
    measure: Callable[[T], R]  # at module level, for worker processes
    tasks: Callable[[Context], Sequence[T]]
    rows: Callable[[Sequence[R]], Table] | None = flat  # None: no CSV


@dataclass(frozen=True)
class Experiment:
    """The parts that are run, and the report."""

    parts: tuple[Part[Any, Any], ...]
    report: Callable[[Context], str]  # Markdown
    note: str = ""  # for readers of the table
    runs: int = RUNS  # seeds
    first_seed: int = FIRST_SEED


def driven(
    cells: Callable[[Context], Sequence[Cell]],
    measure: Callable[[tuple[Cell, int]], Sample] = drive,
) -> Part[tuple[Cell, int], Sample]:
    """Each cell with each seed; `Context.samples` has the results."""
    return Part(
        "runs",
        measure,
        lambda context: [(c, seed) for c in cells(context) for seed in context.seeds],
    )


@dataclass
class Context:
    """One experiment in progress: its options and results."""

    out: Path  # its folder, which exists
    runs: int = RUNS
    jobs: int = 1
    first_seed: int = FIRST_SEED
    barn: Barn = field(default_factory=Barn)
    logs: Path | None = None  # a folder of logs of real robots, or one log
    source: str = field(default_factory=lambda: source_hash(*BESIDES))
    software: Software = field(default_factory=software)
    found: dict[str, list[Any]] = field(default_factory=dict)  # by part
    cells: dict[str, Cell] = field(default_factory=dict)  # those that were run, by name
    files: list[Path] = field(default_factory=list)
    summary: dict[str, object] = field(default_factory=dict)

    @property
    def seeds(self) -> list[int]:
        return list(range(self.first_seed, self.first_seed + self.runs))

    @property
    def samples(self) -> Samples:
        """The runs by the name of their cell, in the order of seeds."""
        found: Samples = {}
        for sample in self.found["runs"]:
            found.setdefault(sample.cell, []).append(sample)
        return found

    def claim(self, name: str) -> Path | None:
        """Claim the folder for this experiment; see `claim`."""
        about = About(
            experiment=name,
            first_seed=self.first_seed,
            runs=self.runs,
            source=self.source,
            software=self.software,
        )
        return claim(self.out, about)

    def run(self, experiment: Experiment, title: str) -> None:
        """Run what is missing, and write all files anew."""
        for part in experiment.parts:
            found = self.map(part.measure, part.tasks(self), part.name)
            self.found[part.name] = found
            if part.rows is not None:
                self.rows(part.name, *part.rows(found))
        if self.cells:
            self.summary |= {name: outcome(samples) for name, samples in self.samples.items()}
        self._table(f"# {title}\n\n{experiment.note}\n\n{experiment.report(self)}")

    def map(self, function: Callable[[T], R], tasks: Sequence[T], label: str) -> list[R]:
        """Apply a function to tasks, in order; results in `found.csv` are not computed again."""
        keys = {cell: key_of(cell) for task in tasks if (cell := _cell(task)) is not None}

        def depends_on(task: Any) -> str:
            cell = _cell(task)
            return repr(task) if cell is None else f"{cell.name} {keys[cell]} {task[1]}"

        if keys:
            self.cells |= {cell.name: cell for cell in keys}
            conditions = {name: conditions_of(cell) for name, cell in self.cells.items()}
            write_json(self.file(CONDITIONS), conditions)
        kept = Kept(self.out / FOUND, function, self.source)
        known = kept.read(list(map(depends_on, tasks)))
        missing = [at for at in range(len(tasks)) if at not in known]
        made = pool.over(
            function,
            [tasks[at] for at in missing],
            self.jobs,
            f"{self.out.name}, {label}",
            lambda task, result: kept.add(depends_on(task), result),
        )
        known |= dict(zip(missing, made, strict=True))
        return [known[at] for at in range(len(tasks))]

    def rows(self, name: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Write `name`.csv."""
        write_csv(self.file(f"{name}.csv"), header, rows)

    def file(self, name: str) -> Path:
        """The path of a file of results, which the caller writes."""
        path = self.out / name
        if path not in self.files:
            self.files.append(path)
        return path

    def _table(self, text: str) -> None:
        """Write the table, with commit and seeds."""
        seeds = f"seeds {self.first_seed} to {self.first_seed + self.runs - 1}"
        made = f"Commit {self.software.commit}, {seeds}."
        self.file("table.md").write_text(f"{text.rstrip()}\n\n{made}\n", encoding="utf-8")


def _cell(task: Any) -> Cell | None:
    """The cell of a run; None for any other task."""
    return task[0] if isinstance(task, tuple) and isinstance(task[0], Cell) else None


def outcome(samples: Sequence[Sample]) -> dict[str, object]:
    """A summary of a cell, for programs; `tt_s` is the mean of the runs that arrived."""
    times = [sample.tt_s for sample in samples if sample.arrived]
    return {
        "runs": len(samples),
        "reached": sum(sample.reached for sample in samples),
        "arrived": sum(sample.arrived for sample in samples),
        "collided": sum(bool(sample.collisions) for sample in samples),
        "tt_s": round(sum(times) / len(times), 3) if times else None,
        "td_m": round(sum(sample.td_m for sample in samples) / len(samples), 3),
    }


# The folder ---------------------------------------------------------------------------------------


class NotOursError(Exception):
    """A folder exists that is not of an experiment."""


class About(Struct, frozen=True, kw_only=True):
    """The contents of `about.json`."""

    experiment: str
    first_seed: int
    runs: int
    source: str
    software: Software

    def continues(self, other: About) -> bool:
        """Whether these results may replace the others: the same experiment, as many seeds."""
        same = self.experiment == other.experiment and self.first_seed == other.first_seed
        return same and self.source == other.source and self.runs >= other.runs


def claim(folder: Path, about: About) -> Path | None:
    """Claim a folder for an experiment. Returns where another one's results were moved.

    Raises NotOursError if it has other contents.
    """
    moved = None
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        try:
            before = msgspec.json.decode((folder / ABOUT).read_bytes(), type=About)
        except (OSError, msgspec.DecodeError):
            raise NotOursError(
                f"{folder} exists and has no results of an experiment; name another --out"
            ) from None
        if not about.continues(before):
            kept = (folder.with_name(f"{folder.name}.kept-{number}") for number in count(1))
            moved = folder.rename(next(name for name in kept if not name.exists()))
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / ABOUT, about)
    return moved
