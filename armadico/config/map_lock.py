"""The lock of a map's files: while one process reads them, no other one replaces them."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from armadico.core.config_errors import ConfigError


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
