"""One process of a host's share: it leaves, in order, when whoever started it is gone.

`python -m armadico.child PARENT COMMAND...` runs `armadico COMMAND...`. Linux sends the signal;
elsewhere the parent has to end cleanly.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from typing import Final

PR_SET_PDEATHSIG: Final = 1


def main() -> int:
    """Run the command with this process's life tied to its parent's."""
    parent, *words = sys.argv[1:]
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # it went before the signal was asked for
        return 0
    from armadico.cli import main as run  # noqa: PLC0415 - nothing is imported for nobody

    return run(words)


if __name__ == "__main__":
    sys.exit(main())
