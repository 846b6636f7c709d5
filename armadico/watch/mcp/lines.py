"""The Model Context Protocol as far as a server of tools needs it: lines in, lines out (sans-IO).

JSON-RPC 2.0, one message per line (modelcontextprotocol.io, versions below). The caller passes in
lines, has calls answered, and writes the resulting lines. An invalid line gives an error response;
no line raises an exception.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec
from msgspec import UNSET, Struct, UnsetType

from armadico.core.messages import line
from armadico.observe.jsons import Json, JsonObject
from armadico.watch.assistant.tools import TOOLS, Tool

# The version without a handshake: each request states its version in `_meta`.
STATELESS: Final = "2026-07-28"

# Versions with a handshake (`initialize`), newest first. They do not differ for tools.
VERSIONS: Final = ("2025-11-25", "2025-06-18", "2025-03-26", "2024-11-05")

# How long a client of the stateless version may cache the list of tools, which never changes.
CACHED_MS: Final = 3_600_000

_META: Final = "io.modelcontextprotocol/"

LONGEST: Final = 65_536  # bytes of a line

NAME_LONGEST: Final = 60  # characters of a client's name that are shown

PARSE_ERROR, INVALID, NO_METHOD, BAD_PARAMS = -32700, -32600, -32601, -32602
BAD_VERSION: Final = -32022

INSTRUCTIONS: Final = (
    "A wheeled robot that is driven by a society of agents; nobody is in charge, and you are not."
    " Look with where, map, who, why and history. Your requests are published for people to see."
    " goto and mission are refused while the robot is stopped or under way on another mission. You"
    " may stop it; only a person releases a stop. Poses are metres, and degrees counter-clockwise."
)


class _Client(Struct, frozen=True):
    name: str = ""
    version: str = ""


class _Hello(Struct, frozen=True, rename="camel"):
    protocol_version: str = ""
    client_info: _Client = _Client()


class _Meta(Struct, frozen=True):
    """The metadata of a request of the stateless version; empty in other versions."""

    version: str = msgspec.field(default="", name=f"{_META}protocolVersion")
    client: _Client = msgspec.field(default=_Client(), name=f"{_META}clientInfo")


class _Stamped(Struct, frozen=True):
    meta: _Meta = msgspec.field(default=_Meta(), name="_meta")


class _Params(Struct, frozen=True):
    name: str
    arguments: msgspec.Raw = msgspec.Raw(b"{}")


class _Message(Struct, frozen=True):
    """A request, or without an id a notification; a response has no method."""

    jsonrpc: str
    method: str | UnsetType = UNSET
    id: int | str | UnsetType | None = UNSET
    params: msgspec.Raw = msgspec.Raw(b"{}")


class Call(Struct, frozen=True):
    """A call of a tool; `text` has its arguments as JSON in one line of printable ASCII.

    The tool and its arguments are not checked here. The assistant agent records and refuses
    invalid ones.
    """

    id: int | str
    tool: str
    text: str
    stamp: dict[str, object] = {}  # further fields of the answer, by the version of the call


class Lines:
    """The conversation with one client.

    Attributes:
        client: The client's name; empty until it is received.
    """

    def __init__(self, version: str) -> None:
        """Begin a conversation; `version` is this program's, shown to clients."""
        self.client = ""
        self._version = version
        self._version = version

    def receive(self, data: bytes) -> Call | bytes | None:
        """Return a call to answer, a line to write at once, or None if nothing is to be done."""
        if len(data) > LONGEST:
            return _error(None, INVALID, f"a line of more than {LONGEST:,} bytes")
        try:
            message = msgspec.json.decode(data, type=_Message)
        except msgspec.ValidationError as error:
            return _error(None, INVALID, f"not a JSON-RPC message: {error}")
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            return _error(None, PARSE_ERROR, f"not JSON: {error}")
        if message.method is UNSET or message.id is UNSET or message.id is None:
            return None  # a notification, or a response, although this server sends no requests
        if message.jsonrpc != "2.0":
            return _error(message.id, INVALID, "jsonrpc must be 2.0")
        try:
            meta = _meta(message.params)
            if meta.version:
                return self._stateless(message.id, message.method, message.params, meta)
            return self._requested(message.id, message.method, message.params)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            return _error(message.id, BAD_PARAMS, f"{message.method}: {error}")

    def _stateless(
        self, number: int | str, method: str, params: msgspec.Raw, meta: _Meta
    ) -> Call | bytes:
        """Answer a request that states its version."""
        self.client = line(meta.client.name)[:NAME_LONGEST] or self.client
        if meta.version != STATELESS:
            supported = {"supported": [STATELESS], "requested": meta.version}
            return _error(number, BAD_VERSION, "unsupported protocol version", supported)
        stamp: dict[str, object] = {
            "resultType": "complete",
            "_meta": {f"{_META}serverInfo": self._server},
        }
        cached = {"ttlMs": CACHED_MS, "cacheScope": "public"}
        match method:
            case "server/discover":
                found = {"supportedVersions": [STATELESS]} | self._abilities
                return _result(number, found | cached | stamp)
            case "tools/list":
                return _result(number, _tools() | cached | stamp)
            case "tools/call":
                return _called(number, msgspec.json.decode(params, type=_Params), stamp)
        return _error(number, NO_METHOD, f"no method {line(method)[:NAME_LONGEST]!r}")

    @property
    def _server(self) -> dict[str, str]:
        return {"name": "armadico", "title": "Armadico", "version": self._version}

    @property
    def _abilities(self) -> JsonObject:
        return {"capabilities": {"tools": {}}, "instructions": INSTRUCTIONS}

    def _requested(self, number: int | str, method: str, params: msgspec.Raw) -> Call | bytes:
        match method:
            case "initialize":
                hello = msgspec.json.decode(params, type=_Hello)
                self.client = line(hello.client_info.name)[:NAME_LONGEST]
                return _result(number, self._greeting(hello.protocol_version))
            case "ping":
                return _result(number, {})
            case "tools/list":
                return _result(number, _tools())
            case "tools/call":
                return _called(number, msgspec.json.decode(params, type=_Params), {})
        return _error(number, NO_METHOD, f"no method {line(method)[:NAME_LONGEST]!r}")

    def _greeting(self, wanted: str) -> JsonObject:
        return {
            "protocolVersion": wanted if wanted in VERSIONS else VERSIONS[0],
            "serverInfo": self._server,
            **self._abilities,
        }


