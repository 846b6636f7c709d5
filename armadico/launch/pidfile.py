"""The process that runs a host's share of a society: a file that it locks while it is alive.

Only the lock counts. An unlocked file is left over from a killed process and may be locked by the
next one. A reused process number is therefore never mistaken for the process.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO

from armadico.mesh.sockets import identity, is_held, share_of, shares_of


@dataclass(frozen=True)
class Share:
    """A running share: process, host, namespace, agents, log folder."""

    pid: int
    host: str
    namespace: str
    agents: tuple[str, ...]
    logs: str
    open: str = ""  # the open port; empty: none
    world: str = ""  # the robot's world, by name or absolute path; empty: it is not known
    robot: str = ""  # the robot's profile likewise


class TakenError(RuntimeError):
    """The share is running already; `share` is None if its file cannot be read yet."""

    def __init__(self, share: Share | None) -> None:
        super().__init__("the share is running already")
        self.share = share


class PidFile:
    """A context manager that holds the lock and removes the file at the end."""

    def __init__(self, namespace: str, host: str) -> None:
        self.path = share_of(namespace, host)
        self._file: IO[str] | None = None

    def __enter__(self) -> PidFile:
        """Lock the file. Raises TakenError if it is locked, OSError if it cannot be written."""
        file = _locked(self.path)
        if file is None:
            raise TakenError(read(self.path))
        self._file = file
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self.path.unlink(missing_ok=True)  # before unlocking, so that no other process locks it
            self._file.close()

    def write(self, share: Share) -> None:
        assert self._file is not None, "the lock was taken"
        self._file.seek(0)
        self._file.truncate()
        self._file.write(f"{identity(share.pid)}\n{json.dumps(asdict(share))}")
        self._file.flush()


def shares(namespace: str, host: str | None = None) -> Iterator[Share]:
    """The running shares of a namespace on this machine, of one host or of all."""
    for path in [share_of(namespace, host)] if host else shares_of(namespace):
        if is_held(path) and (share := read(path)) is not None:
            yield share


def clear(namespace: str, hosts: Sequence[str] = ()) -> list[Share]:
    """Remove the files of killed processes, of some hosts or of all; return their shares."""
    found = []
    for path in [share_of(namespace, host) for host in hosts] or shares_of(namespace):
        if path.exists() and (file := _locked(path)) is not None:
            found += [share] if (share := read(path)) is not None else []
            path.unlink(missing_ok=True)
            file.close()
    return found


def read(path: Path) -> Share | None:
    """The share in a file; None if it is empty or damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8").partition("\n")[2])
        return Share(**(found | {"agents": tuple(found["agents"])}))
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _locked(path: Path) -> IO[str] | None:
    """The locked file; None if another process has the lock."""
    while True:
        file = path.open("a+", encoding="utf-8")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            return None
        if path.exists() and os.fstat(file.fileno()).st_ino == path.stat().st_ino:
            return file
        file.close()  # it was removed between opening and locking
