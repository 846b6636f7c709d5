"""Which other agents are there, for one that may itself be cut off: sans-IO.

When the link to the robot's router is lost, the tokens of all others go at once. That says nothing
about them: *cut off* and *all others have ended* are two things, and only the second is news. So
while a process is cut off no agent is reported as gone; those that are not back `GRACE_S` after it
is linked again are.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Final

GRACE_S: Final = 1.5
"""The others find a router that has come back within 0.5 s, or after a lease (1 s)."""

Changed = Callable[[str, str, bool], None]
"""Told of an agent: its name, its instance, and whether it is there."""


class Presence:
    """Filters the news of liveliness tokens.

    Attributes:
        reachable: Whether this process is linked to the robot's router, or is that.
        told: The agents that are there, as far as it was reported: name and instance.
    """

    def __init__(
        self, changed: Changed, router_changed: Callable[[bool], None], *, reachable: bool = False
    ) -> None:
        """Begin with no agent there.

        Args:
            changed: Told which agent comes, and which goes.
            router_changed: Told when the robot's router can be reached, and when not any more.
            reachable: Whether it can be reached from the beginning: that is no news.
        """
        self.reachable = reachable
        self._changed, self._router_changed = changed, router_changed
        self._there: set[tuple[str, str]] = set()
        self.told: set[tuple[str, str]] = set()
        self._look_at = inf

    @property
    def due(self) -> float:
        """When `look` is to be called, s; infinite if there is nothing to wait for."""
        return self._look_at

    def link(self, up: bool, now: float) -> None:
        """The link to the router is there, or lost.

        Without one nothing is known any more; all that is there comes again with the next link.
        """
        if up == self.reachable:
            return
        self.reachable = up
        if not up:
            self._there.clear()
        self._look_at = now + GRACE_S if up and self.told else inf
        self._router_changed(up)

    def token(self, name: str, instance: str, there: bool) -> None:
        """The token of an agent has come, or gone."""
        who = (name, instance)
        if there:
            self._there.add(who)
            self._tell(who, True)
            return
        self._there.discard(who)
        if self.reachable and self._look_at == inf:  # else the others have time to come back
            self._tell(who, False)

    def poll(self, now: float) -> None:
        """Report who has gone, once it is due."""
        if now >= self._look_at:
            self._look_at = inf
            for who in sorted(self.told - self._there):
                self._tell(who, False)

    def _tell(self, who: tuple[str, str], there: bool) -> None:
        if there != (who in self.told):
            (self.told.add if there else self.told.discard)(who)
            self._changed(*who, there)
