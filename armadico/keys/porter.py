"""The porter: a process that holds the TLS port of a robot's router.

The robot agent starts it, with the listening socket. It admits clients on other computers by their
certificates and hands their bytes to the router's Unix socket. There they log in with their names
and passwords, as clients on the robot's computer do, so the router has one kind of identity.

Zenoh's own TLS listener (1.10.2) sleeps 100 ms after each failed handshake (zenoh issue 2685), so a
stranger who opens 20 connections per second keeps every newcomer out. It reads its certificate
once, knows no revocation, and does not report a failed handshake. The porter

- serves first what has introduced itself, and rations handshakes by source (`armadico.keys.lobby`);
- reads its own certificate and the list of members again when their files change;
- closes a link when its certificate expires or its name is revoked. A link lives as long as the
  newest certificate that its name has shown from the same address, so a renewed one needs no new
  link: its process connects anew, introduces itself, and leaves;
- issues a new certificate for the key of a present or expired one (`armadico.keys.asking`), if the
  authority's key is on this computer.

It ends when its standard input is closed, which happens when the robot agent ends. To show that it
does not hang it writes to its standard output.
"""

from __future__ import annotations

import errno
import gc
import importlib
import json
import logging
import os
import re
import resource
import selectors
import signal
import socket
import ssl
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from typing import Any, Final, cast

from armadico.core.config_errors import ConfigError
from armadico.keys.asking import LINKS, RENEWAL, Validity
from armadico.keys.lobby import Lobby, source_of
from armadico.keys.store import MEMBERS, Store, admits, stamp
from armadico.mesh.door import ROBOT

logger = logging.getLogger("armadico.keys")

CHUNK: Final = 65_536
"""Most bytes of one read, which is Zenoh's largest batch."""

LARGEST: Final = 262_144
"""Bytes that wait for one end of a link. Beyond them nothing is read from its other end."""

TURNS: Final = 4
"""Most reads of one link before the others get their turn."""

LOOK_S: Final = 0.5
"""Period of looking for changed files and for links whose certificate has expired, s."""

FLUSH_S: Final = 1.0
"""How long a link that ends may take for its last bytes, s."""

SILENT_S: Final = 3.0
"""A client that was admitted and sends nothing for so long is turned away, s."""

EXPIRED_S: Final = 30 * 86_400.0
"""A certificate that expired longer ago is not renewed, s."""

NO_CHECK_TIME: Final = 0x200000
"""OpenSSL's X509_V_FLAG_NO_CHECK_TIME, which `ssl` does not name."""

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
class Link:
    """A connection of a client, and the one to the router that is made for it.

    Attributes:
        outer: The connection; from the begin of the handshake on with TLS.
        peer: Its address.
        source: What its ration is counted by.
        asks: It asks for a new certificate, and gets nothing else.
        name: Its identity, once it is admitted.
        since: When it was accepted or admitted, s.
        ends: When its certificate expires, s.
        announced: How long before that it is announced, s.
        inner: The connection to the router, once the client has sent something.
        inward, outward: Bytes that wait for the router, and for the client.
        closing: Since when it only sends what waits, s; None: it is open.
        is_plain: Both ends are only read, which is nearly always so.
    """

    outer: socket.socket
    peer: str
    source: str
    since: float
    asks: bool = False
    name: str = ""
    ends: float = inf
    announced: float = 0.0
    inner: socket.socket | None = None
    inward: bytearray = field(default_factory=bytearray)
    outward: bytearray = field(default_factory=bytearray)
    closing: float | None = None
    is_plain: bool = False

    @property
    def ends_of_it(self) -> Iterator[socket.socket]:
        yield self.outer
        if self.inner is not None:
            yield self.inner


