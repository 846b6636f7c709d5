"""Folders for the sockets of one test: the processes that have the same are on one mesh."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

_of_the_session: list[str] = []


@contextmanager
def session_folder() -> Iterator[str]:
    """One with a short path, which a socket needs: pytest's own are too long."""
    with TemporaryDirectory(prefix="a-", dir="/tmp", ignore_cleanup_errors=True) as folder:
        _of_the_session.append(folder)
        yield folder
        _of_the_session.pop()


def fresh_folder() -> str:
    """Another one, which nobody else has; it goes with the session."""
    return mkdtemp(dir=_of_the_session[-1])


@contextmanager
def locked(path: Path) -> Iterator[Path]:
    """Lock a file of a running router or share."""
    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield path
