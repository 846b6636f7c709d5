"""The page's server, by clients that may say anything."""

from __future__ import annotations

import json
import re
import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from armadico.gateways.page import server
from armadico.gateways.page.guard import PROTOCOL, Guard, subprotocol
from armadico.gateways.page.server import MOST, SOCKETS, Server, ServerError, web_files
from armadico.mesh.ports import LOOPBACK

SOON = 20.0
TOKEN = "0123456789abcdef0123"


class Desk:
    """A session that keeps what it is told, and answers what it is asked for."""

    def __init__(self) -> None:
        self.browsers: Any = None
        self.here: list[str] = []
        self.heard: list[str | bytes] = []

    def came(self, browser: str) -> None:
        self.here.append(browser)
        self.browsers.tell(browser, b'{"type":"hello"}')

    def said(self, browser: str, data: str | bytes) -> None:
        self.heard.append(data)
        self.browsers.tell(browser, b'{"type":"answer"}')

    def left(self, browser: str) -> None:
        self.here.remove(browser)


class Place:
    def __init__(self, stack: ExitStack, guard: Guard, desk: Any) -> None:
        self.desk = desk
        self.server = stack.enter_context(Server(desk, guard, LOOPBACK, 0))
        self.name = f"{LOOPBACK}:{self.server.port}"
        self._stack = stack

    def get(self, path: str, **headers: str) -> tuple[int, bytes, Any]:
        asked = urllib.request.Request(f"http://{self.name}{path}", headers=headers)
        try:
            with urllib.request.urlopen(asked, timeout=SOON) as answer:
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


def test_the_page_and_all_that_it_names_is_served(place: Place) -> None:
    status, page, headers = place.get("/")
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    for name in re.findall(r'(?:src|href)="([^"]+)"', page.decode()):
        assert place.get(f"/{name}")[0] == 200
    for name, (data, _) in web_files().items():
        for other in re.findall(r'from "\./([\w.]+)"', data.decode()):
            assert f"/{other}" in web_files(), name


def test_nothing_of_it_comes_from_elsewhere() -> None:
    for name, (data, _) in web_files().items():
        text = data.decode().replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"https?://|//cdn|@import", text), name


def test_it_runs_nothing_but_its_own_and_is_in_nobodys_frame(place: Place) -> None:
    headers = place.get("/")[2]
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    "path", ["/../server.py", "/%2e%2e/server.py", "/web/index.html", "/app.js/", "//", "/nowhere"]
)
def test_there_is_nothing_else(place: Place, path: str) -> None:
    assert place.get(path)[0] == 404


# Who is let in ------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/", "/app.js", "/allowed", "/socket"])
def test_under_a_strangers_name_nothing_is_served(place: Place, path: str) -> None:
    status, why, _ = place.get(path, Host="evil.example")
    assert (status, b"evil.example" in why) == (403, True)


def test_a_strangers_page_may_not_open_a_socket(place: Place) -> None:
    for origin in ("http://evil.example", "null", f"http://{LOOPBACK}:1"):
        with pytest.raises(InvalidStatus) as refused:
            place.open(origin)
        assert refused.value.response.status_code == 403
    assert json.loads(place.open(f"http://{place.name}").recv(SOON))["type"] == "hello"


def test_a_host_that_comes_twice_is_none(place: Place) -> None:
    with socket.create_connection((LOOPBACK, place.server.port), timeout=SOON) as raw:
        raw.sendall(f"GET / HTTP/1.1\r\nHost: {place.name}\r\nHost: evil\r\n\r\n".encode())
        assert raw.recv(4096).split(b"\r\n")[0].split()[1] == b"403"


def test_without_a_token_the_page_is_served_and_nothing_behind_it(locked: Place) -> None:
    assert locked.get("/")[0] == 200
    status, why, _ = locked.get("/allowed")
    assert (status, why.startswith(b"a token is needed")) == (401, True)
    with pytest.raises(InvalidStatus) as refused:
        locked.open()
    assert refused.value.response.status_code == 401
    assert not locked.desk.here


