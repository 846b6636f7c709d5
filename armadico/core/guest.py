"""What a program that is no agent does on the mesh: the page, a command, a gateway.

A guest has no token, and agents do not see it. Its declarations are those of an agent
(`armadico.core.individual`), because in a society with keys its rights are derived from them. A
package registers its guests by entry points in the group `armadico.identities`.
"""

from __future__ import annotations

from typing import ClassVar, Final

from armadico.core.messages import Message

IDENTITIES: Final = "armadico.identities"
"""The group of guests, by the kind of their identity."""


class Part:
    """The declarations of a part of a guest."""

    provides: ClassVar[tuple[type[Message], ...]] = ()  # messages that it publishes
    queries: ClassVar[tuple[type[Message], ...]] = ()  # queries that it sends


class Guest(Part):
    """The declarations of one kind of guest."""

    receives: ClassVar[tuple[type[Message], ...]] = ()  # subscriptions, unless it `reads` all
    reads: ClassVar[bool] = False
    """It subscribes to everything, and queries cards, bids, parameters and pieces of journals. It
    cannot change parameters."""
    commands: ClassVar[bool] = False
    """It acts for a person: it sends every query, and publishes what guests may publish."""

    starts: ClassVar[tuple[str, ...]] = ()
    """Agents that it starts beside itself, if the society has none: they need keys, too."""

    @classmethod
    def parts(cls) -> tuple[type[Part], ...]:
        """Return classes with further declarations, which act under its identity."""
        return ()