class Porter:
    """Admits clients on listening sockets, and passes on what they and the router send."""

    def __init__(
        self,
        listening: Sequence[socket.socket],
        namespace: str,
        store: Store,
        router: Path,
    ) -> None:
        """Begin.

        Args:
            listening: The sockets to accept connections on.
            namespace: The robot's.
            store: The keys of this computer.
            router: The router's socket.

        Raises ConfigError if the keys cannot be used.
        """
        self._router = router
        self._links_file = router.with_suffix(LINKS)
        self._listed: set[tuple[str, float, float]] = set()
        self._selector = selectors.DefaultSelector()
        self._lobby = Lobby[Link]()
        self._links: set[Link] = set()
        self._again: set[Link] = set()  # they may have more to read, without an event
        self._unserved: set[Link] = set()  # they wait for the router
        self._files = Files(namespace, store)
        self._turned_away = Counter[tuple[str, str]]()
        self._reported_at = time.monotonic()
        for each in listening:
            each.setblocking(False)
            self._selector.register(each, selectors.EVENT_READ)

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
            again, self._again = self._again, set()
            for link in again | self._unserved:
                self._guarded(link, self._pass_inward)
            news: list[tuple[selectors.SelectorKey, int]] = []
            for key, mask in events:
                link = key.data
                if link is None or not link.name:
                    news.append((key, mask))
                elif link in self._links:  # it was not dropped in this turn
                    self._on_event(link, key.fd, mask)
            for key, _ in news:
                self._on_newcomer(key)
            now = time.monotonic()
            for link in self._lobby.late(now):
                self._turn_away(link, "did not introduce itself in time")
            begins = self._lobby.next(now)  # one in each turn: a handshake takes a millisecond
            if begins is not None:
                self._begin(begins)

    def close(self) -> None:
        for link in (*self._links, *self._lobby.waiting):
            self._drop(link)
        self._selector.close()
        self._links_file.unlink(missing_ok=True)

    # Newcomers -----------------------------------------------------------------------------------

    def _on_newcomer(self, key: selectors.SelectorKey) -> None:
        link = key.data
        if link is None:
            assert isinstance(key.fileobj, socket.socket), "the other one ends the turn"
            self._accept(key.fileobj)
        elif isinstance(link.outer, ssl.SSLSocket):
            self._shake_hands(link)
        elif link in self._lobby.waiting:
            self._watch(link.outer, 0, link)  # until it is its turn
            begin = _begin_of(link.outer)
            if not begin:  # it only tried whether something listens
                self._drop(link)
            elif not HELLO.match(begin):  # refused before it costs a handshake
                self._turn_away(link, REASONS["WRONG_VERSION_NUMBER"])
            else:
                self._lobby.ready(link)

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
            link = Link(outer, str(address[0]), source_of(address[0]), time.monotonic())
            self._watch(outer, selectors.EVENT_READ, link)
            crowded_out = self._lobby.enter(link, link.source, link.since)
            if crowded_out is not None:
                self._turn_away(crowded_out, "did not introduce itself, and made room for others")

    def _begin(self, link: Link) -> None:
        """Begin a connection's handshake."""
        link.asks = RENEWAL.encode() in _begin_of(link.outer, HELLO_SIZE)
        context = self._files.lenient if link.asks else self._files.context
        try:
            link.outer = context.wrap_socket(
                link.outer, server_side=True, do_handshake_on_connect=False
            )
        except OSError:  # the client has gone
            self._turn_away(link, "ended its connection before it introduced itself")
            return
        self._shake_hands(link)

    def _shake_hands(self, link: Link) -> None:
        """Continue a connection's handshake, and admit it at the end."""
        outer = link.outer
        assert isinstance(outer, ssl.SSLSocket), "it has begun"
        try:
            outer.do_handshake()
        except ssl.SSLWantReadError:
            self._watch(outer, selectors.EVENT_READ, link)
        except ssl.SSLWantWriteError:
            self._watch(outer, selectors.EVENT_WRITE, link)
        except OSError as error:
            self._turn_away(link, failure(error))
        else:
            self._lobby.introduced(link)
            self._admit(link, outer)

    def _admit(self, link: Link, outer: ssl.SSLSocket) -> None:
        found = cast("dict[str, Any]", outer.getpeercert())
        names = [value for part in found["subject"] for key, value in part if key == "commonName"]
        name = str(names[0]) if len(names) == 1 else ""  # several would be several identities
        if why := self._files.refusal(name) or self._crowd(name):
            self._turn_away(link, why)
            return
        link.name, link.since = name, time.monotonic()
        # By the monotonic clock from here on: a step of the wall clock ends no link.
        valid = Validity(*(ssl.cert_time_to_seconds(found[e]) for e in ("notBefore", "notAfter")))
        link.ends = link.since + valid.ends - time.time()
        link.announced = valid.ends - valid.announce_at
        self._links.add(link)
        if link.asks:
            link.outward += self._files.renewed(outer, link.since - link.ends)
            self._end(link)
            self._guarded(link, self._flush)
            return
        for other in self._links:
            if (other.name, other.peer) == (name, link.peer):
                other.ends = max(other.ends, link.ends)
                other.announced = min(other.announced, link.announced)
        self._guarded(link, self._pass_inward)

    def _crowd(self, name: str) -> str:
        count = sum(link.name == name for link in self._links)
        return f"{name} has {count} links already" if count >= LINKS_OF_A_NAME else ""

    def _turn_away(self, link: Link, why: str) -> None:
        """Close a connection that was not admitted, and count it."""
        kind: tuple[str, str] = link.peer, why
        if kind not in self._turned_away and len(self._turned_away) >= KINDS:
            kind = "others", "several reasons"
        self._turned_away[kind] += 1
        self._drop(link)

    # Links ---------------------------------------------------------------------------------------

    def _on_event(self, link: Link, fd: int, mask: int) -> None:
        outer = fd == link.outer.fileno()
        if mask & selectors.EVENT_READ:
            self._guarded(link, self._pass_inward if outer else self._pass_outward)
        if mask & selectors.EVENT_WRITE and link in self._links:
            self._guarded(link, self._flush)

    def _guarded(self, link: Link, step: Callable[[Link], None]) -> None:
        """Do a step of a link, and wait for what it needs next; a link that fails is dropped."""
        if link not in self._links:
            return
        try:
            step(link)
        except OSError as error:
            logger.debug("the link of %s from %s: %s", link.name, link.peer, error)
            self._drop(link)
            return
        if link.closing is not None and not (link.inward or link.outward):
            self._drop(link)
            return
        is_open = link.closing is None and link not in self._unserved
        plain = is_open and link.inner is not None and not (link.inward or link.outward)
        if plain and link.is_plain:
            return
        link.is_plain = plain
        self._watch(link.outer, _interest(is_open, link.inward, link.outward), link)
        if link.inner is not None:
            self._watch(link.inner, _interest(is_open, link.outward, link.inward), link)

    def _pass_inward(self, link: Link) -> None:
        """Pass on what a client has sent."""
        outer = link.outer
        assert isinstance(outer, ssl.SSLSocket), "it was admitted"
        if link in self._unserved and not self._serve(link):
            return
        for _ in range(TURNS):
            if link.closing is not None or len(link.inward) >= LARGEST:
                return
            try:
                data = outer.recv(CHUNK)
            except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
                return
            if not data:
                self._end(link)
                return
            if link.inner is not None:
                _send(link.inner, link.inward, data)
            else:
                link.inward += data
                if not self._serve(link):
                    return
            if not outer.pending():  # else no event may come for the rest
                return
        self._again.add(link)

    def _pass_outward(self, link: Link) -> None:
        """Pass on what the router has sent."""
        assert link.inner is not None, "an event came from it"
        if link.closing is not None or len(link.outward) >= LARGEST:
            return
        with suppress(BlockingIOError):
            data = link.inner.recv(CHUNK)
            if data:
                _send(link.outer, link.outward, data)
            else:
                self._end(link)

    def _flush(self, link: Link) -> None:
        """Send what waits."""
        _send(link.outer, link.outward)
        if link.inner is not None:
            _send(link.inner, link.inward)

    def _serve(self, link: Link) -> bool:
        """Connect a link to the router, and pass on what waits; return whether there is one."""
        inner = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        inner.setblocking(False)
        try:
            inner.connect(str(self._router))
        except OSError:
            inner.close()
            self._unserved.add(link)
            return False
        self._unserved.discard(link)
        link.inner = inner
        _send(inner, link.inward)
        return True

    def _end(self, link: Link) -> None:
        """Let a link only send what waits."""
        if link.closing is None:
            link.closing = time.monotonic()

    def _drop(self, link: Link) -> None:
        self._lobby.leave(link)
        self._links.discard(link)
        self._again.discard(link)
        self._unserved.discard(link)
        for end in link.ends_of_it:
            self._watch(end, 0, link)
            end.close()

    def _watch(self, end: socket.socket, events: int, link: Link) -> None:
        """Wait for events of one end of a link, and for no others of it."""
        key = self._selector.get_map().get(end) if end.fileno() >= 0 else None
        if key is None:
            if events:
                self._selector.register(end.fileno(), events, link)
        elif not events:
            self._selector.unregister(key.fd)
        elif key.events != events:
            self._selector.modify(key.fd, events, link)

    # Looking after them ---------------------------------------------------------------------------

    def _look(self, now: float) -> None:
        """Read changed files, and end the links that are no longer allowed."""
        changed = self._files.look()
        for link in tuple(self._links):
            if link.closing is not None:
                if now - link.closing >= FLUSH_S:
                    self._drop(link)
            elif changed and (why := self._files.refusal(link.name)):
                logger.warning("the link of %s from %s is closed: %s", link.name, link.peer, why)
                self._drop(link)
            elif now >= link.ends:
                logger.warning(
                    "the link of %s from %s is closed: its certificate has expired, and it has"
                    " shown no newer one; `armadico keys renew %s` makes one",
                    link.name,
                    link.peer,
                    link.name.rpartition("/")[2],
                )
                self._guarded(link, self._pass_inward)  # a stop may be among it
                self._end(link)
                self._guarded(link, self._flush)
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
        ends = {(link.name, link.ends, link.announced) for link in self._links}
        if ends == self._listed:
            return
        self._listed = ends
        wall = time.time() - now
        rows = [(name, at + wall, at + wall - before) for name, at, before in sorted(ends)]
        new = self._links_file.with_suffix(f"{LINKS}-new")
        with suppress(OSError):  # a full disk
            new.write_text(json.dumps(rows), encoding="utf-8")
            new.replace(self._links_file)


