"""The page's server, with valid and invalid clients."""

from __future__ import annotations

import json
import re
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import CloseCode
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from armadico.mesh.ports import LOOPBACK
from armadico.watch.page import server
from armadico.watch.page.guard import PROTOCOL, Guard
from armadico.watch.page.server import (
    CONNECTIONS,
    MOST,
    REQUESTS,
    REQUESTS_HZ,
    WAITING,
    Server,
    ServerError,
    web_files,
)
from tests.watch.page.stage import subprotocol

SOON = 20.0
TOKEN = "0123456789abcdef0123"


class Desk:
    """A session that keeps all messages and answers each."""

    def __init__(self) -> None:
        self.browsers: Any = None
        self.here: list[str] = []
        self.may: list[bool] = []
        self.received: list[str | bytes] = []

    def on_connect(self, browser: str, *, may: bool = True) -> None:
        self.here.append(browser)
        self.may.append(may)
        self.browsers.answer(browser, b'{"type":"hello"}')

    def on_message(self, browser: str, data: str | bytes) -> None:
        self.received.append(data)
        self.browsers.answer(browser, b'{"type":"answer"}')

    def on_disconnect(self, browser: str) -> None:
        self.here.remove(browser)


class Place:
    def __init__(self, stack: ExitStack, guard: Guard, desk: Any) -> None:
        self.desk = desk
        self.server = stack.enter_context(Server(desk, guard, LOOPBACK, 0))
        self.name = f"{LOOPBACK}:{self.server.port}"
        self._stack = stack

    def get(self, path: str, **headers: str) -> tuple[int, bytes, Any]:
        request = urllib.request.Request(f"http://{self.name}{path}", headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=SOON) as answer:
                return answer.status, answer.read(), answer.headers
        except urllib.error.HTTPError as error:
            return error.code, error.read(), error.headers

    def open(self, origin: str | None = None, *protocols: str, **more: Any) -> ClientConnection:
        made = connect(
            f"ws://{self.name}/socket",
            origin=None if origin is None else Origin(origin),
            subprotocols=[Subprotocol(each) for each in (PROTOCOL, *protocols)],
            **more,
        )
        return self._stack.enter_context(made)


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as made:
        yield made


@pytest.fixture
def place(stack: ExitStack) -> Place:
    return Place(stack, Guard.of(LOOPBACK, None), Desk())


@pytest.fixture
def locked(stack: ExitStack) -> Place:
    return Place(stack, Guard.of("0.0.0.0", TOKEN), Desk())


# Files --------------------------------------------------------------------------------------------


def test_the_page_and_all_its_files_are_served(place: Place) -> None:
    status, page, headers = place.get("/")
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    for name in re.findall(r'(?:src|href)="([^"]+)"', page.decode()):
        assert place.get(f"/{name}")[0] == 200
    for name, (data, _) in web_files().items():
        for other in re.findall(r'from "\./([\w.]+)"', data.decode()):
            assert f"/{other}" in web_files(), name


def test_the_page_loads_nothing_from_other_servers() -> None:
    for name, (data, _) in web_files().items():
        text = data.decode().replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"https?://|//cdn|@import", text), name


def test_the_headers_forbid_foreign_scripts_and_frames(place: Place) -> None:
    headers = place.get("/")[2]
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    "path", ["/../server.py", "/%2e%2e/server.py", "/web/index.html", "/app.js/", "//", "/nowhere"]
)
def test_other_paths_are_not_found(place: Place, path: str) -> None:
    assert place.get(path)[0] == 404


# Access -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/", "/app.js", "/allowed", "/socket"])
def test_under_another_host_name_nothing_is_served(place: Place, path: str) -> None:
    status, why, _ = place.get(path, Host="evil.example")
    assert (status, b"evil.example" in why) == (403, True)


def test_pages_of_other_servers_may_not_open_a_socket(place: Place) -> None:
    for origin in ("http://evil.example", "null", f"http://{LOOPBACK}:1"):
        with pytest.raises(InvalidStatus) as refused:
            place.open(origin)
        assert refused.value.response.status_code == 403
    assert json.loads(place.open(f"http://{place.name}").recv(SOON))["type"] == "hello"


