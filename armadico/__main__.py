"""`armadico` and `armadico-agent` as they are installed, and `python -m armadico`.

Ctrl-C ends them without a traceback while they are still importing, and when they have done.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path

INTERRUPTED = 130

UNPRINTABLE = "backslashreplace"
"""How a character comes out that the terminal, or UTF-8, has not."""


def main() -> int:
    """`armadico`."""
    with _silently():
        from armadico.cli import main as command  # noqa: PLC0415 - takes its time
    return _run(command)


def agent() -> int:
    """`armadico-agent`."""
    with _silently():
        from armadico.cli.agent import main as command  # noqa: PLC0415 - takes its time
    return _run(command)


def _run(command: Callable[[], int]) -> int:
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever started us: what it says is lost
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors=UNPRINTABLE)
    try:
        code = command()
    except KeyboardInterrupt:  # while an error was being told
        code = INTERRUPTED
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return code


@contextmanager
def _silently() -> Iterator[None]:
    """Have Ctrl-C end the process by the signal; one that nohup or `&` ignores stays ignored."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGINT, signal.default_int_handler)


if __name__ == "__main__":
    sys.exit(main())
