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
from armadico.watch.mcp.lines import (
    LONGEST,
    STATELESS,
    VERSIONS,
    Call,
    Dropped,
    Lines,
    answer,
    is_notification,
    mismatch,
    progress,
    status_of,
)


def request(**fields: object) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": 7, **fields}).encode() + b"\n"


def parsed(given: Call | Dropped | bytes | None) -> dict[str, Any]:
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
    assert result["capabilities"].keys() == {"tools", "resources", "prompts"}
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
    assert found["capabilities"].keys() == {"tools", "resources", "prompts"}
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
    assert goto["properties"].keys() == {"place", "x", "y", "heading", "wait_s"}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"x": 1.5, "y": -2}, '{"x":1.5,"y":-2}'),
        (None, "{}"),
        ({"reason": "é\n\u202e😀"}, '{"reason":"\\u00e9\\n\\u202e\\ud83d\\ude00"}'),
    ],
)
def test_a_calls_arguments_fit_into_a_line_of_a_message(
    arguments: dict[str, object] | None, text: str
) -> None:
    params = {"name": "goto", "arguments": arguments}
    call = Lines("0.1").receive(request(method="tools/call", params=params))
    assert isinstance(call, Call)
    assert (call.id, call.tool, call.text) == (7, "goto", text)
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


def test_a_resource_is_read_by_a_tool_and_answered_as_contents() -> None:
    lines = Lines("0.1")
    listed = parsed(lines.receive(request(method="resources/list")))["result"]["resources"]
    for resource in listed:
        call = lines.receive(request(method="resources/read", params={"uri": resource["uri"]}))
        assert isinstance(call, Call)
        assert not TOOLS[call.tool].does
        (content,) = parsed(answer(call, {"x": 1}))["result"]["contents"]
        assert content["uri"] == resource["uri"]
        assert json.loads(content["text"]) == {"x": 1}
    call = lines.receive(stateless("resources/read", uri="armadico://map"))
    assert isinstance(call, Call)
    result = parsed(answer(call, {}, picture=b"PNG"))["result"]
    assert (result["contents"][0]["blob"], result["ttlMs"]) == ("UE5H", 0)
    assert parsed(answer(call, {"refused": "too many"}, failed=True))["error"]["code"] == -32603
    wrong = request(method="resources/read", params={"uri": "file:///etc/passwd"})
    assert parsed(lines.receive(wrong))["error"]["code"] == -32602


def test_a_prompt_has_its_arguments_and_wrong_ones_are_refused() -> None:
    lines = Lines("0.1")
    listed = parsed(lines.receive(request(method="prompts/list")))["result"]["prompts"]
    assert [argument["name"] for argument in listed[0]["arguments"]] == ["errand"]
    params = {"name": "errand", "arguments": {"errand": "look into {the} kitchen"}}
    found = parsed(lines.receive(request(method="prompts/get", params=params)))["result"]
    assert "look into {the} kitchen" in found["messages"][0]["content"]["text"]
    for wrong in ({"name": "errand"}, {"name": "x"}, {"name": "explain", "arguments": {"a": "b"}}):
        error = parsed(lines.receive(request(method="prompts/get", params=wrong)))["error"]
        assert error["code"] == -32602


def test_a_call_can_be_followed_and_withdrawn() -> None:
    lines = Lines("0.1")
    params = {"name": "goto", "arguments": {}, "_meta": {"progressToken": "t"}}
    call = lines.receive(request(method="tools/call", params=params))
    assert isinstance(call, Call)
    told = progress(call, 1.0, 9.0, "2 m to go")
    assert is_notification(told)
    assert not is_notification(answer(call, {}))
    assert json.loads(told)["params"]["progressToken"] == "t"
    notification = {"jsonrpc": "2.0", "method": "notifications/cancelled"}
    line = json.dumps({**notification, "params": {"requestId": 7}}).encode()
    assert lines.receive(line) == Dropped(7)
    assert lines.receive(json.dumps({**notification, "params": []}).encode()) is None


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_number_that_json_lacks_is_refused_by_its_name_and_keeps_no_client_waiting(
    value: float,
) -> None:
    """Python's `json` writes it. The agent that refuses it names the argument."""
    arguments = {"x": value, "y": 1}
    params = {"name": "goto", "arguments": arguments}
    call = Lines("0.1").receive(request(method="tools/call", params=params))
    assert isinstance(call, Call)
    assert json.loads(call.text) == {"x": json.dumps(value), "y": 1}
    with_headers = stateless("tools/call", name="goto", arguments=arguments)
    assert mismatch(with_headers, AGREED) is None
    error = mismatch(with_headers, AGREED | {"mcp-name": "stop"})
    assert error is not None


@pytest.mark.parametrize("large", ["1e999", "-1e999", "9" * 5000])
def test_so_is_one_that_is_too_large_beside_it(large: str) -> None:
    params = {"name": "goto", "arguments": {"x": float("nan"), "y": "LARGE"}}
    data = request(method="tools/call", params=params).replace(b'"LARGE"', large.encode())
    call = Lines("0.1").receive(data)
    assert isinstance(call, Call)
    assert json.loads(call.text) == {"x": "NaN", "y": large}


AGREED = {
    "mcp-protocol-version": STATELESS,
    "mcp-method": "tools/call",
    "mcp-name": "goto",
}


@pytest.mark.parametrize(
    ("headers", "code"),
    [
        (AGREED, None),
        (AGREED | {"mcp-name": "=?base64?Z290bw==?="}, None),
        (AGREED | {"mcp-name": "stop"}, -32020),
        (AGREED | {"mcp-protocol-version": f"{STATELESS},{STATELESS}"}, -32020),
        ({}, -32020),
    ],
)
def test_the_headers_of_the_stateless_version_repeat_its_body(
    headers: dict[str, str], code: int | None
) -> None:
    wrong = mismatch(stateless("tools/call", name="goto", arguments={}), headers)
    assert (wrong and json.loads(wrong)["error"]["code"]) == code
    assert wrong is None or status_of(wrong, STATELESS) == 400


def test_older_versions_need_no_header_and_unknown_ones_are_refused() -> None:
    body = request(method="tools/list")
    assert mismatch(body, {}) is None
    assert mismatch(body, {"mcp-protocol-version": VERSIONS[0]}) is None
    wrong = mismatch(body, {"mcp-protocol-version": "1999-01-01"})
    assert wrong is not None
    assert json.loads(wrong)["error"]["data"]["supported"] == [STATELESS, *VERSIONS]
    assert mismatch(body, {"mcp-protocol-version": STATELESS}) is not None, "it states no version"
    assert mismatch(b"{", {}) is None


@given(st.binary(), st.dictionaries(st.sampled_from(sorted(AGREED)), st.text()))
def test_no_body_or_header_raises(body: bytes, headers: dict[str, str]) -> None:
    wrong = mismatch(body, headers)
    assert wrong is None or "error" in json.loads(wrong)


@pytest.mark.parametrize(
    ("line", "code", "number"),
    [
        (b"\n", -32700, None),
        (b"{\n", -32700, None),
        (b"\xff\xfe\n", -32700, None),
        (b'{"jsonrpc":"2.0","id":1,"method":"ping","params":' + b"[" * 50_000, -32700, None),
        (b'{"jsonrpc": "1.0", "id": 7, "method": "ping"}\n', -32600, 7),
        (b'{"jsonrpc": "2.0", "id": [7], "method": "ping"}\n', -32600, None),
        (b'{"jsonrpc": "2.0", "id": 7, "method": "logging/setLevel"}\n', -32601, 7),
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