class Files:
    """The keys that the porter uses, as its files have them now.

    Attributes:
        context: What a handshake is made with.
        lenient: The same for a client that asks for a new certificate: also with an expired one.
    """

    def __init__(self, namespace: str, store: Store) -> None:
        """Read them. Raises ConfigError."""
        self._namespace, self._store = namespace, store
        self._own = store.checked(namespace, ROBOT)
        self._seen: object = None
        self._names: frozenset[str] = frozenset()
        self._revoked: frozenset[str] = frozenset()
        self._read()

    def look(self) -> bool:
        """Read changed files; return whether there were any. Files that fail change nothing."""
        if self._stamp() == self._seen:
            return False
        try:
            self._read()
        except ConfigError as error:
            logger.error("the keys of before stay in use: %s", error)
            return False
        return True

    def refusal(self, name: str) -> str:
        """Why an identity is not admitted; "" if it is."""
        if name in self._names:
            return ""
        if name in self._revoked:
            return f"{name} is revoked"
        if not name:
            return "its certificate has no common name"
        return f"{name} is no member of {self._namespace}"

    def _stamp(self) -> list[object]:
        store, own = self._store, self._own
        files = (store.authority, store.folder / MEMBERS, own.certificate, own.private)
        return [stamp(file) for file in files]

    def _read(self) -> None:
        self._seen = self._stamp()
        members = self._store.members().values()
        self.context, self.lenient = self._context(), self._context()
        self.lenient.verify_flags |= NO_CHECK_TIME
        self.lenient.set_alpn_protocols([RENEWAL])
        self._revoked = frozenset(each.name for each in members if each.revoked)
        self._names = frozenset(
            each.name for each in members if admits(each, self._namespace) and not each.revoked
        )

    def _context(self) -> ssl.SSLContext:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.verify_mode = ssl.CERT_REQUIRED
        context.num_tickets = 0  # a resumed session would not show its certificate
        path = self._store.authority
        try:
            context.load_verify_locations(path)
            path = self._own.certificate
            context.load_cert_chain(path, self._own.private)
        except OSError as error:
            why = getattr(error, "reason", None) or error.strerror
            raise ConfigError(f"cannot be used for TLS: {why}", path) from None
        return context

    def renewed(self, outer: ssl.SSLSocket, expired: float) -> bytes:
        """Return a new certificate for the key of a client's, PEM, or why there is none.

        `expired` is how long ago the client's one has expired, s; below 0, if it has not.
        """
        der = outer.getpeercert(binary_form=True)
        if outer.selected_alpn_protocol() != RENEWAL or der is None:
            return b""
        if expired > EXPIRED_S:
            return b"it expired more than 30 days ago: `armadico keys host` makes new keys"
        if not self._store.issues:
            return (
                b"the authority's key is not on the robot's computer: run `armadico keys host` on"
                b" the one that has it"
            )
        from armadico.keys.authority import KeyFileError
        from armadico.keys.issuing import Issuer

        present = ssl.DER_cert_to_PEM_cert(der).encode()
        try:
            return Issuer.of(self._store).again(present, datetime.now(UTC))
        except (ConfigError, KeyFileError) as error:
            return str(error).encode()