def test_a_repeated_host_header_is_refused(place: Place) -> None:
    with socket.create_connection((LOOPBACK, place.server.port), timeout=SOON) as raw:
        raw.sendall(f"GET / HTTP/1.1\r\nHost: {place.name}\r\nHost: evil\r\n\r\n".encode())
        assert raw.recv(4096).split(b"\r\n")[0].split()[1] == b"403"


def test_without_the_token_it_opens_to_look_and_stop(locked: Place) -> None:
    assert locked.get("/allowed")[0] == 200
    assert json.loads(locked.open().recv(SOON))["type"] == "hello"
    assert locked.desk.may == [False]


def test_a_wrong_token_is_refused(locked: Place) -> None:
    wrong = TOKEN[:-1] + "4"
    assert locked.get("/allowed", Authorization=f"Bearer {wrong}")[0] == 401
    with pytest.raises(InvalidStatus) as refused:
        locked.open(None, subprotocol(wrong))
    assert refused.value.response.status_code == 401


def test_with_the_token_it_opens_and_the_token_is_not_repeated(locked: Place) -> None:
    assert locked.get("/allowed", Authorization=f"Bearer {TOKEN}")[0] == 200
    opened = locked.open(f"http://{locked.name}", subprotocol(TOKEN))
    assert opened.subprotocol == PROTOCOL
    assert json.loads(opened.recv(SOON))["type"] == "hello"
    assert locked.desk.may == [True]


def _hello(opened: ClientConnection) -> str:
    return str(json.loads(opened.recv(SOON))["type"])


def _opens(place: Place, *protocols: str, **more: Any) -> bool:
    """Whether a browser gets in; it is refused because its source opens too many otherwise."""
    try:
        return _hello(place.open(None, *protocols, **more)) == "hello"
    except InvalidStatus as refused:
        assert refused.response.status_code == 503  # noqa: PT017
        return False


def _dismissed(opened: ClientConnection) -> bool:
    """Whether the server has closed a connection because another one has its place."""
    with suppress(ConnectionClosed):
        while True:
            opened.recv(SOON)
    return opened.close_code == CloseCode.TRY_AGAIN_LATER


def test_the_newest_browser_gets_the_place_of_the_oldest(place: Place) -> None:
    opened = [place.open() for _ in range(MOST)]
    assert {_hello(each) for each in opened} == {"hello"}
    assert _hello(place.open()) == "hello"
    assert _dismissed(opened[0])
    opened[1].send("{}")
    assert json.loads(opened[1].recv(SOON))["type"] == "answer"


def test_browsers_without_the_token_take_no_place_of_one_that_has_it(locked: Place) -> None:
    strangers = [locked.open() for _ in range(MOST)]
    assert {_hello(each) for each in strangers} == {"hello"}
    holder = locked.open(None, subprotocol(TOKEN))
    assert _hello(holder) == "hello"
    assert _hello(locked.open()) == "hello"
    holder.send("{}")
    assert json.loads(holder.recv(SOON))["type"] == "answer"


def test_a_source_that_opens_many_browsers_without_the_token_is_refused_alone(
    locked: Place,
) -> None:
    opens = partial(_opens, locked)
    assert False in iter(opens, None)
    assert opens(subprotocol(TOKEN))
    assert opens(source_address=("127.0.0.2", 0))


def test_browsers_of_many_computers_without_the_token_share_a_ration(
    locked: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "is_loopback", lambda _: False)
    sources = ((f"127.0.1.{n}", 0) for n in range(1, 255))
    assert False in (_opens(locked, source_address=source) for source in sources)
    assert _opens(locked, subprotocol(TOKEN), source_address=("127.0.2.1", 0))


def test_requests_of_a_browser_without_the_token_wait_for_their_ration(locked: Place) -> None:
    opened = locked.open()
    assert _hello(opened) == "hello"
    more = 4
    began = time.monotonic()
    for _ in range(int(REQUESTS) + more):
        opened.send("{}")
    for _ in range(int(REQUESTS) + more):
        assert json.loads(opened.recv(SOON))["type"] == "answer"
    assert time.monotonic() - began > (more - 1) / REQUESTS_HZ - 0.1


def test_a_browser_without_a_place_gets_a_stop_through_and_is_told_why(locked: Place) -> None:
    for _ in range(MOST):
        assert _hello(locked.open(None, subprotocol(TOKEN))) == "hello"
    stranger = locked.open()
    assert _hello(stranger) == "hello"
    stranger.send('{"do":"stop"}')
    assert json.loads(stranger.recv(SOON))["type"] == "answer"
    assert _dismissed(stranger)
    assert str(MOST) in str(stranger.close_reason)
    assert locked.desk.received == ['{"do":"stop"}']


