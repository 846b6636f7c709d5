"""The Model Context Protocol, as far as a server of tools needs it (sans-IO): lines in, lines out.

JSON-RPC 2.0, a message a line (modelcontextprotocol.io, versions below). Whoever runs it hands it
lines, has calls answered by whoever knows the society, and writes what comes out. A line that is
none gives an error and nothing else; no line ends anybody.
"""

from __future__ import annotations

from typing import Any, Final

import msgspec
from msgspec import UNSET, Struct, UnsetType

from armadico.core.messages import line
from armadico.core.tools import TOOLS, Tool

VERSIONS: Final = ("2025-11-25", "2025-06-18", "2025-03-26", "2024-11-05")
"""Of the protocol that are spoken, the newest first; for tools they do not differ."""

LONGEST: Final = 65_536
"""Bytes of a line."""

NAME_LONGEST: Final = 60
"""Characters of a client's name that are told."""

PARSE_ERROR, INVALID, NO_METHOD, BAD_PARAMS = -32700, -32600, -32601, -32602

INSTRUCTIONS: Final = (
    "A wheeled robot that is driven by a society of agents; nobody is in charge, and you are not."
    " Look with where, map, who, why and history. What you ask for is taken down for people to see."
    " goto and mission are refused while the robot is stopped or under way for somebody else. You"
    " may stop it; only a person releases a stop. Poses are metres, and degrees counter-clockwise."
)


class _Client(Struct, frozen=True):
    name: str = ""
    version: str = ""


class _Hello(Struct, frozen=True, rename="camel"):
    protocol_version: str = ""
    client_info: _Client = _Client()


class _Params(Struct, frozen=True):
    name: str
    arguments: msgspec.Raw = msgspec.Raw(b"{}")


class _Said(Struct, frozen=True):
    """A request, or without an id a notification; a response has no method."""

    jsonrpc: str
    method: str | UnsetType = UNSET
    id: int | str | UnsetType | None = UNSET
    params: msgspec.Raw = msgspec.Raw(b"{}")


class Call(Struct, frozen=True):
    """A tool is called: `text` has its arguments, as JSON in one line of printable ASCII.

    Whether there is such a tool and such arguments is not looked at: whatever is asked for is taken
    down, and refused where it is done.
    """

    id: int | str
    tool: str
    text: str


class Lines:
    """One client's conversation.

    Attributes:
        client: How the client names itself; empty before it has.
    """

    def __init__(self, version: str) -> None:
        """Nobody has said anything; `version` is this program's, for people."""
        self.client = ""
        self._version = version

    def take(self, data: bytes) -> Call | bytes | None:
        """One line: a call to be answered, a line to be written at once, or nothing to do."""
        if len(data) > LONGEST:
            return _error(None, INVALID, f"a line of more than {LONGEST:,} bytes")
        try:
            said = msgspec.json.decode(data, type=_Said)
        except msgspec.ValidationError as error:
            return _error(None, INVALID, f"no message of JSON-RPC: {error}")
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            return _error(None, PARSE_ERROR, f"no JSON: {error}")
        if said.method is UNSET or said.id is UNSET or said.id is None:
            return None  # notifications, and answers to what was never asked
        if said.jsonrpc != "2.0":
            return _error(said.id, INVALID, "only JSON-RPC 2.0 is spoken")
        try:
            return self._requested(said.id, said.method, said.params)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            return _error(said.id, BAD_PARAMS, f"{said.method}: {error}")

    def _requested(self, number: int | str, method: str, params: msgspec.Raw) -> Call | bytes:
        match method:
            case "initialize":
                hello = msgspec.json.decode(params, type=_Hello)
                self.client = line(hello.client_info.name)[:NAME_LONGEST]
                return _result(number, self._greeting(hello.protocol_version))
            case "ping":
                return _result(number, {})
            case "tools/list":
                return _result(number, {"tools": [_shown(tool) for tool in TOOLS.values()]})
            case "tools/call":
                return _called(number, msgspec.json.decode(params, type=_Params))
        return _error(number, NO_METHOD, f"no method {line(method)[:NAME_LONGEST]!r}")

    def _greeting(self, wanted: str) -> dict[str, Any]:
        return {
            "protocolVersion": wanted if wanted in VERSIONS else VERSIONS[0],
            "capabilities": {"tools": {}},
            "serverInfo": {"name": "armadico", "title": "Armadico", "version": self._version},
            "instructions": INSTRUCTIONS,
        }


def answer(call: Call, told: dict[str, Any], *, failed: bool = False) -> bytes:
    """The line that answers a call: an object, and the same as text for clients that read none."""
    content = [{"type": "text", "text": msgspec.json.encode(told).decode()}]
    return _result(call.id, {"content": content, "structuredContent": told, "isError": failed})


def _called(number: int | str, params: _Params) -> Call:
    given = bytes(params.arguments)
    return Call(number, params.name, "{}" if given == b"null" else _in_ascii(given))


def _in_ascii(data: bytes) -> str:
    """The same JSON in one line that any terminal may have."""
    text = msgspec.json.format(data, indent=-1).decode()
    return "".join(c if c.isascii() and c.isprintable() else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    pair = character.encode("utf-16-be")
    return "".join(f"\\u{pair[at : at + 2].hex()}" for at in range(0, len(pair), 2))


def _shown(tool: Tool) -> dict[str, Any]:
    """A tool as clients are told of it."""
    hints = {
        "readOnlyHint": not tool.does,
        "destructiveHint": False,
        "idempotentHint": tool.name == "stop",
        "openWorldHint": tool.does,
    }
    return {
        "name": tool.name,
        "description": tool.what,
        "inputSchema": _schema(tool.arguments),
        "annotations": hints,
    }


def _schema(kind: type[Struct]) -> dict[str, Any]:
    """Its arguments' JSON schema, with nothing to be looked up elsewhere in it."""
    (schema,), parts = msgspec.json.schema_components([kind], ref_template="{name}")
    found: dict[str, Any] = parts.pop(schema["$ref"])
    for name, told in found.get("properties", {}).items():
        reference = told.get("$ref")
        if reference is not None:
            found["properties"][name] = parts[reference] | {"default": told.get("default")}
    found.pop("title", None)
    return found | {"type": "object"}


def _result(number: int | str, result: dict[str, Any]) -> bytes:
    return msgspec.json.encode({"jsonrpc": "2.0", "id": number, "result": result}) + b"\n"


def _error(number: int | str | None, code: int, message: str) -> bytes:
    error = {"code": code, "message": line(message)}
    return msgspec.json.encode({"jsonrpc": "2.0", "id": number, "error": error}) + b"\n"
