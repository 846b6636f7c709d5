"""What several tests look at is made once, by whichever worker comes first."""

from __future__ import annotations

import fcntl
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")


class Once:
    """Values by their names, in a folder that all workers of a session share."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(self, name: str, make: Callable[[], T]) -> T:
        """The value of that name; a worker that makes it keeps the others waiting for it."""
        kept = self._folder / name
        with (self._folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not kept.exists():
                kept.write_bytes(pickle.dumps(make()))
            value: T = pickle.loads(kept.read_bytes())  # a copy: no test sees another's changes
            return value
