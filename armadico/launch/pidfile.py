"""Which process has a host's share up on this machine: a file that it keeps locked while it lives.

The lock is what counts: a file that nobody has locked is left over from a process that was killed,
and whoever locks it owns it. So no process is ever taken for another that has its number.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO

from armadico.mesh.sockets import folder, is_held, stem


@dataclass(frozen=True)
class Share:
    """What is up: which host's share of which namespace, by which process, since when."""

    pid: int
    host: str
    namespace: str
    agents: tuple[str, ...]
    logs: str


class TakenError(RuntimeError):
    """The share is up already; `share` says by whom, if that could be read."""

    def __init__(self, share: Share | None) -> None:
        super().__init__("the share is up already")
        self.share = share


class PidFile:
    """A context manager that holds the lock; the file goes with it."""

    def __init__(self, namespace: str, host: str) -> None:
        self.path = folder() / f"{stem(namespace)}@{stem(host)}.json"
        self._file: IO[str] | None = None

    def __enter__(self) -> PidFile:
        """Take the lock. Raises TakenError if somebody has it, OSError if there is no place."""
        file = _locked(self.path)
        if file is None:
            raise TakenError(read(self.path))
        self._file = file
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self.path.unlink(missing_ok=True)  # while it is locked: no other has it open as its own
            self._file.close()

    def write(self, share: Share) -> None:
        assert self._file is not None, "the lock was taken"
        self._file.seek(0)
        self._file.truncate()
        json.dump(asdict(share), self._file)
        self._file.flush()


def shares(namespace: str, host: str | None = None) -> Iterator[Share]:
    """What is up on this machine in a namespace, of one host or of all."""
    for path in sorted(folder().glob(f"{stem(namespace)}@{stem(host) if host else '*'}.json")):
        if is_held(path) and (share := read(path)) is not None:
            yield share


def read(path: Path) -> Share | None:
    """What a file says; None if it says nothing, as in its first moment."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return Share(**(found | {"agents": tuple(found["agents"])}))
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _locked(path: Path) -> IO[str] | None:
    """The file, locked; None if somebody else has it."""
    while True:
        file = path.open("a+", encoding="utf-8")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            return None
        if path.exists() and os.fstat(file.fileno()).st_ino == path.stat().st_ino:
            return file
        file.close()  # it was taken away between opening and locking