def test_a_wrong_token_is_said_to_be_wrong(locked: Place) -> None:
    wrong = TOKEN[:-1] + "4"
    assert locked.get("/allowed", Authorization=f"Bearer {wrong}")[1].endswith(b"not the right one")
    with pytest.raises(InvalidStatus) as refused:
        locked.open(None, subprotocol(wrong))
    assert refused.value.response.status_code == 401


def test_with_the_token_it_opens_and_the_token_is_not_repeated(locked: Place) -> None:
    assert locked.get("/allowed", Authorization=f"Bearer {TOKEN}")[0] == 200
    opened = locked.open(f"http://{locked.name}", subprotocol(TOKEN))
    assert opened.subprotocol == PROTOCOL
    assert json.loads(opened.recv(SOON))["type"] == "hello"


def test_a_token_does_not_excuse_a_strangers_page(locked: Place) -> None:
    with pytest.raises(InvalidStatus) as refused:
        locked.open("http://evil.example", subprotocol(TOKEN))
    assert refused.value.response.status_code == 403


def test_so_many_browsers_and_no_more(place: Place) -> None:
    opened = [place.open() for _ in range(MOST)]
    for each in opened:
        each.recv(SOON)
    with pytest.raises(InvalidStatus) as refused:
        place.open()
    assert refused.value.response.status_code == 503


# What is said -------------------------------------------------------------------------------------


def test_what_a_browser_says_is_passed_on_and_it_is_answered(place: Place) -> None:
    opened = place.open()
    opened.recv(SOON)
    opened.send('{"do":"stop"}')
    assert json.loads(opened.recv(SOON))["type"] == "answer"
    assert place.desk.heard == ['{"do":"stop"}']
    (name,) = place.desk.here
    assert re.fullmatch(rf"page 1-[0-9a-f]{{6}} at {LOOPBACK}", name)


def test_what_is_far_too_long_ends_its_connection_and_no_other(place: Place) -> None:
    opened, other = place.open(), place.open()
    opened.recv(SOON)
    other.recv(SOON)
    opened.send("x" * 100_000)
    with pytest.raises(ConnectionClosed):
        opened.recv(SOON)
    other.send("{}")
    assert json.loads(other.recv(SOON))["type"] == "answer"


def test_what_is_no_http_ends_nobody_and_says_nothing(
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


def test_who_opens_thousands_and_says_nothing_takes_no_more_than_so_many(
    place: Place, stack: ExitStack
) -> None:
    opened = place.open()
    opened.recv(SOON)
    last = _strangers(place, stack, SOCKETS + 20)[-1]
    with suppress(ConnectionError):
        assert last.recv(1) == b""  # let go at once
    opened.send("{}")
    assert json.loads(opened.recv(SOON))["type"] == "answer"


def test_who_says_nothing_does_not_keep_it_from_ending(
    stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "OPEN_S", 1e6)  # nor would it for as long as it may
    with ExitStack() as served:
        place = Place(served, Guard.of(LOOPBACK, None), Desk())
        silent, begun = _strangers(place, stack, 2)
        begun.sendall(b"GET / HT")
        assert place.get("/")[0] == 200  # so both have been taken
    for each in (silent, begun):
        with suppress(ConnectionError):
            while each.recv(4096):
                pass


def test_a_port_that_is_taken_is_said_with_what_to_do(stack: ExitStack) -> None:
    with socket.create_server((LOOPBACK, 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ServerError, match=rf"port {port}: .*in use.*--port 0"):
            Server(Desk(), Guard(), LOOPBACK, port)  # type: ignore[arg-type]


@pytest.mark.parametrize(("address", "port"), [(LOOPBACK, 70_000), ("nowhere.invalid", 0)])
def test_where_nobody_can_listen_is_said(address: str, port: int) -> None:
    with pytest.raises(ServerError, match="cannot listen on"):
        Server(Desk(), Guard(), address, port)  # type: ignore[arg-type]
