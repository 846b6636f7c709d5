"""Files in place of what was there: all of the new is on the disk before any of it shows."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from errno import EACCES, EINVAL, EISDIR
from os import strerror
from pathlib import Path
from shutil import copymode


def write_files(files: Mapping[Path, bytes]) -> None:
    """Write all of them, or none; a link stays one. Raises OSError."""
    new = {path: written_first(path) for path in files}
    try:
        for path, data in files.items():
            new[path].write_bytes(data)
            _sync(new[path])
            if path.exists():
                copymode(path, new[path])
        for path, at in new.items():
            at.replace(path.resolve())
        for folder in {path.resolve().parent for path in new}:
            with suppress(OSError):  # some file systems cannot, and all is written
                _sync(folder)
    except OSError:
        for at in new.values():
            with suppress(OSError):
                at.unlink()
        raise


def _sync(path: Path) -> None:
    """Have the disk keep a file, or what was renamed in a folder. Raises OSError."""
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def written_first(path: Path) -> Path:
    """Where it is written before it takes the place of what was there. Raises OSError."""
    if path.is_dir():
        raise IsADirectoryError(EISDIR, strerror(EISDIR), str(path))
    if path.exists() and not path.is_file():  # a device would be a file from then on
        raise OSError(EINVAL, "is no file", str(path))
    if path.exists() and not os.access(path, os.W_OK):  # its folder would let it be replaced
        raise PermissionError(EACCES, strerror(EACCES), str(path))
    try:
        real = path.resolve()
    except RuntimeError as error:  # links that lead to each other
        raise OSError(EINVAL, str(error), str(path)) from None
    return real.with_name(f"{real.name}.new")
