"""Programs that this one starts: what they write is kept, and they are ended in order."""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Final

LEAVE_S: Final = 3.0
"""What a program may take to leave before it is killed."""

LAUNCHER: Final = "ARMADICO_LAUNCHER"
"""In the environment of a program: the id of the process that started it, to be ended with it."""


class Program:
    """One program that was started.

    Attributes:
        name: What it is called.
        log: Where what it writes is appended; None: it has this process's standard error.
        popen: The process.
    """

    def __init__(
        self,
        name: str,
        argv: Sequence[str],
        log: Path | None,
        *,
        listen: bool = False,
        env: Mapping[str, str] | None = None,
    ) -> None:
        """Start it; `listen`: its standard output is kept for `line`, instead of in the log."""
        self.name = name
        self.log = log
        with _appended(log) as errors:
            self._begun_at = 0 if log is None else errors.tell()
            self.popen: subprocess.Popen[bytes] = subprocess.Popen(
                argv,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if listen else errors,
                stderr=None if log is None else errors,
                env={**os.environ, LAUNCHER: str(os.getpid()), **(env or {})},
                start_new_session=True,  # Ctrl-C is this process's; it ends the others in order
            )

    def ended(self) -> bool:
        return self.popen.poll() is not None

    def last_words(self, lines: int = 5) -> str:
        """The end of what it wrote."""
        if self.log is None:
            return "    nothing"
        try:
            with self.log.open("rb") as file:
                file.seek(min(self._begun_at, self.log.stat().st_size))
                text = file.read().decode(errors="replace").strip().splitlines()
        except OSError as error:
            return f"    its log cannot be read: {error.strerror}"
        return "\n".join(f"    {line}" for line in text[-lines:]) or "    nothing"

    def line(self, timeout: float | None = None) -> str:
        """The next line of its standard output, or what there is of it in time (s); None: wait."""
        pipe = self.popen.stdout
        assert pipe is not None, "it is listened to"
        if timeout is None:
            return pipe.readline().decode(errors="replace")
        data, deadline = b"", time.monotonic() + timeout
        with selectors.DefaultSelector() as selector:
            selector.register(pipe, selectors.EVENT_READ)
            while b"\n" not in data and (left := deadline - time.monotonic()) > 0:
                if not selector.select(left) or not (chunk := os.read(pipe.fileno(), 4096)):
                    break
                data += chunk
        return data.decode(errors="replace").partition("\n")[0]


def _appended(log: Path | None) -> BinaryIO:
    """A log, to be written on; nowhere if it cannot be: who drives needs none.

    Its folder may have been cleaned up meanwhile, or the disk be full.
    """
    try:
        if log is not None:
            log.parent.mkdir(parents=True, exist_ok=True)
            return log.open("ab")
    except OSError:
        pass
    return Path(os.devnull).open("ab")


def end(
    *popens: subprocess.Popen[Any],
    number: signal.Signals = signal.SIGTERM,
    within_s: float = LEAVE_S,
) -> None:
    """Ask processes to leave, kill whoever does not, and close their pipes."""
    for popen in popens:
        with suppress(ProcessLookupError):
            popen.send_signal(number)
    deadline = time.monotonic() + within_s
    for popen in popens:
        try:
            popen.wait(max(deadline - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            popen.kill()
    finish(popens)


def finish(popens: Sequence[subprocess.Popen[Any]]) -> None:
    """Wait for processes that end, and close their pipes."""
    for popen in popens:
        popen.wait()
        for pipe in (popen.stdin, popen.stdout, popen.stderr):
            if pipe is not None:
                pipe.close()
