"""A process that receives a signal when its parent is gone, and one that computes for another.

`python -m armadico.child PARENT SIGNAL PROGRAM...` becomes the program; `armadico` runs in the same
process, without another start of Python. Linux sends the signal when the thread that started the
process has ended. On other systems the parent has to end cleanly.
"""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from typing import Final

PR_SET_PDEATHSIG: Final = 1

SELDOM: Final = 100_000
"""Threshold of the garbage collector, which then hardly ever runs."""


def tie(parent: int, number: int) -> bool:
    """Request a signal for the parent's end; return whether the parent is still alive."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, number)
    return os.getppid() == parent  # it may have ended before the request


def collect_seldom() -> None:
    """Collect garbage hardly ever: agents make few cycles, and collecting took up to a tenth."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(SELDOM)


def main() -> int:
    """Run the program; it ends with its parent."""
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
