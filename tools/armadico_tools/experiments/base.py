"""What an experiment is given: its seeds, its cores, and where its results go."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from armadico.cli import pool
from armadico.cli.options import say
from armadico.observe.conditions import Conditions, Software, software, source_hash
from armadico_tools.experiments import FIRST_SEED, RUNS
from armadico_tools.experiments.driving import (
    Cell,
    Drive,
    Sample,
    conditions_of,
    drive,
    key_of,
)
from armadico_tools.experiments.store import BESIDES, CONDITIONS, Found, Store
from armadico_tools.results import write_csv, write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

T = TypeVar("T")
R = TypeVar("R")

Samples = dict[str, list[Sample]]
"""Runs by the name of their cell, in the order of their seeds."""


@dataclass(frozen=True)
class Barn:
    """What the command line may choose of the BARN challenge; nothing: all of it."""

    worlds: tuple[int, ...] = ()
    robots: tuple[str, ...] = ()
    v_max: float | None = None  # m/s
    data: Path | None = None  # a file of worlds


@dataclass
class Context:
    out: Path  # its own folder, which exists
    runs: int = RUNS  # seeds for each cell
    jobs: int = 1
    first_seed: int = FIRST_SEED
    barn: Barn = Barn()
    logs: Path | None = None  # a folder of logs of real robots, or one log
    source: str = field(default_factory=lambda: source_hash(*BESIDES))
    software: Software = field(default_factory=software)
    conditions: dict[str, Conditions] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)
    summary: dict[str, object] = field(default_factory=dict)

    @property
    def seeds(self) -> list[int]:
        """The seeds of each cell."""
        return list(range(self.first_seed, self.first_seed + self.runs))

    def drive(self, cells: Sequence[Cell], seeds: Sequence[int] | None = None) -> Samples:
        """Every cell with every seed, but for what `runs.csv` has already."""
        return self.drive_each([(c, seed) for c in cells for seed in seeds or self.seeds])

    def drive_each(
        self,
        tasks: Sequence[tuple[Cell, int]],
        function: Callable[[tuple[Cell, int]], Sample] | None = None,
        mode: str = "virtual",
        jobs: int | None = None,
    ) -> Samples:
        """These runs, but for what `runs.csv` has already; `function` drives one of them."""
        store = Store(self.out, self.software.commit)
        self.conditions = {c.name: conditions_of(c, mode) for c, _ in tasks} | self.conditions
        write_json(self.out / CONDITIONS, self.conditions)
        self._wrote(self.out / CONDITIONS)
        keys = {cell.name: key_of(cell, self.source) for cell, _ in dict(tasks).items()}
        wanted = [(cell.name, seed, keys[cell.name]) for cell, seed in tasks]
        missing = [task for task, key in zip(tasks, wanted, strict=True) if key not in store.known]
        pool.over(
            function or drive,
            missing,
            jobs or self.jobs,
            self.out.name,
            lambda task, sample: store.add(sample, keys[task[0].name]),
        )
        store.order(wanted)
        self._wrote(self.out / "runs.csv")
        samples: Samples = {}
        for key in wanted:
            samples.setdefault(key[0], []).append(store.known[key])
        self.summary |= {name: _outcome(found) for name, found in samples.items()}
        return samples

    def again(self, cells: Sequence[Cell]) -> Iterator[Drive]:
        """The first seed of each once more, for the pictures; it says how far that is."""
        for number, cell in enumerate(cells, start=1):
            say(f"{self.out.name}: driven again for the pictures, {number} of {len(cells)}")
            yield Drive(cell, self.first_seed).go()

    def map(self, function: Callable[[T], R], items: Iterable[T], label: str) -> list[R]:
        """A module's function over items, in processes, with progress; results in order.

        What `found.csv` has already is not made again.
        """
        wanted, found = list(items), Found(self.out, function, self.source)
        missing = [(at, item) for at, item in enumerate(wanted) if item not in found]
        made = pool.over(function, [item for _, item in missing], self.jobs, label, found.add)
        fresh = {at: result for (at, _), result in zip(missing, made, strict=True)}
        return [fresh[at] if at in fresh else found[item] for at, item in enumerate(wanted)]

    def rows(self, name: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Write `name`.csv."""
        path = self.out / f"{name}.csv"
        write_csv(path, header, rows)
        self._wrote(path)

    def table(self, text: str, name: str = "table") -> None:
        """Write `name`.md, with the commit and the seeds that it was made with."""
        path = self.out / f"{name}.md"
        seeds = f"seeds {self.first_seed} to {self.first_seed + self.runs - 1}"
        commit = self.software.commit
        path.write_text(f"{text.rstrip()}\n\nCommit {commit}, {seeds}.\n", encoding="utf-8")
        self._wrote(path)

    def figure(self, figure: Figure, name: str) -> None:
        """Write `name`.png and `name`.svg; the same figure gives the same bytes."""
        import matplotlib as mpl  # noqa: PLC0415 - an extra, and slow

        with mpl.rc_context({"svg.hashsalt": name}):
            for suffix, metadata in ((".png", {"Software": None}), (".svg", {"Date": None})):
                path = self.out / f"{name}{suffix}"
                figure.savefig(path, dpi=120, metadata=metadata)
                self._wrote(path)

    def _wrote(self, path: Path) -> None:
        if path not in self.files:
            self.files.append(path)


def _outcome(samples: Sequence[Sample]) -> dict[str, object]:
    """A cell in a few numbers, for programs; `tt_s` is the mean of the runs that arrived."""
    times = [sample.tt_s for sample in samples if sample.arrived]
    return {
        "runs": len(samples),
        "reached": sum(sample.reached for sample in samples),
        "arrived": sum(sample.arrived for sample in samples),
        "collided": sum(bool(sample.collisions) for sample in samples),
        "tt_s": round(sum(times) / len(times), 3) if times else None,
        "td_m": round(sum(sample.td_m for sample in samples) / len(samples), 3),
    }
