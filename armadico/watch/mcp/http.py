"""Streamable HTTP for the MCP server: one POST is one message, on a thread of its own.

The page's guard checks access and its entrance limits floods; its own server cannot be shared,
since `websockets` reads no bodies. Each request needs the token; only `stop` does not.
"""

from __future__ import annotations

import queue
import select
import socket
import threading
import time
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final

from armadico.mesh.sources import Rations, source_of
from armadico.watch.mcp.lines import (
    INVALID,
    LONGEST,
    VERSION_HEADER,
    Call,
    Lines,
    is_notification,
    mismatch,
    named,
    refused,
    status_of,
)
from armadico.watch.mcp.server import STOP, Server
from armadico.watch.page.entrance import entrance
from armadico.watch.page.guard import Guard, bearer, is_loopback
from armadico.watch.page.places import Places

PATH: Final = "/mcp"

MOST: Final = 64  # connections at once; a new one displaces one without the token

# Connections that one source may open at once, and then per second; from this computer, any.
CONNECTIONS: Final = 200.0
CONNECTIONS_HZ: Final = 20.0

QUIET_S: Final = 15.0  # timeout of reading a request, and of a connection without one

LOOK_S: Final = 1.0  # how often it is checked that the client of a waiting call is still there

EVENTS: Final = "text/event-stream"

SESSION: Final = "Mcp-Session-Id"
"""It has the client's name, which versions with a handshake give once; the server keeps nothing."""


class Door(ThreadingHTTPServer):
    """A context manager that listens from its construction on."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, server: Server, guard: Guard, address: str, port: int, version: str) -> None:
        """Listen; port 0 selects a free one.

        The guard has a token; `version` is shown to clients. Raises OSError, OverflowError or
        UnicodeError if the address or the port cannot be used.
        """
        super().__init__((address, port), _Request, bind_and_activate=False)
        self.answering, self.guard, self.version = server, guard, version
        self._rations = Rations(CONNECTIONS_HZ, CONNECTIONS)
        self._places, self._placing = Places[socket.socket](MOST), threading.Lock()
        self.socket.close()
        self.socket = entrance(address, port, self._admits)
        self.socket.listen()
        self.port: int = self.socket.getsockname()[1]
        self._thread = threading.Thread(target=self.serve_forever, name="http", daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self.shutdown()
        self.server_close()

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of connections that break."""

    @contextmanager
    def place(self, connection: socket.socket, address: str) -> Iterator[None]:
        """Give a connection a place until it ends; the one that has to leave is closed."""
        self.rank(connection, address, 0)
        try:
            yield
        finally:
            with self._placing:
                self._places.leave(connection)

    def rank(self, connection: socket.socket, address: str, rank: int) -> None:
        """Let a connection have its place longer than those of a lower rank."""
        with self._placing:
            displaced = self._places.enter(connection, source_of(address), rank)
        if displaced is not None:
            with suppress(OSError):
                displaced.shutdown(socket.SHUT_RDWR)

    def _admits(self, address: str) -> bool:
        source = source_of(address)
        return is_loopback(source) or self._rations.take(source, time.monotonic())


