"""Where an experiment's results are kept: nothing is lost, and nothing is overwritten silently.

`runs.csv` is append-only while an experiment runs, one line a run as soon as it is finished, keyed
by cell, seed and a hash of all that the run depends on; at the end it is put in order. `about.json`
describes the folder, `conditions.json` what the runs of each cell depend on. What is no run of a
cell, a day of surveillance say, is a row of `found.csv`, as soon as it is found. A folder that
holds other seeds, or was made by other code, is moved aside.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from contextlib import suppress
from hashlib import sha256
from inspect import getfile
from itertools import count
from pathlib import Path
from typing import Any, Final, Generic, TypeVar, get_type_hints

import msgspec
from msgspec import Struct

from armadico.observe.conditions import Software
from armadico_tools.experiments.driving import Sample
from armadico_tools.results import Rows, write_json

RUNS: Final = "runs.csv"
ABOUT: Final = "about.json"
CONDITIONS: Final = "conditions.json"
FOUND: Final = "found.csv"
BESIDES: Final = [
    Path(__file__).with_name(name) for name in ("driving.py", "traces.py", "likelihood_filter.py")
]
"""Of this package, what a run depends on: the rest only reports its results."""

Key = tuple[str, int, str]

T = TypeVar("T")
R = TypeVar("R")


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
        run = Run(**msgspec.structs.asdict(sample), key=key, commit=self._commit)
        self.known[run.cell, run.seed, key] = run
        self._rows.add(run)

    def order(self, keys: Sequence[Key]) -> None:
        """Write the file anew: these runs in this order, then any others that it holds."""
        rest = sorted(set(self.known) - set(keys))
        self._rows.rewrite(self.known[key] for key in (*keys, *rest))


class _Row(Struct, frozen=True):
    """Something that was found, under the hash of all that it depends on."""

    key: str
    of: str  # the item, for people
    found: str  # as JSON


class Found(Generic[T, R]):
    """What one function of a module has made of items, by this code: it need not be made again.

    Kept is what reads back as it was, by the type that the function says it returns; all else, what
    holds files or pictures say, is made again each time.
    """

    def __init__(self, folder: Path, function: Callable[[T], R], source: str) -> None:
        module = Path(getfile(function)).read_bytes()
        name = f"{function.__module__}.{function.__qualname__} {source} "
        self._of = sha256(name.encode() + module).hexdigest()
        self._decoder: msgspec.json.Decoder[Any] | None = None
        with suppress(TypeError):  # a type that JSON does not have
            self._decoder = msgspec.json.Decoder(get_type_hints(function)["return"])
        self._rows = Rows(folder / FOUND, _Row)
        self._known = {row.key: row.found for row in self._rows.read()}

    def __contains__(self, item: T) -> bool:
        return self._decoder is not None and self._key(item) in self._known

    def __getitem__(self, item: T) -> R:
        assert self._decoder is not None, "nothing is kept without"
        found: R = self._decoder.decode(self._known[self._key(item)])
        return found

    def add(self, item: T, found: R) -> None:
        """Keep what was found, now, if it reads back as it is."""
        if self._decoder is None:
            return
        try:
            text = msgspec.json.encode(found).decode()
            if self._decoder.decode(text) != found or len(text) > csv.field_size_limit():
                return
        except (TypeError, msgspec.DecodeError):
            return
        self._rows.add(_Row(self._key(item), repr(item), text))

    def _key(self, item: T) -> str:
        return sha256(f"{self._of} {item!r}".encode()).hexdigest()[:16]
