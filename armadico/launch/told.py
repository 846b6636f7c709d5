"""What agents log of faults, passed on to whoever started the run."""

from __future__ import annotations

from collections.abc import Callable

from armadico.core.agent import WARNING
from armadico.core.messages import Log, Message


class Told:
    """Tells of each line with whose it is, and never the same twice running."""

    def __init__(self) -> None:
        self.tell: Callable[[str], None] = lambda _: None
        self._last: tuple[str, str] | None = None

    def take(self, key: str, message: Message) -> None:
        """Pass it on, if it is of a fault."""
        if not isinstance(message, Log) or message.level < WARNING:
            return
        said = key, message.text
        if said == self._last:
            return
        self._last = said
        name = key.rpartition("/")[2].rpartition("-")[0]
        own = message.text.startswith(name)  # who signs does it with the whole instance
        self.tell(message.text if own else f"{name}: {message.text}")