class _Request(BaseHTTPRequestHandler):
    """One connection; its requests come one after the other."""

    protocol_version = "HTTP/1.1"
    timeout = QUIET_S
    server: Door

    def handle(self) -> None:
        with self.server.place(self.connection, str(self.client_address[0])):
            super().handle()

    def log_message(self, *_: object) -> None:
        """Requests are recorded by the assistant agent."""

    def version_string(self) -> str:
        return "armadico"

    def do_GET(self) -> None:
        """Nothing is sent that was not asked for, and there are no sessions to end."""
        self._refuse(405, "only POST is served", Allow="POST")

    do_PUT = do_DELETE = do_HEAD = do_OPTIONS = do_PATCH = do_GET  # noqa: N815 - http.server's

    def do_POST(self) -> None:
        data = self._checked()
        if data is None:
            return
        headers = {name.lower(): value for name, value in self._headers().items()}
        wrong = mismatch(data, headers)
        if wrong is not None:
            self._write(wrong, 400)
            return
        lines = Lines(self.server.version, _client(headers.get(SESSION.lower())))
        found = lines.receive(data)
        if not self._may(found):
            return
        match found:
            case Call():
                self._answer(found)
            case bytes():
                status = status_of(found, headers.get(VERSION_HEADER))
                session = {SESSION: _session(lines)} if lines.greeted else {}
                self._write(found, status, **session)
            case _:  # a notification: a client ends a wait by closing its connection
                self._head(202, "", 0)

    # Access --------------------------------------------------------------------------------------

    def _checked(self) -> bytes | None:
        """Return the body of a request that may be read; else answer why not."""
        headers = self._headers()
        refusal = self.server.guard.refusal(headers.get("Host"), headers.get("Origin"))
        length = headers.get("Content-Length", "")
        if refusal is not None:
            self._refuse(refusal.status, refusal.why)
        elif self.path.partition("?")[0] != PATH:
            self._refuse(404, f"not found: the path is {PATH}")
        elif headers.get("Content-Type", "").partition(";")[0].strip() != "application/json":
            self._refuse(415, "the content type must be application/json")
        elif not (length.isascii() and length.isdigit()) or "Transfer-Encoding" in headers:
            self._refuse(411, "a Content-Length is needed")
        elif len(length) > len(str(LONGEST)) or int(length) > LONGEST:
            self._refuse(413, f"a body of more than {LONGEST:,} bytes")
        else:
            data = self.rfile.read(int(length))
            return data if len(data) == int(length) else None
        return None

    def _may(self, found: object) -> bool:
        """Return whether the client has the token, or stops the robot; else answer 401."""
        token = bearer(self._headers().get("Authorization"))
        if self.server.guard.token and token and self.server.guard.may(token):
            self.server.rank(self.connection, str(self.client_address[0]), 1)
            return True
        if isinstance(found, Call) and found.tool == STOP:
            return True
        why = "the token is wrong" if token else "a token is needed: Authorization: Bearer TOKEN"
        self._refuse(401, why, **{"WWW-Authenticate": "Bearer"})
        return False

    def _headers(self) -> dict[str, str]:
        """Return the headers; one that occurs twice has an invalid value."""
        found: dict[str, str] = {}
        for name, value in self.headers.items():
            known = next((each for each in found if each.lower() == name.lower()), name.title())
            found[known] = f"{found[known]},{value}" if known in found else value
        return found

    # Answers -------------------------------------------------------------------------------------

    def _answer(self, call: Call) -> None:
        """Answer when the server does; with an event for each news if the client wants them."""
        arrived: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        send = arrived.put
        self.server.answering.receive(call, send)
        told = call.progress is not None and EVENTS in self._headers().get("Accept", "")
        begun = False
        while True:
            try:
                data = arrived.get(timeout=LOOK_S)
            except queue.Empty:
                if self._gone():
                    self.server.answering.drop(call.id, send)
                    self.close_connection = True
                    return
                continue
            last = not is_notification(data)
            if not last and not told:
                continue
            if last and not begun:
                self._write(data)
                return
            if not begun:
                self._head(200, EVENTS, None)
                begun = True
            try:
                self.wfile.write(b"event: message\ndata: " + data.rstrip() + b"\n\n")
                self.wfile.flush()
            except OSError:
                self.server.answering.drop(call.id, send)
                return
            if last:
                return

    def _gone(self) -> bool:
        """Return whether the client has closed the connection."""
        try:
            readable, _, _ = select.select([self.connection], [], [], 0.0)
            return bool(readable) and self.connection.recv(1, socket.MSG_PEEK) == b""
        except (OSError, ValueError):
            return True

    def _refuse(self, status: int, why: str, **headers: str) -> None:
        """Answer with an error, and close: a body that was not read would be the next request."""
        self._write(refused(INVALID, why), status, Connection="close", **headers)

    def _write(self, data: bytes, status: int = 200, **headers: str) -> None:
        self._head(status, "application/json", len(data), **headers)
        self.wfile.write(data)

    def _head(self, status: int, kind: str, length: int | None, **headers: str) -> None:
        self.send_response(status)
        fixed = {"X-Content-Type-Options": "nosniff", "Cache-Control": "no-store"}
        if kind:
            fixed["Content-Type"] = kind
        # Without a length the end of the connection is the end of the answer.
        fixed |= {"Connection": "close"} if length is None else {"Content-Length": str(length)}
        for name, value in (fixed | headers).items():
            self.send_header(name, value)
        self.end_headers()


def _session(lines: Lines) -> str:
    return urlsafe_b64encode(lines.client.encode()).decode() or "-"


def _client(session: str | None) -> str:
    """Return the name that a session's identifier has; "" if it is none of this server's."""
    try:
        name = urlsafe_b64decode(session or "").decode()
    except ValueError:
        return ""
    return named(name)
