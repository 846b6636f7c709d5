"""What `armadico stop` does first, before its command line is read and checked.

On a busy computer the imports of a command take seconds, so this module imports what it needs where
it needs it.
"""

from __future__ import annotations

import os
from contextlib import suppress

TYPE_CHECKING = False  # importing `typing` is slow
if TYPE_CHECKING:
    from collections.abc import Sequence

PRIORITY = 10  # of SCHED_FIFO: below a robot's guard
NICE = -20

VALUED = ("--namespace", "--timeout", "--host", "--hosts")
"""Options with which the robot may be this computer's; with `--connect` it is another one's."""


def stop(words: Sequence[str]) -> None:
    """Stop the robot of this computer's society at once, by the words after `armadico stop`.

    The command goes on afterwards, before ordinary processes where that is allowed, and stops the
    robot by the mesh. Nothing is done here if it is not certain that the words are valid.
    """
    namespace = _namespace(words)
    if namespace is None:
        return
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):  # not allowed, or no Linux
        _stop(namespace)
        return
    _stop(namespace)
    # The rest is long, and the robot agent needs the processor, too.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.setpriority(os.PRIO_PROCESS, 0, NICE)


def _stop(namespace: str) -> None:
    from armadico.mesh import sockets

    with suppress(OSError, ValueError):  # no folder for sockets: the command reports that
        sockets.stop(namespace)


def _namespace(words: Sequence[str]) -> str | None:
    """The robot's namespace; None: the words need a full parser, which may reject them."""
    from armadico.mesh.topology import checked_namespace, default_namespace

    namespace, left = default_namespace(), iter(words)
    for word in left:
        name, equals, value = word.partition("=")
        value = value if equals else next(left, "")
        if name not in VALUED or not value:
            return None
        namespace = value if name == "--namespace" else namespace
    try:
        return checked_namespace(namespace)
    except ValueError:
        return None
