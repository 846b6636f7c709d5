"""Installed entry points, and the modules of messages among them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoints, entry_points
from typing import Final

GROUP: Final = "armadico.messages"  # modules that register messages and resources on import


def entries(group: str) -> EntryPoints:
    """Return the installed entry points of a group, by the present `sys.path`."""
    return _entries(*sys.path)(group=group)


@cache  # a search of the installed packages takes 20 ms, for one group or for all
def _entries(*_path: str) -> Callable[..., EntryPoints]:
    return entry_points().select


@cache
def load_all() -> None:
    """Import all modules of messages; a failing one only lacks its messages."""
    for point in sorted(entries(GROUP), key=lambda each: each.name):
        try:
            point.load()
        except (Exception, SystemExit) as error:
            import logging

            logger = logging.getLogger("armadico.installed")
            logger.warning("the messages of %r cannot be imported: %s", point.name, error)
