"""A cache of computed arrays in the user's cache folder."""

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
"""Greatest number of files and of bytes. The least recently used files are removed."""

NEW = ".npz.new"
"""Suffix of a file while it is written. A killed process's file is removed as old files are."""


def folder() -> Path:
    """The cache folder, by the XDG base directory specification: relative paths are ignored."""
    base = Path(os.environ.get(CACHE_VARIABLE, ""))
    return (base if base.is_absolute() else Path.home() / ".cache") / "armadico"


def cached_arrays(key: str, names: Collection[str], make: Callable[[], Arrays]) -> Arrays:
    """The arrays of `make`, from the cache if they are there.

    `key` is the file's name; it must depend on all inputs of `make`, including its code. A damaged
    file is written again. If the folder cannot be read or written, nothing is cached.
    """
    found: Arrays = {}
    # A file may be damaged anywhere: zip detects it by checksums, numpy by the header.
    with suppress(OSError, ValueError, EOFError, KeyError, RuntimeError, BadZipFile):
        path = folder() / f"{key}.npz"
        with path.open("rb") as file, np.load(file, allow_pickle=False) as cached:
            found = {name: cached[name] for name in cached.files}
        os.utime(path)
    if set(found) == set(names):  # zip's table of contents has no checksum, so names may be missing
        return found
    made = make()
    with suppress(OSError, RuntimeError):  # no home directory, no space, no permission
        _write(folder(), key, made)
    return made


def _write(where: Path, key: str, made: Arrays) -> None:
    """Write a whole file or none: other processes may read it, or write the same one."""
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
