"""The porter: holds the TLS port of a robot's router, in a process of its own.

It admits clients on other computers by their certificates and hands their bytes to the router's
Unix socket. There they log in with their names and passwords, as clients on the robot's computer
do, so the router has one kind of identity.

Zenoh's own TLS listener (1.10.2) sleeps 100 ms after each failed handshake (zenoh issue 2685), so a
stranger who opens 20 connections per second keeps every newcomer out. It reads its certificate
once, knows no revocation, and does not report a failed handshake.

A connection is first a `Newcomer`. The lobby (`armadico.keys.lobby`) says whose handshake begins
next, and `armadico.keys.admission` whom the files of keys admit. Then it is a `Link`
(`armadico.keys.link`), until its certificate expires or its name is revoked. A link lives as long
as the newest certificate that its name has shown from the same address, so a renewed one needs no
new link: its process connects anew, introduces itself, and leaves.
"""

from __future__ import annotations

import errno
import json
import logging
import re
import selectors
import socket
import ssl
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.keys.admission import NO_TLS, Admission, failure, introduced
from armadico.keys.asking import RENEWAL
from armadico.keys.expiry import LINKS
from armadico.keys.link import FLOWS, Link
from armadico.keys.lobby import Lobby
from armadico.keys.store import Store
from armadico.mesh.sources import source_of

logger = logging.getLogger("armadico.keys")

LOOK_S: Final = 0.5
"""Period of looking for changed files and for links whose certificate has expired, s."""

FLUSH_S: Final = 1.0
"""How long a link that ends may take for its last bytes, s."""

SILENT_S: Final = 3.0
"""A client that was admitted and sends nothing for so long is turned away, s."""

ROUTER_S: Final = 0.02
"""Period of looking for the router while clients wait for it, s: it is away while it reopens."""

LINKS_OF_A_NAME: Final = 32
"""Links of one identity. A process has one; a person may have several commands open."""

REPORT_S: Final = 5.0
"""Shortest time between two reports of connections that were turned away, s."""

KINDS: Final = 20
"""Most lines of one report; each is an address and a reason."""

HELLO: Final = re.compile(rb"\x16\x03[\x00-\x04]..\x01", re.DOTALL)
"""How a TLS client begins: a record of the handshake, with a `ClientHello` (RFC 8446, 5.1)."""

HELLO_SIZE: Final = 4096
"""Bytes of it in which a wish for a new certificate is looked for."""

ACCEPTS: Final = 32
"""Most connections that are accepted in one turn."""


@dataclass(eq=False, slots=True)
class Newcomer:
    """A connection that has not introduced itself."""

    outer: socket.socket  # the connection; with TLS once its handshake has begun
    peer: str  # its address
    asks: bool = False  # it asks for a new certificate, and gets nothing else


