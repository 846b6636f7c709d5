"""A process that receives a signal when its parent is gone.

`python -m armadico.child PARENT SIGNAL PROGRAM...` becomes the program; `armadico` runs in the same
process, without another start of Python. Linux sends the signal when the thread that started the
process has ended. On other systems the parent has to end cleanly.
"""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Final

PR_SET_PDEATHSIG: Final = 1


def tie(parent: int, number: int) -> bool:
    """Request a signal for the parent's end; return whether the parent is still alive."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, number)
    return os.getppid() == parent  # it may have ended before the request


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
