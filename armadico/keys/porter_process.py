"""The porter as a process: how a robot's router starts one, and what the process runs.

Both ends of what they agree on are here. The porter gets its listening sockets by their
descriptors, ends when its standard input is closed, and writes to its standard output as long as it
does not hang.
"""

from __future__ import annotations

import gc
import importlib
import logging
import os
import resource
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from armadico.core.config_errors import ConfigError
from armadico.keys.porter import Porter
from armadico.keys.store import Store

logger = logging.getLogger("armadico.keys")

ENDS_S: Final = 1.0
"""A porter that has not ended by then, once told, is killed."""

STARTS_S: Final = 20.0
HUNG_S: Final = 4.0
"""A porter that shows nothing for so long hangs, and is killed; `STARTS_S`: at first, s."""


class PorterProcess:
    """A running porter, as the router's process sees it."""

    def __init__(
        self,
        listening: Sequence[socket.socket],
        namespace: str,
        store: Store,
        router: Path,
        named: Sequence[str],
    ) -> None:
        """Start it; see `Porter`, and `Porter.prefer` for `named`."""
        fds = [end.fileno() for end in listening]
        words = [str(store.folder), namespace, str(router), " ".join(named), *map(str, fds)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", __name__, *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=fds,
        )

    def await_end(self) -> str:
        """Return how it has ended, once it has; one that hangs is killed."""
        process, timeout = self.process, STARTS_S
        assert process.stdout is not None, "it has a pipe"
        while select.select([process.stdout], [], [], timeout)[0]:
            if not os.read(process.stdout.fileno(), 4096):
                return f"has ended ({process.wait()})"
            timeout = HUNG_S
        process.kill()
        return "hangs"

    def end(self) -> None:
        assert self.process.stdin is not None, "it has a pipe"
        self.process.stdin.close()
        try:
            self.process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def forget(self) -> None:
        """Close its output once it has ended and nothing calls `await_end` any more."""
        assert self.process.stdout is not None, "it has a pipe"
        self.process.stdout.close()


def main(folder: str, namespace: str, router: str, named: str, *listening: str) -> int:
    """Serve on listening sockets, by their descriptors, until standard input is closed.

    `named` are the hosts of the table, with blanks between.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the robot agent decides
    logging.basicConfig(
        level=logging.INFO,
        stream=sys.stderr,
        format="%(asctime)s.%(msecs)03d porter %(levelname)s %(message)s",
        datefmt="%H:%M:%S",
    )
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    ends = [socket.socket(fileno=int(each)) for each in listening]
    store = Store(Path(folder))
    if store.issues:  # importing it later would hold up the links
        importlib.import_module("armadico.keys.issuing")
    try:
        porter = Porter(ends, namespace, store, Path(router))
    except ConfigError as error:
        logger.error("%s", error)
        return 2
    threading.Thread(target=porter.prefer, args=(named.split(),), daemon=True).start()
    gc.collect()
    gc.freeze()
    beat = sys.stdout.fileno()
    os.set_blocking(beat, False)

    def alive() -> None:
        with suppress(BlockingIOError):  # the robot agent is paused
            os.write(beat, b".")

    porter.run(sys.stdin.fileno(), alive)
    porter.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