class Porter:
    """Admits clients on listening sockets, and passes on what they and the router send."""

    def __init__(
        self,
        listening: Sequence[socket.socket],
        namespace: str,
        store: Store,
        router: Path,
    ) -> None:
        """Accept connections on `listening`. Raises ConfigError if the keys cannot be used."""
        self._router = router
        self._links_file = router.with_suffix(LINKS)
        self._listed: list[tuple[str, float, float]] = []
        self._selector = selectors.DefaultSelector()
        self._lobby = Lobby[Newcomer]()
        self._links: set[Link] = set()
        self._unserved: set[Link] = set()  # they wait for the router
        self._again: set[Link] = set()  # they may have more to read, without an event
        self._admission = Admission(namespace, store)
        self._turned_away = Counter[tuple[str, str]]()
        self._reported_at = time.monotonic()
        for each in listening:
            each.setblocking(False)
            self._selector.register(each, selectors.EVENT_READ, each)

    def prefer(self, hosts: Sequence[str]) -> None:
        """Serve the addresses of hosts before others; may be called from another thread.

        A name is looked up, which may take seconds; one that is not known now is left out.
        """
        for host in hosts:
            with suppress(OSError):
                found = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)
                self._lobby.named |= {source_of(str(address[0])) for *_, address in found}

    def run(self, over: int, alive: Callable[[], object] = lambda: None) -> None:
        """Serve until the other end of a descriptor is closed; `alive` is called each `LOOK_S`."""
        self._selector.register(over, selectors.EVENT_READ)
        look_at = 0.0
        while True:
            now = time.monotonic()
            if now >= look_at:
                look_at = now + LOOK_S
                self._look(now)
                alive()
            wait, due = look_at - now, self._lobby.due(now)
            wait = wait if due is None else min(wait, due)
            wait = min(wait, ROUTER_S) if self._unserved else wait
            events = self._selector.select(0.0 if self._again else wait)
            if any(key.fd == over for key, _ in events):
                return
            # What robots and their clients send comes before newcomers.
            for link in self._again | self._unserved:
                self._do(link, link.pass_inward)
            for key, mask in events:
                if isinstance(key.data, Link):
                    self._on_link(key.data, key.fd, mask)
            for key, _ in events:
                if isinstance(key.data, socket.socket):
                    self._accept(key.data)
                elif isinstance(key.data, Newcomer):
                    self._on_newcomer(key.data)
            now = time.monotonic()
            for newcomer in self._lobby.late(now):
                self._turn_away(newcomer, "did not introduce itself in time")
            begins = self._lobby.next(now)  # one in each turn: a handshake takes a millisecond
            if begins is not None:
                self._begin(begins)

    def close(self) -> None:
        for link in tuple(self._links):
            self._drop(link)
        for newcomer in tuple(self._lobby.waiting):
            self._dismiss(newcomer)
        self._selector.close()
        self._links_file.unlink(missing_ok=True)

    # Newcomers -----------------------------------------------------------------------------------

    def _accept(self, listening: socket.socket) -> None:
        for _ in range(ACCEPTS):
            try:
                outer, address = listening.accept()
            except BlockingIOError:
                return
            except OSError as error:  # too many open files, or the client has gone already
                if error.errno in (errno.EMFILE, errno.ENFILE) and self._lobby.waiting:
                    self._turn_away(next(iter(self._lobby.waiting)), "made room for others")
                    continue
                return
            outer.setblocking(False)
            outer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            newcomer = Newcomer(outer, str(address[0]))
            self._watch(outer, selectors.EVENT_READ, newcomer)
            source = source_of(newcomer.peer)
            crowded_out = self._lobby.enter(newcomer, source, time.monotonic())
            if crowded_out is not None:
                self._turn_away(crowded_out, "did not introduce itself, and made room for others")

    def _on_newcomer(self, newcomer: Newcomer) -> None:
        outer = newcomer.outer
        if newcomer not in self._lobby.waiting:  # it was turned away in this turn
            return
        if isinstance(outer, ssl.SSLSocket):
            self._shake_hands(newcomer, outer)
            return
        self._watch(outer, 0, newcomer)  # until it is its turn
        begin = _begin_of(outer)
        if not begin:  # it only tried whether something listens
            self._dismiss(newcomer)
        elif not HELLO.match(begin):  # refused before it costs a handshake
            self._turn_away(newcomer, NO_TLS)
        else:
            self._lobby.ready(newcomer)

    def _begin(self, newcomer: Newcomer) -> None:
        """Begin a connection's handshake."""
        newcomer.asks = RENEWAL.encode() in _begin_of(newcomer.outer, HELLO_SIZE)
        context = self._admission.lenient if newcomer.asks else self._admission.context
        try:
            newcomer.outer = outer = context.wrap_socket(
                newcomer.outer, server_side=True, do_handshake_on_connect=False
            )
        except OSError:  # the client has gone
            self._turn_away(newcomer, "ended its connection before it introduced itself")
            return
        self._shake_hands(newcomer, outer)

    def _shake_hands(self, newcomer: Newcomer, outer: ssl.SSLSocket) -> None:
        """Continue a connection's handshake, and admit it at the end."""
        try:
            outer.do_handshake()
        except ssl.SSLWantReadError:
            self._watch(outer, selectors.EVENT_READ, newcomer)
        except ssl.SSLWantWriteError:
            self._watch(outer, selectors.EVENT_WRITE, newcomer)
        except OSError as error:
            self._turn_away(newcomer, failure(error))
        else:
            self._lobby.introduced(newcomer, time.monotonic())
            self._admit(newcomer, outer)

    def _admit(self, newcomer: Newcomer, outer: ssl.SSLSocket) -> None:
        name, valid = introduced(outer)
        if why := self._admission.refusal(name) or self._crowd(name):
            self._turn_away(newcomer, why)
            return
        # By the monotonic clock from here on: a step of the wall clock ends no link.
        now = time.monotonic()
        ends, announced = now + valid.ends - time.time(), valid.ends - valid.announce_at
        link = Link(name, newcomer.peer, outer, self._router, now, ends, announced)
        self._links.add(link)
        if newcomer.asks:
            link.outward += self._admission.renewal(outer, now - ends)
            link.end()
            self._do(link, link.flush)
            return
        for other in self._links:
            if (other.name, other.peer) == (name, link.peer):
                other.ends = max(other.ends, ends)
                other.announced = min(other.announced, announced)
        self._do(link, link.pass_inward)

    def _crowd(self, name: str) -> str:
        count = sum(link.name == name for link in self._links)
        return f"{name} has {count} links already" if count >= LINKS_OF_A_NAME else ""

    def _turn_away(self, newcomer: Newcomer, why: str) -> None:
        """Close a connection that was not admitted, and count it."""
        kind: tuple[str, str] = newcomer.peer, why
        if kind not in self._turned_away and len(self._turned_away) >= KINDS:
            kind = "others", "several reasons"
        self._turned_away[kind] += 1
        self._dismiss(newcomer)

    def _dismiss(self, newcomer: Newcomer) -> None:
        self._lobby.leave(newcomer)
        self._watch(newcomer.outer, 0, newcomer)
        newcomer.outer.close()

    # Links ---------------------------------------------------------------------------------------

    def _on_link(self, link: Link, fd: int, mask: int) -> None:
        if mask & selectors.EVENT_READ:
            outer = fd == link.outer.fileno()
            self._do(link, link.pass_inward if outer else link.pass_outward)
        if mask & selectors.EVENT_WRITE:
            self._do(link, link.flush)

    def _do(self, link: Link, step: Callable[[], None]) -> None:
        """Do a step of a link, and wait for what it needs next; a link that fails is dropped."""
        if link not in self._links:  # it was dropped in this turn
            return
        try:
            step()
        except OSError as error:
            logger.debug("the link of %s from %s: %s", link.name, link.peer, error)
            self._drop(link)
            return
        events = link.events
        if events is FLOWS and link.watched is FLOWS and not (link.has_more or self._again):
            return
        if link.is_over:
            self._drop(link)
            return
        (self._again.add if link.has_more else self._again.discard)(link)
        (self._unserved.add if link.is_unserved else self._unserved.discard)(link)
        if events != link.watched:
            link.watched = events
            for end, of_end in zip(link.sockets, events, strict=False):  # the router's may be none
                self._watch(end, of_end, link)

    def _drop(self, link: Link) -> None:
        for links in (self._links, self._again, self._unserved):
            links.discard(link)
        for end in link.sockets:
            self._watch(end, 0, link)
            end.close()

    def _watch(self, end: socket.socket, events: int, of: Newcomer | Link) -> None:
        """Wait for events of one end of a connection, and for no others of it."""
        key = self._selector.get_map().get(end) if end.fileno() >= 0 else None
        if key is None:
            if events:
                self._selector.register(end.fileno(), events, of)
        elif not events:
            self._selector.unregister(key.fd)
        elif (key.events, key.data) != (events, of):
            self._selector.modify(key.fd, events, of)

    # Looking after them ---------------------------------------------------------------------------

    def _look(self, now: float) -> None:
        """Read changed files, and end the links that are no longer allowed."""
        changed = self._admission.look()
        for link in tuple(self._links):
            if link.closing is not None:
                if now - link.closing >= FLUSH_S:
                    self._drop(link)
            elif changed and (why := self._admission.refusal(link.name)):
                logger.warning("the link of %s from %s is closed: %s", link.name, link.peer, why)
                self._drop(link)
            elif now >= link.ends:
                logger.warning(
                    "the link of %s from %s is closed: its certificate has expired, and it has"
                    " shown no newer one; `armadico keys renew %s` makes one",
                    link.name,
                    link.peer,
                    link.name.rpartition("/")[2].partition("@")[0],
                )
                self._do(link, link.expire)
            elif link.inner is None and now - link.since >= SILENT_S:
                self._drop(link)
        self._list(now)
        if now - self._reported_at >= REPORT_S:
            for (peer, why), count in sorted(self._turned_away.items()):
                took = now - self._reported_at
                text = "refused %d connections of %s in %.0f s: %s"
                logger.warning(text, count, peer, took, why)
            self._turned_away.clear()
            self._reported_at = now

    def _list(self, now: float) -> None:
        """Write when the links end, if that has changed, for the diagnosis (`LINKS`)."""
        ends = sorted((link.name, link.ends, link.announced) for link in self._links)
        if ends == self._listed:
            return
        self._listed = ends
        wall = time.time() - now
        rows = [(name, at + wall, at + wall - before) for name, at, before in ends]
        new = self._links_file.with_suffix(f"{LINKS}-new")
        with suppress(OSError):  # a full disk
            new.write_text(json.dumps(rows), encoding="utf-8")
            new.replace(self._links_file)


def _begin_of(end: socket.socket, size: int = 6) -> bytes:
    """Return the first bytes that a connection brings, and leave them there; b"" if it is over."""
    try:
        return end.recv(size, socket.MSG_PEEK)
    except OSError:
        return b""
