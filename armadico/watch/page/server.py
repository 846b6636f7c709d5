"""The page's server: files over HTTP, and a WebSocket for each browser, on a thread of its own.

It has no knowledge of robots. `guard` checks access. Messages of browsers go to the session, and
the session sends the data to show.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Coroutine, Sequence
from functools import cache
from http import HTTPStatus
from importlib.resources import files
from itertools import count
from secrets import token_hex
from typing import Final, TypeVar

from websockets.asyncio.server import Server as Listening
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from armadico.mesh.sources import Ration, Rations, source_of
from armadico.observe.page_requests import LONGEST
from armadico.watch.page.entrance import entrance
from armadico.watch.page.guard import PROTOCOL, Guard, Refusal, bearer, is_loopback, token_in
from armadico.watch.page.places import Places
from armadico.watch.page.session import Session

T = TypeVar("T")

SOCKET: Final = "/socket"
ALLOWED: Final = "/allowed"  # checks a token: browsers do not report why a WebSocket is refused

MOST: Final = 16  # browsers at once
ANSWERS: Final = 256  # answers that may wait for a browser; beyond them it is disconnected

# Connections at once that are no browsers': without a request yet, with the request of a file, or
# closing. Thousands of them would leave the process no file descriptors.
WAITING: Final = 256
ACCEPTED: Final = 32  # connections that are accepted before others are served

# What one source may open at once, and then per second. A page takes ten connections.
CONNECTIONS: Final = 200.0
CONNECTIONS_HZ: Final = 20.0  # from another computer
LOOKERS: Final = 2.0 * MOST
LOOKERS_HZ: Final = 4.0  # browsers without the token
STRANGERS_HZ: Final = 8.0  # of these, all from other computers together
REQUESTS: Final = 16.0
REQUESTS_HZ: Final = 4.0  # of one of these; more wait

OPEN_S: Final = 3.0  # timeout of a connection's request
CLOSE_S: Final = 1.0  # timeout of closing handshakes at the end
LAST_S: Final = 1.0  # for the last requests of a browser without a place, which may be a stop
PING_S: Final = 5.0  # interval and timeout of pings, to detect phones that are out of reach

FULL: Final = f"{MOST} browsers are connected: the newest have the places"

TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}

HEADERS: Final = {
    # No content from other servers, and no frames in other sites' pages (clickjacking).
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self';"
    " img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none';"
    " frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}


logger = logging.getLogger("armadico.page")
logger.addHandler(logging.NullHandler())  # invalid requests of other programs are not logged
logger.propagate = False


class ServerError(Exception):
    """The server cannot start; the message has the reason and what to do."""


class _Browser:
    """A connected browser, with the newest data to show and all pending answers."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.shown: bytes | None = None
        self.answers: asyncio.Queue[bytes] = asyncio.Queue(ANSWERS)
        self.wake = asyncio.Event()
        self.ready = True  # read by the session's thread


