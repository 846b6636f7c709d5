"""Atomic replacement of files: the new ones are on the disk before the old ones are replaced.

Locks keep other processes from reading or replacing them meanwhile.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from errno import EACCES, EINVAL, EISDIR
from os import strerror
from pathlib import Path
from shutil import copymode

from armadico.core.config_errors import ConfigError


def write_files(files: Mapping[Path, bytes]) -> None:
    """Write all files or none; symbolic links are kept. Raises OSError."""
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
            with suppress(OSError):  # some file systems cannot sync a folder
                _sync(folder)
    except OSError:
        for at in new.values():
            with suppress(OSError):
                at.unlink()
        raise


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """A folder whose files one process at a time reads and replaces. Raises OSError.

    The lock is the folder's: a file that is replaced would lose its own.
    """
    opened = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(opened, fcntl.LOCK_EX)
        yield
    finally:
        os.close(opened)


@contextmanager
def held(path: Path, *, alone: bool) -> Iterator[None]:
    """Hold a map while it is read or written, several at a time, or alone.

    A file that is not there is free.
    The lock is of the file as it is now, and is gone with the process. File systems without locks
    are not protected. Raises ConfigError if another process holds the map.
    """
    try:
        file = path.open("rb")
    except OSError:  # the one who reads or writes it reports that
        yield
        return
    with file:
        try:
            fcntl.flock(file, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            doing = "uses" if alone else "writes"
            why = f"another process {doing} this map: wait until it ends, or name another file"
            raise ConfigError(why, path) from None
        except OSError:  # no locks there
            pass
        yield


def _sync(path: Path) -> None:
    """Flush a file, or the renames in a folder, to the disk. Raises OSError."""
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def written_first(path: Path) -> Path:
    """The temporary file that will replace `path`. Raises OSError if it cannot be replaced."""
    if path.is_dir():
        raise IsADirectoryError(EISDIR, strerror(EISDIR), str(path))
    if path.exists() and not path.is_file():  # a device must not be replaced by a file
        raise OSError(EINVAL, "is not a file", str(path))
    if path.exists() and not os.access(path, os.W_OK):  # a rename needs only the folder's rights
        raise PermissionError(EACCES, strerror(EACCES), str(path))
    try:
        real = path.resolve()
    except RuntimeError as error:  # a loop of links
        raise OSError(EINVAL, str(error), str(path)) from None
    return real.with_name(f"{real.name}.new")
