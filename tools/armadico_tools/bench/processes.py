"""Processes that are measured one by one, and bare ones to compare with.

A benchmark that is killed leaves none: agents are tied to it, the floor ends with its input.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from armadico.launch.processes import end
from armadico.mesh import sockets

FLOOR: Final = Path(__file__).with_name("floor.py")


@contextmanager
def started(command: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """A process; it is gone at the end, however that comes."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is ours; we end them
    )
    try:
        yield process
    finally:
        end(process)


@contextmanager
def floor_socket() -> Iterator[str]:
    """A Unix socket for a router of the floor's and its clients, as an endpoint."""
    with TemporaryDirectory(prefix="armadico-floor-") as folder:
        yield sockets.endpoint(Path(folder) / "floor.sock")


def floor(*arguments: str) -> list[str]:
    """The command line of a process of the floor's."""
    return [sys.executable, "-P", str(FLOOR), *arguments]


@contextmanager
def ready_floor(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process of the floor that has printed `ready`. Raises RuntimeError if it does not."""
    with started(floor(*arguments)) as process:
        assert process.stdout is not None, "it was asked for"
        if process.stdout.readline().strip() != b"ready":
            raise RuntimeError(f"the floor did not start: {process.args!r}")
        yield process