def answer(call: Call, found: Mapping[str, Json], *, failed: bool = False) -> bytes:
    """Return the line that answers a call.

    It has the object, and the same as text for clients that do not read objects.
    """
    content = [{"type": "text", "text": msgspec.json.encode(found).decode()}]
    result = {"content": content, "structuredContent": found, "isError": failed}
    return _result(call.id, result | call.stamp)


def _meta(params: msgspec.Raw) -> _Meta:
    """Return a request's metadata; empty if it has none or it is invalid."""
    try:
        return msgspec.json.decode(params, type=_Stamped).meta
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return _Meta()


def _tools() -> JsonObject:
    return {"tools": [_shown(tool) for tool in TOOLS.values()]}


def _called(number: int | str, params: _Params, stamp: dict[str, object]) -> Call:
    given = bytes(params.arguments)
    return Call(number, params.name, "{}" if given == b"null" else _in_ascii(given), stamp)


def _in_ascii(data: bytes) -> str:
    """Return the same JSON in one line that is safe on any terminal."""
    text = msgspec.json.format(data, indent=-1).decode()
    return "".join(c if c.isascii() and c.isprintable() else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    pair = character.encode("utf-16-be")
    return "".join(f"\\u{pair[at : at + 2].hex()}" for at in range(0, len(pair), 2))


def _shown(tool: Tool) -> JsonObject:
    """Return a tool's entry in the list for clients."""
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


def _schema(kind: type[Struct]) -> JsonObject:
    """Return the JSON schema of a tool's arguments, without references."""
    (schema,), parts = msgspec.json.schema_components([kind], ref_template="{name}")
    found: dict[str, Any] = parts.pop(schema["$ref"])
    for name, property_ in found.get("properties", {}).items():
        reference = property_.get("$ref")
        if reference is not None:
            found["properties"][name] = parts[reference] | {"default": property_.get("default")}
    found.pop("title", None)
    return found | {"type": "object"}


def _result(number: int | str, result: Mapping[str, object]) -> bytes:
    return msgspec.json.encode({"jsonrpc": "2.0", "id": number, "result": result}) + b"\n"


def _error(
    number: int | str | None, code: int, message: str, data: Mapping[str, Json] | None = None
) -> bytes:
    error = {"code": code, "message": line(message)} | ({} if data is None else {"data": data})
    return msgspec.json.encode({"jsonrpc": "2.0", "id": number, "error": error}) + b"\n"
