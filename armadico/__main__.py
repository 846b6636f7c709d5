"""The installed programs `armadico-command` and `armadico-agent`, and `python -m armadico`.

`deploy/bin/armadico` starts the first one.

Ctrl-C ends them without a traceback while they import, and after their command.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import contextmanager
from io import BufferedWriter, FileIO, TextIOWrapper

TYPE_CHECKING = False  # importing `typing` is slow
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from _typeshed import ReadableBuffer

INTERRUPTED = 130

UNPRINTABLE = "backslashreplace"  # for characters that the terminal or UTF-8 cannot encode


def main() -> int:
    with _silently():
        from armadico.cli import main as command
    return run(command)


def agent() -> int:
    with _silently():
        from armadico.cli.agent import main as command
    return run(command)


class _Lossy(FileIO):
    """A file that discards bytes that cannot be written: full disk, closed pipe."""

    def write(self, data: ReadableBuffer, /) -> int:
        """Return the number of bytes written or discarded; never raises OSError."""
        size = memoryview(data).nbytes
        try:
            written = super().write(data)
        except OSError:
            return size
        return size if written is None else written  # None: a full non-blocking pipe


def run(command: Callable[[], int]) -> int:
    """Run a command and return its exit code.

    stderr is replaced by one that never fails: a log line that cannot be written must not stop a
    robot.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the parent: the output is discarded
            setattr(sys, name, open(os.devnull, "w"))  # noqa: PTH123, SIM115
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors=UNPRINTABLE)
    if isinstance(sys.stderr, TextIOWrapper):
        lossy = BufferedWriter(_Lossy(sys.stderr.fileno(), "w", closefd=False))
        sys.stderr = TextIOWrapper(lossy, sys.stderr.encoding, UNPRINTABLE, line_buffering=True)
    try:
        code = command()
    except KeyboardInterrupt:  # while an error was being printed
        code = INTERRUPTED
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # After Ctrl-C a further one does not change the exit code.
        after = signal.SIG_IGN if code == INTERRUPTED else signal.SIG_DFL
        signal.signal(signal.SIGINT, after)
    return code


@contextmanager
def _silently() -> Iterator[None]:
    """Let Ctrl-C end the process by the signal, unless nohup or `&` ignores it."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGINT, signal.default_int_handler)


if __name__ == "__main__":
    sys.exit(main())