# Messages -----------------------------------------------------------------------------------------


def test_a_browsers_message_reaches_the_session_and_is_answered(place: Place) -> None:
    opened = place.open()
    opened.recv(SOON)
    opened.send('{"do":"stop"}')
    assert json.loads(opened.recv(SOON))["type"] == "answer"
    assert place.desk.received == ['{"do":"stop"}']
    (name,) = place.desk.here
    assert re.fullmatch(rf"page-1-[0-9a-f]{{6}} at {LOOPBACK}", name)


def test_a_message_that_is_too_long_ends_its_connection_and_no_other(place: Place) -> None:
    opened, other = place.open(), place.open()
    opened.recv(SOON)
    other.recv(SOON)
    opened.send("x" * 100_000)
    with pytest.raises(ConnectionClosed):
        opened.recv(SOON)
    other.send("{}")
    assert json.loads(other.recv(SOON))["type"] == "answer"


def test_invalid_http_has_no_effect_and_is_not_logged(
    place: Place, capfd: pytest.CaptureFixture[str]
) -> None:
    for junk in (b"\x00" * 100, b"POST / HTTP/1.1\r\nHost: x\r\n\r\n", b"GET /\r\n\r\n", b""):
        with socket.create_connection((LOOPBACK, place.server.port), timeout=SOON) as raw:
            raw.sendall(junk)
            raw.shutdown(socket.SHUT_WR)
            while raw.recv(4096):
                pass
    assert place.get("/")[0] == 200
    assert capfd.readouterr().err == ""


def _strangers(place: Place, stack: ExitStack, count: int) -> list[socket.socket]:
    where = (LOOPBACK, place.server.port)
    return [stack.enter_context(socket.create_connection(where, SOON)) for _ in range(count)]


def test_connections_without_a_request_keep_nobody_out(place: Place, stack: ExitStack) -> None:
    opened = place.open()
    opened.recv(SOON)
    first, *_ = _strangers(place, stack, WAITING + 20)
    assert _hello(place.open()) == "hello"
    with suppress(ConnectionError):
        assert first.recv(1) == b""  # closed for a newer one
    opened.send("{}")
    assert json.loads(opened.recv(SOON))["type"] == "answer"


def _answers(place: Place) -> bool:
    """Whether a request for a file is answered; its connection is closed at once otherwise."""
    where = (LOOPBACK, place.server.port)
    with suppress(ConnectionError), socket.create_connection(where, SOON) as raw:
        raw.sendall(f"GET /icon.svg HTTP/1.1\r\nHost: {place.name}\r\n\r\n".encode())
        return raw.recv(4) == b"HTTP"
    return False


def test_a_source_that_opens_too_many_connections_is_refused_alone(
    place: Place, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "is_loopback", lambda _: False)  # as from another computer
    assert _answers(place)
    _strangers(place, stack, int(CONNECTIONS))
    assert False in iter(partial(_answers, place), None)
    assert _hello(place.open(source_address=("127.0.0.2", 0))) == "hello"


def test_connections_without_a_request_do_not_delay_the_end(
    stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "OPEN_S", 1e6)  # so that the timeout does not close them
    with ExitStack() as served:
        place = Place(served, Guard.of(LOOPBACK, None), Desk())
        silent, begun = _strangers(place, stack, 2)
        begun.sendall(b"GET / HT")
        assert place.get("/")[0] == 200  # so both have been accepted
    for each in (silent, begun):
        with suppress(ConnectionError):
            while each.recv(4096):
                pass


def test_a_port_in_use_is_named_with_a_remedy(stack: ExitStack) -> None:
    with socket.create_server((LOOPBACK, 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ServerError, match=rf"port {port}: .*in use.*--port 0"):
            Server(Desk(), Guard(), LOOPBACK, port)  # type: ignore[arg-type]


@pytest.mark.parametrize(("address", "port"), [(LOOPBACK, 70_000), ("nowhere.invalid", 0)])
def test_an_invalid_address_or_port_is_named(address: str, port: int) -> None:
    with pytest.raises(ServerError, match=f"{address}.*{port}"):
        Server(Desk(), Guard(), address, port)  # type: ignore[arg-type]
