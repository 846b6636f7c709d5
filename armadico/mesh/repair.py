"""What Zenoh leaves undone when links are lost: two ways in which processes stay apart for good.

*All seeds are gone.* Processes that have no well-known endpoint know one another by gossip alone.
When all who had one have ended (another society on this machine, say), the rest keep their links,
but whoever loses them then knows nobody's address. So one of them takes an endpoint that is free.

*One link is gone.* Zenoh renews links to the endpoints that it was told, not those that gossip led
to: it waits for news of the other one, which come when that one links to a seed again. Whoever hung
for about the lease has linked to the seeds again before it loses the last of its other links, and
no news come any more (measured: after hangs of 0.9 s, one in 18). News are made by a session that
joins for a moment: whoever links to it is gossiped to those that have done so already. The one that
has to connect must be among these, which is a matter of luck; so it is done again until it works.
"""

from __future__ import annotations

import logging
import random
import socket
from collections.abc import Collection, Sequence
from threading import Event, Lock, Timer
from typing import Final, Protocol

from armadico.mesh.topology import ENDPOINTS_VARIABLE

logger = logging.getLogger("armadico.mesh")

LOOK_S: Final = (2.0, 4.0)
"""How long after a loss to look whether something is left to do: what Zenoh does itself it has done
by then, and whoever had a well-known endpoint may be back. Drawn, or all would look at once."""

LOOKS: Final = 3
"""How often to look for one that is there, or is cut off, and is not met; twice as late each time.
A cut that lasts longer ends with new links to seeds, so with news."""

INTRODUCTIONS: Final = 5
"""Of which each brings two together with even odds."""

MEET_S: Final = 0.3
"""How long an introduction lasts, unless both have met before; 0.02 s are usual."""

ALONE_S: Final = 4.0
"""A process that has no well-known endpoint and no link after this has nobody to find there."""

PROBE_S: Final = 0.5
"""How long somebody may take to accept a connection."""


class Beside(Protocol):
    """Another session of this process, that says and hears nothing."""

    def met(self) -> set[str]:
        """The ids of those that it has a link with."""
        ...

    def close(self) -> None:
        """Leave. It may take some seconds."""
        ...


class Sessions(Protocol):
    """What is asked of the mesh."""

    def met(self) -> set[str]:
        """The ids of those that it has a link with."""
        ...

    def open_beside(self, listen: tuple[str, ...] | None) -> Beside | None:
        """Open one that listens there, or at a free port; None if somebody else does."""
        ...


class Repair:
    """Looks a while after links were lost, on a thread of its own."""

    def __init__(
        self, sessions: Sessions, told: Collection[str], vacant: Sequence[tuple[str, ...]]
    ) -> None:
        """Nothing is lost yet.

        Args:
            sessions: The mesh.
            told: Endpoints that Zenoh was told to connect to: it goes on trying by itself.
            vacant: Those to take when they are free; none for who has one, or passes.
        """
        self._sessions = sessions
        self._told = told
        self._vacant = vacant
        self._lock = Lock()  # while it looks
        self._lost: dict[str, tuple[str, int]] = {}
        self._timer: Timer | None = None
        self._over = Event()
        self._stands_in: Beside | None = None
        self._first: Timer | None = None

    def begin(self) -> None:
        """See, after a while, that somebody is there if no well-known endpoint was free."""
        if self._vacant:
            self._first = Timer(ALONE_S, self._look_alone)
            self._first.daemon = True
            self._first.start()

    def lost(self, peer: str, endpoint: str) -> None:
        """A link is gone, to `peer` at `endpoint`. On any thread; returns at once."""
        if endpoint not in self._told:
            self._lost[peer] = (endpoint, 0)
        self._look_in(1.0)

    def close(self) -> None:
        """Give back what was taken, before the mesh's own session is closed."""
        self._over.set()
        if self._first is not None:
            self._first.cancel()
        with self._lock:
            if self._stands_in is not None:
                self._stands_in.close()

    def _look_in(self, times: float) -> None:
        if self._timer is None and not self._over.is_set():
            wait_s = times * random.SystemRandom().uniform(*LOOK_S)
            self._timer = Timer(wait_s, self._look)
            self._timer.daemon = True
            self._timer.start()

    def _look_alone(self) -> None:
        """Report that other programs have all well-known endpoints."""
        if self._over.is_set() or self._sessions.met():
            return
        self._look()
        if self._stands_in is None:
            logger.warning(
                "no process of a society answers at %s: another program has these ports;"
                " end it, or set %s to others for all processes of this robot",
                ", ".join(endpoint for endpoints in self._vacant for endpoint in endpoints),
                ENDPOINTS_VARIABLE,
            )

    def _look(self) -> None:
        self._timer = None  # what is lost from here on has another look
        with self._lock:
            self._stand_in()
            for peer in list(self._lost):
                endpoint, looks = self._lost.pop(peer)
                if peer not in self._sessions.met() and listens(endpoint):
                    self._introduce(peer)
                    if looks + 1 < LOOKS:  # and unless it was lost again meanwhile
                        self._lost.setdefault(peer, (endpoint, looks + 1))
        if self._lost:
            self._look_in(2.0 ** min(looks for _, looks in self._lost.values()))

    def _stand_in(self) -> None:
        for endpoints in self._vacant:
            if self._stands_in is None and not self._over.is_set():
                self._stands_in = self._sessions.open_beside(endpoints)

    def _introduce(self, peer: str) -> None:
        for _ in range(INTRODUCTIONS):
            session = self._sessions.open_beside(None)
            if session is None:
                return
            self._meet(peer)
            there = peer in session.met()  # else it hangs, or is cut off
            session.close()
            if not there or peer in self._sessions.met() or self._over.is_set():
                return

    def _meet(self, peer: str) -> None:
        step_s = 0.02
        for _ in range(round(MEET_S / step_s)):
            if peer in self._sessions.met() or self._over.wait(step_s):
                return


def listens(endpoint: str) -> bool:
    """Whether somebody may listen there: not where the machine says that nobody does.

    Only TCP tells; links of other kinds are left to Zenoh.
    """
    protocol, _, place = endpoint.partition("#")[0].partition("/")
    address, _, port = place.rpartition(":")
    if protocol not in ("tcp", "tls") or not port.isdecimal():
        return False
    try:
        socket.create_connection((address.strip("[]"), int(port)), PROBE_S).close()
    except ConnectionRefusedError:
        return False
    except OSError:  # cut off, perhaps
        return True
    return True
