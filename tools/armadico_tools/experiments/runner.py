"""Runs experiments, each of which declares its runs, measures and tables.

A folder of results belongs to one experiment with one first seed and one version of the code:

- `about.json`: experiment, seeds, software, and at the end the number of results;
  `conditions.json`: conditions of each cell
- `found.csv`: each result as soon as it is known, under a hash of all that it depends on. An
  interrupted experiment continues from it.
- `progress.json`: what is run now; gone at the end
- a CSV for each part of the experiment, `table.md`, pictures: written at the end, the same bytes
  for the same results

A folder with other seeds, or by other code, is renamed. No result is overwritten.
"""

from __future__ import annotations

import fcntl
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import IO, Any, Final, Generic, TypeVar

import msgspec
from msgspec import Struct

from armadico.cli.options import FailedError
from armadico.cli.pool import Pool
from armadico.observe.conditions import Software, software, source_hash
from armadico_tools import series
from armadico_tools.experiments import FIRST_SEED, RUNS, Barn, Rivals
from armadico_tools.experiments.driving import (
    Cell,
    Sample,
    Samples,
    conditions_of,
    drive,
    key_of,
)
from armadico_tools.results import Kept, Result, rows_of, write_csv, write_json

T = TypeVar("T")
R = TypeVar("R")

