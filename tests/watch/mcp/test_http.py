"""By HTTP: who is served, what is refused, and that a stop is neither refused nor delayed."""

from __future__ import annotations

import http.client
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest

from armadico.cli.options import UsageError
from armadico.config.named import DATA_VARIABLE, Gazetteer
from armadico.mobile.messages import MissionState, MissionStatus
from armadico.watch.commands import mcp
from armadico.watch.mcp.answers import Society
from armadico.watch.mcp.http import MOST, PATH, Door
from armadico.watch.mcp.lines import LONGEST, STATELESS
from armadico.watch.mcp.server import Server
from armadico.watch.page.guard import Guard
from tests.watch.mcp.test_server import SOON, Guest, SilentWatcher, accepting

TOKEN = "t" * 24
OWNER = {"Authorization": f"Bearer {TOKEN}"}
JSON = {"Content-Type": "application/json"}
BOTH = {"Accept": "application/json, text/event-stream"}


class Served:
    """A server whose society is a stand-in, on a free port of loopback."""

    def __init__(self, gazetteer: Gazetteer) -> None:
        self.stopper, self.guest = Guest(), accepting()
        self.society = Society(gazetteer, {})
        self.watcher: Any = SilentWatcher(self.society)
        guests: Any = (self.stopper, self.guest)
        self.dropped = threading.Event()
        self.server = Server(guests, self.watcher, self.society, lambda: None)
        drop = self.server.drop

        def dropping(number: int | str, send: Any) -> None:
            drop(number, send)
            self.dropped.set()

        self.server.drop = dropping  # type: ignore[method-assign]
        threading.Thread(target=self.server.keep, daemon=True).start()
        self.door = Door(self.server, Guard.of("127.0.0.1", TOKEN), "127.0.0.1", 0, "0")

    def connect(self) -> http.client.HTTPConnection:
        return http.client.HTTPConnection("127.0.0.1", self.door.port, timeout=SOON)

    def post(
        self,
        body: bytes | dict[str, object],
        headers: dict[str, str] | None = None,
        path: str = PATH,
        method: str = "POST",
    ) -> tuple[int, dict[str, str], Any]:
        """Return status, headers and JSON of a request's answer."""
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        connection = self.connect()
        connection.request(method, path, data, JSON | (OWNER if headers is None else headers))
        answer = connection.getresponse()
        text = answer.read()
        connection.close()
        return answer.status, dict(answer.headers), json.loads(text) if text else None


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    found = Served(Gazetteer("house"))
    with found.door:
        yield found


def request(method: str, params: object = None, **more: object) -> dict[str, object]:
    return {"jsonrpc": "2.0", "id": 1, "method": method, "params": params or {}, **more}


def call(tool: str, *, told: bool = False, **arguments: object) -> dict[str, object]:
    meta = {"_meta": {"progressToken": "p"}} if told else {}
    return request("tools/call", {"name": tool, "arguments": arguments, **meta})


def test_a_client_with_the_token_is_served_and_keeps_its_name_by_its_session(
    served: Served,
) -> None:
    hello = {"protocolVersion": "2025-11-25", "clientInfo": {"name": "Modell ü"}}
    status, headers, found = served.post(request("initialize", hello))
    assert (status, found["result"]["protocolVersion"]) == (200, "2025-11-25")
    session = {"Mcp-Session-Id": headers["Mcp-Session-Id"]}
    note = {"jsonrpc": "2.0", "method": "notifications/initialized"}
    assert served.post(note, OWNER | session)[0] == 202
    status, _, found = served.post(call("where"), OWNER | session)
    assert (status, found["result"]["isError"]) == (200, False)
    assert served.guest.requests[-1].by == "Modell ü"
    served.post(call("where"), OWNER | {"Mcp-Session-Id": "%%%"})
    assert served.guest.requests[-1].by == "a program"


def test_the_stateless_version_is_served_if_headers_and_body_agree(served: Served) -> None:
    prefix = "io.modelcontextprotocol/"
    meta = {f"{prefix}protocolVersion": STATELESS, f"{prefix}clientInfo": {"name": "m"}}
    body = request("tools/call", {"name": "where", "arguments": {}, "_meta": meta})
    agreed = {
        "MCP-Protocol-Version": STATELESS,
        "Mcp-Method": "tools/call",
        "Mcp-Name": "where",
    }
    assert served.post(body, OWNER | agreed)[0] == 200
    assert served.guest.requests[-1].by == "m"
    unknown = {**body, "method": "tools/none"}
    assert served.post(unknown, OWNER | agreed | {"Mcp-Method": "tools/none"})[0] == 404
    for name, wrong in (("MCP-Protocol-Version", "1999-01-01"), ("Mcp-Name", "stop")):
        status, _, found = served.post(body, OWNER | agreed | {name: wrong})
        assert (status, found["error"]["code"]) == (400, -32020)
    status, _, found = served.post(request("tools/list"), OWNER | {"MCP-Protocol-Version": "x"})
    assert (status, found["error"]["code"]) == (400, -32022)
    assert len(served.guest.requests) == 1