def failure(error: OSError) -> str:
    """Return why a handshake failed, for people."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return CERTIFICATES.get(error.verify_code, error.verify_message)
    if isinstance(error, ssl.SSLError):
        reason = str(error.reason)
        return REASONS.get(reason, reason.lower().replace("_", " "))
    return "ended its connection within the handshake"


CERTIFICATES: Final = {
    9: "its certificate is not valid yet: one of the two clocks is wrong",
    10: "its certificate has expired, or one of the two clocks is wrong",
    18: "its certificate was not issued by this lab's authority",
    19: "its certificate was not issued by this lab's authority",
    20: "its certificate was not issued by this lab's authority",
    21: "its certificate was not issued by this lab's authority",
    7: "its certificate was not issued by this lab's authority",
}
"""By OpenSSL's codes (x509_vfy.h)."""

REASONS: Final = {
    "PEER_DID_NOT_RETURN_A_CERTIFICATE": "has no certificate",
    "WRONG_VERSION_NUMBER": "does not use TLS",
    "HTTP_REQUEST": "does not use TLS",
    "UNEXPECTED_EOF_WHILE_READING": "ended its connection within the handshake",
    "TLSV1_ALERT_UNKNOWN_CA": "does not know this lab's authority",
    "SSLV3_ALERT_CERTIFICATE_EXPIRED": "takes the robot's certificate for expired",
    "SSLV3_ALERT_BAD_CERTIFICATE": "does not accept the robot's certificate",
    "SSLV3_ALERT_CERTIFICATE_UNKNOWN": "does not accept the robot's certificate",
}


