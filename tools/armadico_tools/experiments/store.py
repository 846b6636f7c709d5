"""Where an experiment's results are kept: nothing is lost, and nothing is overwritten silently.

`runs.csv` is append-only while an experiment runs, one line a run as soon as it is finished, keyed
by cell, seed and a hash of all that the run depends on; at the end it is put in order. `about.json`
describes the folder, `conditions.json` what the runs of each cell depend on. A folder that holds
other seeds, or was made by other code, is moved aside.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Final

import msgspec
from msgspec import Struct

from armadico.observe.conditions import Software
from armadico_tools.experiments.driving import Sample
from armadico_tools.results import Rows, write_json

RUNS: Final = "runs.csv"
ABOUT: Final = "about.json"
CONDITIONS: Final = "conditions.json"
BESIDES: Final = [Path(__file__).with_name(name) for name in ("driving.py", "traces.py")]
"""Of this package, what a run depends on: the rest only reports its results."""

Key = tuple[str, int, str]


class NotOursError(Exception):
    """A folder is in the way that no experiment made."""


class About(Struct, frozen=True, kw_only=True):
    """What a folder of results holds."""

    experiment: str
    first_seed: int
    runs: int
    source: str
    software: Software

    def continues(self, other: About) -> bool:
        """Whether these results may be put where the other ones are: the same, or more of them."""
        same = self.experiment == other.experiment and self.first_seed == other.first_seed
        return same and self.source == other.source and self.runs >= other.runs


def claim(folder: Path, about: About) -> Path | None:
    """Make the folder this experiment's. Returns where another one's results were moved to.

    Raises NotOursError if it holds something else.
    """
    moved = None
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        try:
            before = msgspec.json.decode((folder / ABOUT).read_bytes(), type=About)
        except (OSError, msgspec.DecodeError):
            raise NotOursError(
                f"{folder} is there and holds no results of an experiment; name another --out"
            ) from None
        if not about.continues(before):
            kept = (folder.with_name(f"{folder.name}.kept-{number}") for number in count(1))
            moved = folder.rename(next(name for name in kept if not name.exists()))
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / ABOUT, about)
    return moved


class Run(Sample, frozen=True):
    """A run as it is kept: with the hash of all that it depends on, and the commit that drove."""

    key: str = ""
    commit: str = ""


class Store:
    """The runs of one folder."""

    def __init__(self, folder: Path, commit: str) -> None:
        self._rows = Rows(folder / RUNS, Run)
        self._commit = commit
        self.known = {(run.cell, run.seed, run.key): run for run in self._rows.read()}

    def add(self, sample: Sample, key: str) -> None:
        """Keep a run, now."""
        run = Run(**msgspec.structs.asdict(sample), key=key, commit=self._commit)
        self.known[run.cell, run.seed, key] = run
        self._rows.add(run)

    def order(self, keys: Sequence[Key]) -> None:
        """Write the file anew: these runs in this order, then any others that it holds."""
        rest = sorted(set(self.known) - set(keys))
        self._rows.rewrite(self.known[key] for key in (*keys, *rest))