@pytest.mark.parametrize("headers", [{}, {"Authorization": "Bearer wrong"}])
def test_without_the_token_nothing_is_answered_but_a_stop(
    served: Served, headers: dict[str, str]
) -> None:
    for body in (call("goto", place="E"), call("where"), request("tools/list"), b"{"):
        status, found_headers, found = served.post(body, headers)
        assert (status, found_headers["WWW-Authenticate"]) == (401, "Bearer")
        assert "token" in found["error"]["message"]
    assert served.guest.requests == []
    status, _, found = served.post(call("stop"), headers)
    assert (status, found["result"]["structuredContent"]["stopped"]) == (200, True)


def test_a_token_without_http_is_refused() -> None:
    with pytest.raises(UsageError, match="--http"):
        mcp.main(["--token", "0123456789abcdef"])


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://evil.example"}, 403),
        ({"Host": "evil.example"}, 403),
        ({"Content-Type": "text/plain"}, 415),
    ],
)
def test_a_browser_of_another_site_is_refused(
    served: Served, headers: dict[str, str], status: int
) -> None:
    assert served.post(call("where"), OWNER | headers)[0] == status
    assert served.guest.requests == []


def test_other_methods_paths_and_too_large_bodies_are_refused(served: Served) -> None:
    for method in ("GET", "DELETE", "PUT"):
        assert served.post(b"", method=method)[0] == 405
    assert served.post(call("where"), path="/")[0] == 404
    assert served.post(b"{")[0] == 400
    status, _, found = served.post(request("tools/none"))
    assert (status, found["error"]["code"]) == (200, -32601), "older clients take 404 for the path"
    with ExitStack() as stack:
        for length, status in ((str(LONGEST + 1), b"413"), ("9" * 5000, b"413"), ("-1", b"411")):
            connection = stack.enter_context(
                socket.create_connection(("127.0.0.1", served.door.port), SOON)
            )
            head = f"POST {PATH} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            connection.sendall(f"{head}Content-Length: {length}\r\n\r\n".encode())
            assert connection.recv(100).split()[1] == status
    assert served.post(call("where"))[0] == 200


def test_progress_comes_as_events_before_the_answer(served: Served) -> None:
    connection = served.connect()
    body = json.dumps(call("goto", told=True, place="E", wait_s=600))
    connection.request("POST", PATH, body, JSON | OWNER | BOTH)
    served.watcher.messages.put(MissionStatus(7, MissionState.DRIVING, 4.25))
    answer = connection.getresponse()
    assert answer.headers["Content-Type"] == "text/event-stream"
    events = []
    while not events or "method" in events[-1]:
        line = answer.readline()
        if line.startswith(b"data: "):
            events.append(json.loads(line[6:]))
            served.watcher.messages.put(MissionStatus(7, MissionState.REACHED, 0.0))
    assert events[0]["params"]["progressToken"] == "p"
    assert events[-1]["result"]["structuredContent"]["end"] == "reached"
    assert answer.read().strip() == b"", "the answer is the last event"


def test_a_client_that_does_not_read_events_gets_the_answer_alone(served: Served) -> None:
    served.watcher.messages.put(MissionStatus(7, MissionState.REACHED, 0.0))
    status, headers, found = served.post(call("goto", told=True, place="E", wait_s=600))
    assert (status, headers["Content-Type"]) == (200, "application/json")
    assert found["result"]["structuredContent"]["end"] == "reached"


def test_the_wait_of_a_client_that_is_gone_ends(served: Served) -> None:
    connection = served.connect()
    connection.request("POST", PATH, json.dumps(call("goto", place="E", wait_s=600)), JSON | OWNER)
    connection.close()
    assert served.dropped.wait(SOON)


def test_connections_that_say_nothing_keep_no_stop_out(served: Served) -> None:
    with ExitStack() as stack:
        for _ in range(MOST + 8):
            stack.enter_context(socket.create_connection(("127.0.0.1", served.door.port), SOON))
        status, _, found = served.post(call("stop"), {})
        assert (status, found["result"]["structuredContent"]["stopped"]) == (200, True)


def test_calls_that_are_answered_late_delay_no_stop(served: Served) -> None:
    served.guest.busy = threading.Event()
    try:
        with ExitStack() as stack:
            for _ in range(4):
                connection = stack.enter_context(closing(served.connect()))
                connection.request("POST", PATH, json.dumps(call("where")), JSON | OWNER)
            assert served.post(call("stop"))[2]["result"]["structuredContent"]["stopped"]
    finally:
        served.guest.busy.set()


def test_what_is_no_http_ends_its_connection_alone(served: Served) -> None:
    with socket.create_connection(("127.0.0.1", served.door.port), SOON) as connection:
        connection.sendall(b"\x00\xff garbage\r\n\r\n")
        while connection.recv(1000):
            pass
    assert served.post(call("where"))[0] == 200
