"""Which other agents are alive, for a process that may itself be disconnected: sans-IO.

When the link to the robot's router is lost, the tokens of all other agents disappear at once. That
does not mean that they have ended. So while a process is disconnected no agent is reported as gone.
Agents that have not returned `GRACE_S` after it is linked again are.

Any program that reaches the router can declare tokens. So a token is checked and counted before it
costs anything, and the loss of the link is known from the link alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from math import inf
from typing import Final

GRACE_S: Final = 1.5  # others find a returned router within 0.5 s, or after a lease (1 s)

LONGEST: Final = 128
"""Characters of a name or an instance in a token."""

MOST_OF_A_NAME: Final = 32
"""Instances of one name. A society has one or a few; two thousand cost each agent its cycles."""

MOST: Final = 512
"""Instances of all names."""

Changed = Callable[[str, str, bool], None]
"""Called with an agent's name, its instance, and whether it is alive."""


class Presence:
    """Filters changes of liveliness tokens.

    Attributes:
        reachable: Whether this process is linked to the robot's router, or is the router.
        reported: The agents that were reported as alive: name and instance.
    """

    def __init__(
        self, changed: Changed, router_changed: Callable[[bool], None], *, reachable: bool = False
    ) -> None:
        """Begin without agents.

        Args:
            changed: Called when an agent appears or disappears.
            router_changed: Called when the robot's router becomes reachable or unreachable.
            reachable: Whether the router is reachable at the beginning; this is not reported.
        """
        self.reachable = reachable
        self._changed, self._router_changed = changed, router_changed
        self._there: set[tuple[str, str]] = set()
        self.reported: set[tuple[str, str]] = set()
        self._poll_at = inf
        self._inquired = False  # on this link
        self._refused = Counter[str]()  # tokens, by the reason

    @property
    def due(self) -> float:
        """When `poll` is due, s; infinite: not at all."""
        return self._poll_at

    def link(self, up: bool, now: float) -> None:
        """Process that the link to the router is up, or lost.

        Without a link no token is known; all present ones arrive again with the next link.
        """
        if up == self.reachable:
            return
        self.reachable = up
        if not up:
            self._there.clear()
        self._inquired = False
        self._poll_at = now + GRACE_S if up and self.reported else inf
        self._router_changed(up)

    def inquire(self, now: float) -> None:
        """Process the claim that the router is ending, once per link.

        Tokens that disappear within `GRACE_S` are not reported until the own link has shown whether
        the claim is true.
        """
        if self.reachable and not self._inquired:
            self._inquired = True
            self._poll_at = now + GRACE_S

    def token(self, name: str, instance: str, there: bool) -> str:
        """Process that an agent's token appeared (`there`) or disappeared.

        Returns a line for the log if it is ignored and that is news; else "".
        """
        agent = (name, instance)
        if there and agent not in self._there and (why := self._refusal(name, instance)):
            self._refused[why] += 1
            count = self._refused[why]
            # Powers of two: a flood of tokens must not become a flood of lines.
            return "" if count & (count - 1) else f"{count} liveliness tokens ignored: {why}"
        if there:
            self._there.add(agent)
            self._report(agent, True)
            return ""
        self._there.discard(agent)
        if self.reachable and self._poll_at == inf:  # else others have `GRACE_S` to return
            self._report(agent, False)
        return ""

    def _refusal(self, name: str, instance: str) -> str:
        if max(len(name), len(instance)) > LONGEST:
            return f"a name has more than {LONGEST} characters"
        if sum(of == name for of, _ in self._there) >= MOST_OF_A_NAME:
            return f"there are {MOST_OF_A_NAME} instances of {name!r}"
        return f"there are {MOST} instances" if len(self._there) >= MOST else ""

    def poll(self, now: float) -> None:
        """Report the agents that have not returned, once it is due."""
        if now >= self._poll_at:
            self._poll_at = inf
            for agent in sorted(self.reported - self._there):
                self._report(agent, False)

    def _report(self, agent: tuple[str, str], there: bool) -> None:
        if there != (agent in self.reported):
            (self.reported.add if there else self.reported.discard)(agent)
            self._changed(*agent, there)