ABOUT: Final = "about.json"
CONDITIONS: Final = "conditions.json"
FOUND: Final = "found.csv"
PROGRESS: Final = "progress.json"
BESIDES: Final = [
    Path(__file__).with_name(f"{name}.py")
    for name in ("bidders", "driving", "lifted", "likelihood_filter", "made_worlds")
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
    repeatable: bool = True  # False: results have times of this computer


@dataclass(frozen=True)
class Experiment:
    """The parts that are run, and the report."""

    parts: tuple[Part[Any, Any], ...]
    report: Callable[[Context], str]  # Markdown
    note: str = ""  # for readers of the table
    runs: int = RUNS  # seeds
    first_seed: int = FIRST_SEED
    title: str = ""  # of an experiment of another package
    seeds: str = ""  # what they are, for people; empty: `runs` from `first_seed` on


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
    workers: int | Pool = 1
    first_seed: int = FIRST_SEED
    barn: Barn = field(default_factory=Barn)
    rivals: Rivals = field(default_factory=Rivals)
    logs: Path | None = None  # a folder of logs of real robots, or one log; of foretold: of worlds
    source: str = field(default_factory=lambda: source_hash(*BESIDES))
    software: Software = field(default_factory=software)
    found: dict[str, list[Any]] = field(default_factory=dict)  # by part
    cells: dict[str, Cell] = field(default_factory=dict)  # those that were run, by name
    files: list[Path] = field(default_factory=list)
    lacking: list[str] = field(default_factory=list)  # what the results do not have, and should
    summary: dict[str, object] = field(default_factory=dict)
    _lock: IO[bytes] | None = field(default=None, init=False, repr=False)
    _about: About | None = field(default=None, init=False, repr=False)

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
        """Claim the folder for this experiment, until `close`; see `claim`."""
        self._about = About(
            experiment=name,
            first_seed=self.first_seed,
            runs=self.runs,
            source=self.source,
            software=self.software,
        )
        moved, self._lock = claim(self.out, self._about)
        return moved

    def close(self) -> None:
        """Release the folder."""
        if self._lock is not None:
            self._lock.close()

    def run(self, experiment: Experiment, title: str) -> None:
        """Run what is missing, and write all files anew."""
        for part in experiment.parts:
            tasks = part.tasks(self)
            found = self.map(part.measure, tasks, part.name, repeatable=part.repeatable)
            self.found[part.name] = found
            if part.rows is not None:
                self.rows(part.name, *part.rows(found))
        if self.cells and "runs" in self.found:
            self.summary |= {name: outcome(samples) for name, samples in self.samples.items()}
        reported = experiment.report(self)  # it may add to `lacking`
        note = "\n\n".join(filter(None, [experiment.note, *(f"**{x}.**" for x in self.lacking)]))
        self._table(f"# {title}\n\n{note}\n\n{reported}", experiment.seeds)
        if self._about is not None:
            kept = sum(1 for _ in rows_of(self.out / FOUND, Result))
            about = msgspec.structs.replace(self._about, results=kept, lacking=tuple(self.lacking))
            write_json(self.out / ABOUT, about)
        (self.out / PROGRESS).unlink(missing_ok=True)

    def map(
        self,
        function: Callable[[T], R],
        tasks: Sequence[T],
        label: str,
        *,
        repeatable: bool = True,
    ) -> list[R]:
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
        known, missing = series.known(kept, tasks, depends_on)
        write_json(
            self.out / PROGRESS, Progress(label, len(tasks), len(known), kept.count, time.time())
        )
        try:
            made = series.run(
                function,
                [tasks[at] for at in missing],
                self.workers,
                f"{self.out.name}, {label}",
                lambda task, result: kept.add(depends_on(task), result),
                repeatable=repeatable,
            )
        except BrokenExecutor as error:
            again = "finished runs are kept: the same command continues"
            raise FailedError(f"{series.lost(error)}; {again}") from None
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

    def _table(self, text: str, seeds: str) -> None:
        """Write the table, with commit and seeds."""
        seeds = seeds or f"seeds {self.first_seed} to {self.first_seed + self.runs - 1}"
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


class Progress(Struct, frozen=True):
    """The contents of `progress.json`, which an unfinished experiment has: its present part."""

    part: str
    runs: int
    known: int  # of these, when it began or continued
    kept: int  # results of all parts then
    began: float  # s since 1970


class NotOursError(Exception):
    """A folder is not of an experiment, or another process runs one in it."""


class About(Struct, frozen=True, kw_only=True):
    """The contents of `about.json`."""

    experiment: str
    first_seed: int
    runs: int
    source: str
    software: Software
    results: int | None = None  # that were kept when it was finished; None: it is not
    lacking: tuple[str, ...] = ()  # what the results do not have, and should

    def continues(self, other: About) -> bool:
        """Whether these results may replace the others: the same experiment, as many seeds."""
        same = self.experiment == other.experiment and self.first_seed == other.first_seed
        return same and self.source == other.source and self.runs >= other.runs


def claim(folder: Path, about: About) -> tuple[Path | None, IO[bytes]]:
    """Claim a folder for an experiment.

    Returns where another one's results were moved, and the file that locks the folder.

    Raises NotOursError if it has other contents, or another process runs an experiment in it.
    """
    with ExitStack() as held:
        lock = held.enter_context(_locked(folder)) if (folder / ABOUT).is_file() else None
        moved = _moved_aside(folder, about)
        folder.mkdir(parents=True, exist_ok=True)
        if lock is not None and moved is not None:
            lock.close()  # of what was moved
            lock = None
        if lock is None:
            (folder / ABOUT).touch()
            lock = held.enter_context(_locked(folder))
        write_json(folder / ABOUT, about)
        held.pop_all()
    return moved, lock


def _moved_aside(folder: Path, about: About) -> Path | None:
    """Rename a folder that these results do not continue. Raises NotOursError."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return None
    try:
        before = msgspec.json.decode((folder / ABOUT).read_bytes(), type=About)
    except (OSError, msgspec.DecodeError):
        raise NotOursError(
            f"{folder} exists and has no results of an experiment; name another --out"
        ) from None
    if about.continues(before):
        return None
    kept = (folder.with_name(f"{folder.name}.kept-{number}") for number in count(1))
    return folder.rename(next(name for name in kept if not name.exists()))


def _locked(folder: Path) -> IO[bytes]:
    """Lock a folder of results. Raises NotOursError if another process has locked it.

    The folder itself has the store's lock, which is held for each row alone.
    """
    file = (folder / ABOUT).open("r+b")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise NotOursError(
            f"another process runs an experiment in {folder}: wait for it, or name another --out"
        ) from None
    return file