def _interest(is_open: bool, unsent: bytearray, waiting: bytearray) -> int:
    """The events of one end: to read unless too much is `unsent`, to write what is `waiting`."""
    reads = selectors.EVENT_READ if is_open and len(unsent) < LARGEST else 0
    return reads | (selectors.EVENT_WRITE if waiting else 0)


def _send(end: socket.socket, waiting: bytearray, data: bytes = b"") -> None:
    """Send what is waiting, and then `data`; what does not fit waits."""
    if waiting:
        waiting += data
        data = bytes(waiting)
        waiting.clear()
    sent = 0
    if data:
        with suppress(BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            sent = end.send(data)
    if sent < len(data):
        waiting += data[sent:]


def _begin_of(end: socket.socket, size: int = 6) -> bytes:
    """Return the first bytes that a connection brings, and leave them there; b"" if it is over."""
    try:
        return end.recv(size, socket.MSG_PEEK)
    except OSError:
        return b""


def main(folder: str, namespace: str, router: str, named: str, *listening: str) -> int:
    """Serve on listening sockets, by their descriptors, until standard input is closed.

    `named` are the hosts of the table, with blanks between.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the robot agent decides
    logging.basicConfig(
        level=logging.INFO,
        stream=sys.stderr,
        format="%(asctime)s.%(msecs)03d porter %(levelname)s %(message)s",
        datefmt="%H:%M:%S",
    )
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    ends = [socket.socket(fileno=int(each)) for each in listening]
    store = Store(Path(folder))
    if store.issues:  # importing it later would hold up the links
        importlib.import_module("armadico.keys.issuing")
    try:
        porter = Porter(ends, namespace, store, Path(router))
    except ConfigError as error:
        logger.error("%s", error)
        return 2
    threading.Thread(target=porter.prefer, args=(named.split(),), daemon=True).start()
    gc.collect()
    gc.freeze()
    beat = sys.stdout.fileno()
    os.set_blocking(beat, False)

    def alive() -> None:
        with suppress(BlockingIOError):  # the robot agent is paused
            os.write(beat, b".")

    porter.run(sys.stdin.fileno(), alive)
    porter.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
