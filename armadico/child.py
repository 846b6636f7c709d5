"""One process that is told to leave, or killed, when whoever started it is gone.

`python -m armadico.child PARENT SIGNAL PROGRAM...` becomes a program; `armadico` it runs itself,
without another start of Python. Linux sends the signal, as soon as the thread that started it has
ended; elsewhere the parent has to end cleanly.
"""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Final

PR_SET_PDEATHSIG: Final = 1


def tie(parent: int, number: int) -> bool:
    """Have this process sent a signal when its parent is gone; return whether it still is there."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, number)
    return os.getppid() == parent  # or it went before the signal was asked for


def main() -> int:
    """Run the program with this process's life tied to its parent's."""
    parent, number, program, *words = sys.argv[1:]
    if not tie(int(parent), int(number)):
        return 0
    if program != "armadico":
        os.execvp(program, [program, *words])
    from armadico.__main__ import run
    from armadico.cli import main as command

    return run(lambda: command(words))


if __name__ == "__main__":
    sys.exit(main())
