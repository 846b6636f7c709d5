"""What took long to make and is the same the next time: arrays, kept in the user's cache folder."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]

CACHE_VARIABLE = "XDG_CACHE_HOME"

MOST, MOST_BYTES = 32, 2 * 10**9
"""So many files are kept, and bytes in them, those that were used last."""

NEW = ".npz.new"
"""Of a file that is being written; what a killed process has left goes as old files go."""


def folder() -> Path:
    """Where they are, by the XDG base directory specification: relative paths do not count."""
    base = Path(os.environ.get(CACHE_VARIABLE, ""))
    return (base if base.is_absolute() else Path.home() / ".cache") / "armadico"


def arrays(key: str, names: Collection[str], make: Callable[[], Arrays]) -> Arrays:
    """What `make` gives, from the cache if it is there.

    A file that is damaged is made anew; where nothing can be read or written nothing is kept.

    Args:
        key: Stands for all that `make` depends on, its code included; a file's name.
        names: Of the arrays.
        make: Makes them.
    """
    found: Arrays = {}
    # A file may be cut off or changed anywhere: zip tells by its sums, numpy by what it says.
    with suppress(OSError, ValueError, EOFError, KeyError, RuntimeError, BadZipFile):
        path = folder() / f"{key}.npz"
        with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
            found = {name: kept[name] for name in kept.files}
        os.utime(path)
    if set(found) == set(names):  # its table of contents has no sum, so it may lack some
        return found
    made = make()
    with suppress(OSError, RuntimeError):  # no home, no room, no right to
        _keep(folder(), key, made)
    return made


def _keep(where: Path, key: str, made: Arrays) -> None:
    """Whole or not at all: others may be reading, or writing the same."""
    where.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=where, prefix=f"{key}.", suffix=NEW, delete=False) as file:
        try:
            contents: dict[str, Any] = dict(made)
            np.savez(file, **contents)
            file.close()
            Path(file.name).replace(where / f"{key}.npz")
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise
    found = [(path.stat(), path) for path in where.glob("*.npz*")]
    taken = 0
    for place, (stat, path) in enumerate(sorted(found, key=lambda one: -one[0].st_mtime)):
        taken += stat.st_size
        if place >= MOST or (place and taken > MOST_BYTES):
            path.unlink(missing_ok=True)
