"""The modules of messages and resources that are installed, each imported for what it registers."""

from __future__ import annotations

import logging
from functools import cache
from importlib.metadata import entry_points
from typing import Final

logger = logging.getLogger("armadico.installed")

GROUP: Final = "armadico.messages"
"""The entry points that name them."""


@cache
def load_all() -> None:
    """Import them all; one that cannot be imported costs only what it would register."""
    for point in sorted(entry_points(group=GROUP), key=lambda each: each.name):
        try:
            point.load()
        except Exception as error:
            logger.warning("the messages of %r cannot be imported: %s", point.name, error)
