"""The Model Context Protocol's lines: any input gives an answer of the protocol."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core.messages import MessageError, checked
from armadico.watch.assistant.messages import AssistantRequest
from armadico.watch.assistant.tools import TOOLS
from armadico.watch.mcp.lines import LONGEST, STATELESS, VERSIONS, Call, Lines, answer


def request(**fields: object) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": 7, **fields}).encode() + b"\n"


def parsed(given: Call | bytes | None) -> dict[str, Any]:
    """Return an answer, which is one line."""
    assert isinstance(given, bytes)
    assert given.endswith(b"\n")
    assert given.count(b"\n") == 1
    found: dict[str, Any] = json.loads(given)
    assert found["jsonrpc"] == "2.0"
    return found


@pytest.mark.parametrize("version", [*VERSIONS, "1999-01-01", ""])
def test_the_greeting_has_the_clients_version_if_supported(version: str) -> None:
    lines = Lines("0.1")
    client = {"name": "a model\x1b[2J", "version": "3"}
    params = {"protocolVersion": version, "capabilities": {}, "clientInfo": client}
    result = parsed(lines.receive(request(method="initialize", params=params)))["result"]
    assert result["protocolVersion"] == (version if version in VERSIONS else VERSIONS[0])
    assert result["capabilities"] == {"tools": {}}
    assert result["serverInfo"]["name"] == "armadico"
    assert lines.client == "a model [2J", "it is printed on terminals"


def stateless(method: str, version: str = STATELESS, **params: object) -> bytes:
    """A request of the version without a handshake."""
    prefix = "io.modelcontextprotocol/"
    meta = {
        f"{prefix}protocolVersion": version,
        f"{prefix}clientInfo": {"name": "a model", "version": "3"},
        f"{prefix}clientCapabilities": {},
    }
    return request(method=method, params={"_meta": meta, **params})


def test_without_a_handshake_each_request_states_its_version() -> None:
    lines = Lines("0.1")
    found = parsed(lines.receive(stateless("server/discover")))["result"]
    assert found["supportedVersions"] == [STATELESS]
    assert found["capabilities"] == {"tools": {}}
    assert (found["resultType"], found["cacheScope"]) == ("complete", "public")
    assert found["_meta"]["io.modelcontextprotocol/serverInfo"]["name"] == "armadico"
    assert lines.client == "a model"
    listed = parsed(lines.receive(stateless("tools/list")))["result"]
    assert [tool["name"] for tool in listed["tools"]] == list(TOOLS)
    assert (listed["resultType"], listed["ttlMs"] > 0) == ("complete", True)
    call = lines.receive(stateless("tools/call", name="where", arguments={}))
    assert isinstance(call, Call)
    result = parsed(answer(call, {"x": 1}))["result"]
    assert (result["structuredContent"], result["resultType"]) == ({"x": 1}, "complete")
    for removed in ("initialize", "ping"):
        assert parsed(lines.receive(stateless(removed)))["error"]["code"] == -32601


def test_an_unsupported_version_is_refused_with_the_supported_ones() -> None:
    error = parsed(Lines("0.1").receive(stateless("tools/list", "2099-01-01")))["error"]
    assert error["code"] == -32022
    assert error["data"] == {"supported": [STATELESS], "requested": "2099-01-01"}


def test_notifications_and_responses_get_no_answer() -> None:
    lines = Lines("0.1")
    assert lines.receive(b'{"jsonrpc": "2.0", "method": "notifications/initialized"}\n') is None
    assert lines.receive(b'{"jsonrpc": "2.0", "id": 3, "result": {}}\n') is None
    assert parsed(lines.receive(request(method="ping"))) == {
        "jsonrpc": "2.0",
        "id": 7,
        "result": {},
    }


def test_every_tool_is_listed_with_a_schema_that_stands_by_itself() -> None:
    tools = parsed(Lines("0.1").receive(request(method="tools/list")))["result"]["tools"]
    assert [tool["name"] for tool in tools] == list(TOOLS)
    for tool in tools:
        assert tool["inputSchema"]["type"] == "object"
        assert not tool["inputSchema"]["additionalProperties"]
        assert "$ref" not in json.dumps(tool)
        assert tool["annotations"]["readOnlyHint"] != TOOLS[tool["name"]].does
    goto = next(tool for tool in tools if tool["name"] == "goto")["inputSchema"]
    assert goto["required"] == ["x", "y"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"x": 1.5, "y": -2}, '{"x":1.5,"y":-2}'),
        ({}, "{}"),
        (None, "{}"),
        ({"reason": "é\n\u202e😀"}, '{"reason":"\\u00e9\\n\\u202e\\ud83d\\ude00"}'),
    ],
)
def test_a_calls_arguments_fit_into_a_line_of_a_message(
    arguments: dict[str, object] | None, text: str
) -> None:
    params = {"name": "goto", "arguments": arguments}
    call = Lines("0.1").receive(request(method="tools/call", params=params))
    assert call == Call(7, "goto", text)
    checked(AssistantRequest(call.tool, call.text))
    assert json.loads(call.text) == (arguments or {})


def test_whitespace_between_arguments_is_left_out() -> None:
    raw = b'{"jsonrpc":"2.0","id":"a","method":"tools/call","params":{"name":"stop",'
    call = Lines("0.1").receive(raw + b'"arguments": {\t"reason" :\r "a  b" }}}')
    assert call == Call("a", "stop", '{"reason":"a  b"}')


def test_an_answer_is_an_object_and_the_same_as_text() -> None:
    result = parsed(answer(Call(7, "where", "{}"), {"connected": False}))["result"]
    assert result["structuredContent"] == {"connected": False}
    assert json.loads(result["content"][0]["text"]) == {"connected": False}
    assert result["isError"] is False
    assert parsed(answer(Call(7, "goto", "{}"), {"refused": "no"}, failed=True))["result"][
        "isError"
    ]


@pytest.mark.parametrize(
    ("line", "code", "number"),
    [
        (b"\n", -32700, None),
        (b"{\n", -32700, None),
        (b"\xff\xfe\n", -32700, None),
        (b"[" * 50_000 + b"\n", -32600, None),
        (b'{"jsonrpc":"2.0","id":1,"method":"ping","params":' + b"[" * 50_000, -32700, None),
        (b"[]\n", -32600, None),
        (b'{"id": 7, "method": "ping"}\n', -32600, None),
        (b'{"jsonrpc": "1.0", "id": 7, "method": "ping"}\n', -32600, 7),
        (b'{"jsonrpc": "2.0", "id": [7], "method": "ping"}\n', -32600, None),
        (b'{"jsonrpc": "2.0", "id": 7, "method": "resources/list"}\n', -32601, 7),
        (b'{"jsonrpc": "2.0", "id": 7, "method": "tools/call"}\n', -32602, 7),
        (
            b'{"jsonrpc": "2.0", "id": 7, "method": "tools/call", "params": {"name": 1}}\n',
            -32602,
            7,
        ),
        (b'{"jsonrpc": "2.0", "id": 7, "method": "initialize", "params": 3}\n', -32602, 7),
        (b'{"jsonrpc": "2.0", "id": 7, "method": "' + b"x" * LONGEST + b'"}\n', -32600, None),
    ],
)
def test_an_invalid_line_is_an_error_and_the_next_is_processed(
    line: bytes, code: int, number: int | None
) -> None:
    lines = Lines("0.1")
    found = parsed(lines.receive(line))
    assert found["error"]["code"] == code
    assert found["id"] == number
    assert "result" in parsed(lines.receive(request(method="ping")))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inside: st.lists(inside) | st.dictionaries(st.text(), inside),
    max_leaves=10,
)


@given(st.binary() | JSON.map(lambda value: json.dumps(value).encode()))
def test_no_line_raises(line: bytes) -> None:
    found = Lines("0.1").receive(line)
    assert found is None or "error" in parsed(found)


@pytest.mark.long
@given(st.sampled_from(["tools/call", "initialize", "tools/list", "ping"]), JSON, JSON, JSON)
def test_no_request_raises(method: str, number: object, name: object, arguments: object) -> None:
    params = {"name": name, "arguments": arguments, "protocolVersion": name, "clientInfo": number}
    found = Lines("0.1").receive(request(id=number, method=method, params=params))
    if isinstance(found, Call):
        try:
            checked(AssistantRequest(found.tool, found.text))
        except MessageError:  # the server reports it to the program
            assert (
                len(found.text) > 2000
                or not (0 < len(found.tool) <= 128)
                or not found.tool.isprintable()
            )
    elif found is not None:
        parsed(found)
