"""Signatures under latched states, which others repeat when their author is gone.

With keys, a process publishes each of its agents' latched states a second time, signed
(`armadico.core.messages.Repeat`). Other agents keep that, and can publish nothing else in its
author's name. A process refuses what is not signed by the author that it names, before its agents
receive it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from msgspec.structs import replace

from armadico.core.membership import agent_of
from armadico.core.messages import Latched, Message, Repeat, Stop
from armadico.core.messages import encode as encoded
from armadico.core.services import service_of
from armadico.mesh.door import ROBOT, Door, name_of

LIFE_S: Final = 3600
"""How long a signature counts, s: an author may be gone for so long. It limits how old a state may
be that a member gives to a society of which every process has restarted."""


class Seals:
    """Signs what one process publishes, and checks what others repeat."""

    def __init__(self, door: Door, agents: Sequence[str], wall: Callable[[], float]) -> None:
        """Begin, with the names of the process's agents.

        `wall` returns wall time, s since 1970.
        """
        self._door, self._wall = door, wall
        self._author = "+".join(sorted({*agents}))
        self._sealed: dict[str, Repeat] = {}  # the newest of each key

    def seal(self, key: str, message: Message, data: bytes | None) -> Repeat | None:
        """Return the signed form of a publication.

        None: it is no latched state of its agents, it is a stop, or it was signed lately.
        """
        if not isinstance(message, Latched) or isinstance(message, Stop):
            return None
        if key != service_of(type(message)).key_for(instance=key.rpartition("/")[2]):
            return None  # the copy for agents of an older protocol
        payload = encoded(message) if data is None else data
        before, now = self._sealed.get(key), int(self._wall())
        if before is not None and before.payload == payload and before.until > now + LIFE_S / 2:
            return None
        bare = Repeat(key, payload, self._author, now + LIFE_S)
        found = self._sealed[key] = replace(bare, signature=self._door.sign(bare.signed))
        return found

    def fault(self, repeat: Repeat) -> str:
        """Return why a repeated state does not count; "" if it does."""
        agents = repeat.author.split("+")
        if repeat.publisher in agents or agent_of(repeat.publisher) not in agents:
            return "it is not signed by its author"
        if repeat.until < self._wall():
            return "its signature has expired"
        names = [name_of(agents), *([ROBOT] if ROBOT in agents else [])]
        if any(self._door.verify(name, repeat.signed, repeat.signature) for name in names):
            return ""
        return "it is not signed by its author, by a key that counts"
