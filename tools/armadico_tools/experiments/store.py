"""Where an experiment's results are kept: nothing is lost, and nothing is overwritten silently.

`runs.csv` is append-only while an experiment runs, one line a run as soon as it is finished, keyed
by cell, seed and a hash of all that the run depends on; at the end it is put in order. `about.json`
says what the folder holds. A folder that holds other seeds, or was made by other code, is moved
aside.
"""

from __future__ import annotations

import csv
import json
import subprocess
from collections.abc import Iterable, Sequence
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Final

import msgspec
from msgspec import Struct

from armadico_tools.experiments.driving import Sample

RUNS: Final = "runs.csv"
ABOUT: Final = "about.json"
FIELDS: Final = (*Sample.__struct_fields__, "key", "commit")
CODE: Final = ("armadico", "armadico.agents", "armadico.bridge", "armadico.configs")
BESIDES: Final = ("driving.py", "traces.py")
"""Of this package, what a run depends on: the rest only tells what came of it."""

Key = tuple[str, int, str]


class NotOursError(Exception):
    """A folder is in the way that no experiment made."""


class About(Struct, frozen=True, kw_only=True):
    """What a folder of results holds."""

    experiment: str
    first_seed: int
    runs: int
    source: str
    commit: str

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
            moved = _free_name(folder)
            folder.rename(moved)
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(msgspec.to_builtins(about), indent=2)
    (folder / ABOUT).write_text(text + "\n", encoding="utf-8")
    return moved


def _free_name(folder: Path) -> Path:
    number = 1
    while (name := folder.with_name(f"{folder.name}.kept-{number}")).exists():
        number += 1
    return name


class Store:
    """The runs of one folder."""

    def __init__(self, folder: Path, commit: str) -> None:
        self._path = folder / RUNS
        self._commit = commit
        self.known: dict[Key, Sample] = {}
        self._commits: dict[Key, str] = {}
        self._read()

    def _read(self) -> None:
        """What is there; a last line that was cut off does not count."""
        if not self._path.is_file():
            return
        with self._path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                if None in row.values() or None in row:
                    continue
                given = {name: text for name, text in row.items() if text != ""}
                key, commit = given.pop("key", ""), given.pop("commit", "")
                try:
                    sample = msgspec.convert(given, Sample, strict=False)
                except msgspec.ValidationError:
                    continue
                self.known[sample.cell, sample.seed, key] = sample
                self._commits[sample.cell, sample.seed, key] = commit

    def add(self, sample: Sample, key: str) -> None:
        """Keep a run, now."""
        new = not self._path.is_file()
        at = (sample.cell, sample.seed, key)
        self.known[at], self._commits[at] = sample, self._commit
        with self._path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            if new:
                writer.writerow(FIELDS)
            writer.writerow(self._row(at))

    def order(self, keys: Sequence[Key]) -> None:
        """Write the file anew: these runs in this order, then any others that it holds."""
        rest = sorted(set(self.known) - set(keys))
        fresh = self._path.with_suffix(".new")
        write_csv(fresh, FIELDS, (self._row(key) for key in (*keys, *rest)))
        fresh.replace(self._path)

    def _row(self, key: Key) -> list[object]:
        values = msgspec.structs.astuple(self.known[key])
        return [*map(plain, values), key[2], self._commits[key]]


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A CSV file whose bytes depend on the numbers only."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(map(plain, row) for row in rows)


def plain(value: object) -> object:
    """A value as it stands in a CSV: nothing for None, 0 and 1 for truth values."""
    if value is None:
        return ""
    return int(value) if isinstance(value, bool) else value


def source_hash() -> str:
    """16 hex digits of all code and configuration that a run depends on."""
    digest = sha256()
    for package in CODE:
        root = Path(next(iter(import_module(package).__path__)))
        for path in sorted(root.rglob("*")):
            if path.suffix in {".py", ".toml", ".map"} and "cli" not in path.parts:
                digest.update(f"{package}/{path.relative_to(root)}\0".encode())
                digest.update(path.read_bytes())
    for name in BESIDES:
        digest.update((Path(__file__).parent / name).read_bytes())
    return digest.hexdigest()[:16]


def commit() -> str:
    """The git commit that runs, with a + if what drives has changed since; or `none`."""
    root = Path(next(iter(import_module("armadico.agents").__path__))).resolve().parent
    try:
        head = _git(root, "rev-parse", "--short=12", "HEAD")
        paths = ("armadico", "agents", "bridge", "configs", ":!armadico/cli")
        changed = _git(root, "status", "--porcelain", "--", *paths)
    except (OSError, subprocess.CalledProcessError):
        return "none"
    return f"{head}+" if changed else head


def _git(root: Path, *words: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(root), *words], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()