class Server:
    """A context manager that listens from its construction on."""

    def __init__(self, session: Session, guard: Guard, address: str, port: int) -> None:
        """Start to listen; port 0 selects a free one. Raises ServerError."""
        self._session = session
        self._guard = guard
        self._browsers: dict[str, _Browser] = {}
        self._numbers = count(1)
        self._own = token_hex(3)
        self._sockets: set[asyncio.Transport] = set()
        self._waiting = Places[asyncio.Transport](WAITING)
        self._seats = Places[str](MOST)
        self._connections = Rations(CONNECTIONS_HZ, CONNECTIONS)
        self._lookers = Rations(LOOKERS_HZ, LOOKERS)
        self._strangers = Rations(STRANGERS_HZ, LOOKERS)
        self._closing: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        try:
            self._listening: Listening = self._run(self._listen(address, port))
        except (OSError, OverflowError, UnicodeError) as error:
            self._end()
            hint = "; --port 0 selects a free one" if isinstance(error, OSError) else ""
            what = getattr(error, "strerror", None) or error
            raise ServerError(f"cannot listen on {address}, port {port}: {what}{hint}") from None
        session.browsers = self

    @property
    def port(self) -> int:
        port: int = next(iter(self._listening.sockets)).getsockname()[1]
        return port

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.browsers = None
        self._run(self._close())
        self._end()

    # For the session, on its thread --------------------------------------------------------------

    def ready(self, browser: str) -> bool:
        found = self._browsers.get(browser)
        return found is not None and found.ready

    def send(self, browser: str, data: bytes) -> None:
        found = self._browsers.get(browser)
        if found is not None:
            found.ready = False
            self._loop.call_soon_threadsafe(self._queue_shown, found, data)

    def answer(self, browser: str, data: bytes) -> None:
        found = self._browsers.get(browser)
        if found is not None:
            self._loop.call_soon_threadsafe(self._queue_answer, found, data)

    # On its own thread ---------------------------------------------------------------------------

    async def _listen(self, address: str, port: int) -> Listening:
        return await serve(
            self._serve,
            sock=entrance(address, port, self._admits),
            backlog=ACCEPTED,
            process_request=self._check,
            select_subprotocol=_subprotocol,
            compression=None,  # it costs time and saves little for small messages
            max_size=2 * LONGEST,
            max_queue=16,
            ping_interval=PING_S,
            ping_timeout=PING_S,
            open_timeout=OPEN_S,
            close_timeout=CLOSE_S,
            create_connection=_told(self._arrived, self._gone),
            server_header=None,
            logger=logger,
        )

    def _check(self, connection: ServerConnection, request: Request) -> Response | None:
        """The response to a request; None for a WebSocket that is allowed.

        Files need no token, only valid headers.
        """
        headers = request.headers
        refusal = self._guard.refusal(_one(headers, "Host"), _one(headers, "Origin"))
        path = request.path.partition("?")[0]
        if refusal is None and path in (SOCKET, ALLOWED):
            token, source = _token(headers), _source(connection.transport)
            refusal = self._guard.admit(token)
            if refusal is None and path == SOCKET and not self._guard.may(token):
                refusal = self._rationed(source)
        if refusal is not None:
            return _response(connection, refusal.status, refusal.why.encode(), "text/plain")
        if path == SOCKET:
            return None
        if path == ALLOWED:
            return _response(connection, 200, b"", "text/plain")
        found = web_files().get("/index.html" if path == "/" else path)
        if found is None:
            return _response(connection, 404, b"not found", "text/plain")
        data, kind = found
        return _response(connection, 200, data, kind)

    def _rationed(self, source: str) -> Refusal | None:
        """Why a browser without the token is refused; None while few open."""
        now = self._loop.time()
        if not self._lookers.take(source, now):
            return Refusal(503, f"too many browsers connect from {source}: try again in a second")
        if not (is_loopback(source) or self._strangers.take("", now)):
            return Refusal(
                503, "too many browsers connect without the token: try again in a second"
            )
        return None

    async def _serve(self, connection: ServerConnection) -> None:
        peer = connection.remote_address
        address = str(peer[0]) if peer else "nowhere"
        # Unique across pages and restarts, so that no browser takes over another one's stick.
        name = f"page-{next(self._numbers)}-{self._own} at {address}"
        assert connection.request is not None, "its handshake is over"
        may = self._guard.may(_token(connection.request.headers))
        browser = self._browsers[name] = _Browser(connection)
        writing = asyncio.create_task(self._write(browser))
        self._waiting.leave(connection.transport)
        displaced = self._seats.enter(name, _source(connection.transport), _rank(address, may=may))
        if displaced is not None:
            self._dismiss(self._browsers[displaced])
        self._session.on_connect(name, may=may)
        ration = Ration(REQUESTS_HZ, REQUESTS, self._loop.time())
        try:
            async for data in connection:
                self._session.on_message(name, data)
                if not may:
                    await self._wait(ration)
        except ConnectionClosed:
            pass
        finally:
            del self._browsers[name]
            self._seats.leave(name)
            self._session.on_disconnect(name)
            writing.cancel()

    async def _wait(self, ration: Ration) -> None:
        """Wait until one of a ration is left, and take it."""
        ration.refill(self._loop.time())
        if (wait := ration.until_one()) > 0.0:
            await asyncio.sleep(wait)
            ration.refill(self._loop.time())
        ration.left -= 1.0

    def _dismiss(self, browser: _Browser) -> None:
        """End a browser whose place another one has: it is shown nothing more, and closed soon."""
        browser.ready = False
        self._admit(browser.connection.transport)

        async def close() -> None:
            await asyncio.sleep(LAST_S)
            await browser.connection.close(CloseCode.TRY_AGAIN_LATER, FULL)

        closing = asyncio.create_task(close())
        self._closing.add(closing)
        closing.add_done_callback(self._closing.discard)

    def _admits(self, address: str) -> bool:
        """Whether one more connection from an address is served now."""
        source = source_of(address)
        return is_loopback(source) or self._connections.take(source, self._loop.time())

    def _arrived(self, transport: asyncio.Transport) -> None:
        self._sockets.add(transport)
        self._admit(transport)

    def _admit(self, transport: asyncio.Transport) -> None:
        """Let a connection wait; the one that has to leave for it is closed."""
        displaced = self._waiting.enter(transport, _source(transport))
        if displaced is not None:
            displaced.abort()

    def _gone(self, transport: asyncio.Transport) -> None:
        self._sockets.discard(transport)
        self._waiting.leave(transport)

    async def _write(self, browser: _Browser) -> None:
        """Send all answers and the newest data to show; a slow browser skips older data."""
        try:
            while True:
                await browser.wake.wait()
                browser.wake.clear()
                while not browser.answers.empty():
                    await browser.connection.send(browser.answers.get_nowait().decode())
                shown, browser.shown = browser.shown, None
                if shown is not None:
                    await browser.connection.send(shown.decode())
                    browser.ready = True
        except ConnectionClosed:
            pass

    def _queue_shown(self, browser: _Browser, data: bytes) -> None:
        browser.shown = data
        browser.wake.set()

    def _queue_answer(self, browser: _Browser, data: bytes) -> None:
        if browser.answers.full():
            browser.connection.transport.abort()
            return
        browser.answers.put_nowait(data)
        browser.wake.set()

    async def _close(self) -> None:
        self._listening.close()
        closing = asyncio.ensure_future(self._listening.wait_closed())
        await asyncio.wait([closing], timeout=CLOSE_S)
        for each in self._sockets:  # a connection without a request would last OPEN_S
            each.abort()
        for task in self._closing:
            task.cancel()
        await asyncio.gather(closing, *self._closing, return_exceptions=True)

    def _run(self, call: Coroutine[None, None, T]) -> T:
        return asyncio.run_coroutine_threadsafe(call, self._loop).result()

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


