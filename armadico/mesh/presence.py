"""Which other agents are alive, for a process that may itself be disconnected: sans-IO.

When the link to the robot's router is lost, the tokens of all other agents disappear at once. That
does not mean that they have ended. So while a process is disconnected no agent is reported as gone.
Agents that have not returned `GRACE_S` after it is linked again are.

Any program that reaches the router can declare tokens, and Zenoh does not tell whose they are. So a
token is checked before it costs anything, new instances are limited per name and in all, and the
loss of the link is known from the link alone. An instance beyond the limits waits until there is
room; one that is known already is never displaced.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from math import inf
from typing import Final

GRACE_S: Final = 1.5  # others find a returned router within 0.5 s, or after a lease (1 s)

LONGEST: Final = 128
"""Characters of a name or an instance in a token."""

MOST_OF_A_NAME: Final = 32
"""Instances of one name, and new ones of it within `NEW_S`. A society has one or a few; two
thousand cost each agent its cycles."""

MOST: Final = 512
"""Instances of all names."""

MOST_NEW: Final = 128
"""New instances of all names within `NEW_S`: each is queried for its card by every agent. With 512
at once a robot on two cores stood for 0.8 s."""

NEW_S: Final = 30.0
"""Period in which new instances are counted, s: a token that is declared and dropped again and
again costs as much as many tokens."""

MOST_WAITING: Final = 4096
"""Instances that wait for room; further ones are forgotten until the next link."""

ROOM_S: Final = 1.0
"""Period of checking whether there is room for those that wait, s."""

Changed = Callable[[str, str, bool], None]
"""Called with an agent's name, its instance, and whether it is alive."""


class Presence:
    """Filters changes of liveliness tokens."""

    def __init__(
        self, changed: Changed, router_changed: Callable[[bool], None], *, reachable: bool = False
    ) -> None:
        """Begin without agents.

        `changed` is called when an agent appears or disappears, `router_changed` when the robot's
        router becomes reachable or unreachable. What is `reachable` at the beginning is not
        reported.
        """
        # Whether this process is linked to the robot's router, or is the router.
        self.reachable = reachable
        self._changed, self._router_changed = changed, router_changed
        self._there: set[tuple[str, str]] = set()
        self._count = Counter[str]()  # of those, by name
        self._new = Counter[str]()  # newly reported within `NEW_S`, by name
        self._new_at: deque[tuple[float, str]] = deque()  # the same, in order
        self._waiting: dict[tuple[str, str], None] = {}  # for room, in order
        self._room_at = inf
        # The agents that were reported as alive: name and instance.
        self.reported: set[tuple[str, str]] = set()
        self._poll_at = inf
        self._inquired = False  # on this link
        self._refused = Counter[str]()  # tokens, by what became of them

    @property
    def due(self) -> float:
        """When `poll` is due, s; infinite: not at all."""
        return min(self._poll_at, self._room_at)

    def link(self, up: bool, now: float) -> None:
        """Process that the link to the router is up, or lost.

        Without a link no token is known; all present ones arrive again with the next link.
        """
        if up == self.reachable:
            return
        self.reachable = up
        if not up:
            self._forget()
        self._inquired = False
        self._poll_at = now + GRACE_S if up and self.reported else inf
        self._router_changed(up)

    def begin_again(self, now: float) -> None:
        """Process that this process's own router opens its session anew, which loses all links.

        The agents that do not return within `GRACE_S` are reported as gone.
        """
        self._forget()
        self._poll_at = now + GRACE_S if self.reported else inf

    def _forget(self) -> None:
        """Forget all tokens, which arrive again with the next links."""
        self._there.clear()
        self._count.clear()
        self._waiting.clear()
        self._room_at = inf

    def inquire(self, now: float) -> None:
        """Process the claim that the router is ending, once per link.

        Tokens that disappear within `GRACE_S` are not reported until the own link has shown whether
        the claim is true.
        """
        if self.reachable and not self._inquired:
            self._inquired = True
            self._poll_at = now + GRACE_S

    def token(self, name: str, instance: str, there: bool, now: float) -> str:
        """Process that an agent's token appeared (`there`) or disappeared.

        Returns a line for the log if it waits or is ignored and that is news; else "".
        """
        agent = (name, instance)
        if not there:
            self._waiting.pop(agent, None)
            if agent in self._there:
                self._there.discard(agent)
                self._count[name] -= 1
            if self.reachable and self._poll_at == inf:  # else others have `GRACE_S` to return
                self._report(agent, False)
            return ""
        if agent in self._there or agent in self._waiting:
            return ""
        if max(len(name), len(instance)) > LONGEST:
            return self._refuse("ignored", f"more than {LONGEST} characters in a name")
        if agent not in self.reported and (why := self._lacks_room(name, now)):
            if len(self._waiting) < MOST_WAITING:
                self._waiting[agent] = None
                self._room_at = min(self._room_at, now + ROOM_S)
            return self._refuse("wait", why)
        self._accept(agent, now)
        return ""

    def _accept(self, agent: tuple[str, str], now: float) -> None:
        name, _ = agent
        self._there.add(agent)
        self._count[name] += 1
        if agent not in self.reported:
            self._new[name] += 1
            self._new_at.append((now, name))
            self._report(agent, True)

    def _lacks_room(self, name: str, now: float) -> str:
        """Why a new instance has to wait; "" if there is room."""
        while self._new_at and self._new_at[0][0] <= now - NEW_S:
            _, old = self._new_at.popleft()
            self._new[old] -= 1
            if not self._new[old]:
                del self._new[old]
        if max(self._count[name], self._new[name]) >= MOST_OF_A_NAME:
            return f"more than {MOST_OF_A_NAME} instances of {name!r}"
        if len(self._there) >= MOST or len(self._new_at) >= MOST_NEW:
            return f"more than {MOST} instances, or {MOST_NEW} new ones, the last of {name!r}"
        return ""

    def _refuse(self, what: str, why: str) -> str:
        # Powers of two: a flood of tokens must not become a flood of lines.
        self._refused[what] += 1
        count = self._refused[what]
        return "" if count & (count - 1) else f"{count} liveliness tokens {what}: {why}"

    def poll(self, now: float) -> None:
        """Report the agents that have not returned, and accept those that wait, once it is due."""
        if now >= self._poll_at:
            self._poll_at = inf
            for agent in sorted(self.reported - self._there):
                self._report(agent, False)
        if now >= self._room_at:
            for agent in tuple(self._waiting):
                if not self._lacks_room(agent[0], now):
                    del self._waiting[agent]
                    self._accept(agent, now)
            self._room_at = now + ROOM_S if self._waiting else inf

    def _report(self, agent: tuple[str, str], there: bool) -> None:
        if there != (agent in self.reported):
            (self.reported.add if there else self.reported.discard)(agent)
            self._changed(*agent, there)
