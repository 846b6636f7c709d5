"""Starting other programs, keeping their output, and ending them in order."""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final

LEAVE_S: Final = 3.0  # how long a program may take to end before it is killed, s

# The environment variable with the id of the process that started a program. The program ends with
# that process.
LAUNCHER: Final = "ARMADICO_LAUNCHER"


class Program:
    """One started program.

    Attributes:
        name: Its name, for people.
        log: The file to which its output is appended; None: this process's standard error.
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
        """Start it; `listen`: its standard output is read by `line` instead of logged."""
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
                start_new_session=True,  # Ctrl-C goes to this process, which ends the others
            )

    def ended(self) -> bool:
        return self.popen.poll() is not None

    def last_lines(self, lines: int = 5) -> str:
        """Return the last lines of its output."""
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
        """Return the next line of its output, or a part of it after the timeout (s)."""
        pipe = self.popen.stdout
        assert pipe is not None, "it was started with `listen`"
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
    """Open a log for appending, or the null device if that fails: a robot drives without a log."""
    try:
        if log is not None:
            log.parent.mkdir(parents=True, exist_ok=True)
            return log.open("ab")
    except OSError:
        pass
    return Path(os.devnull).open("ab")


def end(
    *popens: subprocess.Popen[str] | subprocess.Popen[bytes],
    number: signal.Signals = signal.SIGTERM,
    within_s: float = LEAVE_S,
) -> None:
    """Send processes a signal, kill those that do not end in time, and close their pipes."""
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


def finish(popens: Sequence[subprocess.Popen[str] | subprocess.Popen[bytes]]) -> None:
    """Wait until processes have ended, and close their pipes."""
    for popen in popens:
        popen.wait()
        for pipe in (popen.stdin, popen.stdout, popen.stderr):
            if pipe is not None:
                pipe.close()
