"""What is installed by entry points: the groups themselves, and the modules of messages."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoints, entry_points
from typing import Final

GROUP: Final = "armadico.messages"
"""Modules of messages and resources, each imported for what it registers."""


def entries(group: str) -> EntryPoints:
    """The entry points of a group, of all that is installed where modules are looked for now."""
    return _entries(*sys.path)(group=group)


@cache  # looking through all that is installed takes 20 ms, for one group or for all
def _entries(*_path: str) -> Callable[..., EntryPoints]:
    return entry_points().select


@cache
def load_all() -> None:
    """Import all modules of messages; one that fails costs only what it would register."""
    for point in sorted(entries(GROUP), key=lambda each: each.name):
        try:
            point.load()
        except (Exception, SystemExit) as error:
            import logging

            logger = logging.getLogger("armadico.installed")
            logger.warning("the messages of %r cannot be imported: %s", point.name, error)