def _told(
    arrived: Callable[[asyncio.Transport], None], gone: Callable[[asyncio.Transport], None]
) -> type[ServerConnection]:
    """A class of connections that call one function when they open, the other when they close."""

    class Told(ServerConnection):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(transport)
            arrived(self.transport)

        def connection_lost(self, exc: Exception | None) -> None:
            gone(self.transport)
            super().connection_lost(exc)

    return Told


def _source(transport: asyncio.Transport) -> str:
    """Where a connection comes from; one that is closed already comes from nowhere."""
    peer = transport.get_extra_info("peername")
    return source_of(str(peer[0])) if peer else ""


def _rank(address: str, *, may: bool) -> int:
    """Who keeps its place: first a browser with the token, then one on this computer."""
    return 2 if may else int(is_loopback(address))


def _subprotocol(
    _connection: ServerConnection, offered: Sequence[Subprotocol]
) -> Subprotocol | None:
    """The page's subprotocol; the token offered beside it is not repeated."""
    return next((each for each in offered if each == PROTOCOL), None)


def _offered(headers: Headers) -> list[str]:
    found = headers.get_all("Sec-WebSocket-Protocol")
    return [word.strip() for line in found for word in line.split(",")]


def _token(headers: Headers) -> str | None:
    """The token of a request; browsers offer it as a subprotocol of a WebSocket."""
    token = bearer(_one(headers, "Authorization"))
    return token_in(_offered(headers)) if token is None else token


def _one(headers: Headers, name: str) -> str | None:
    """A header's value; an invalid value if it occurs twice."""
    found = headers.get_all(name)
    return None if not found else found[0] if len(found) == 1 else "\0"


def _response(connection: ServerConnection, status: int, data: bytes, kind: str) -> Response:
    made = connection.respond(HTTPStatus(status), "")
    made.body = data
    wanted = {**HEADERS, "Content-Type": kind, "Content-Length": str(len(data))}
    for name, value in wanted.items():
        if name in made.headers:
            del made.headers[name]
        made.headers[name] = value
    return made


@cache
def web_files() -> dict[str, tuple[bytes, str]]:
    """The served files by path: content and type."""
    return {
        f"/{each.name}": (each.read_bytes(), TYPES[suffix])
        for each in (files("armadico.watch.page") / "web").iterdir()
        if (suffix := each.name[each.name.rfind(".") :]) in TYPES
    }
