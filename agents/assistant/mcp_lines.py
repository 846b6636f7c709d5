"""The Model Context Protocol, as far as a server of tools needs it (sans-IO): lines in, lines out.

JSON-RPC 2.0, a message a line (modelcontextprotocol.io, versions below). Whoever runs it hands it
lines, has calls answered by whoever knows the society, and writes what comes out. A line that is
none gives an error and nothing else; no line ends anybody.
"""

from __future__ import annotations

from typing import Any, Final

import msgspec
from msgspec import UNSET, Struct, UnsetType

from armadico.agents.assistant.tools import TOOLS, Tool
from armadico.core.messages import line

STATELESS: Final = "2026-07-28"
"""The version without a handshake: each request carries in `_meta` which version it is of."""

VERSIONS: Final = ("2025-11-25", "2025-06-18", "2025-03-26", "2024-11-05")
"""Those with a handshake (`initialize`), the newest first; for tools they do not differ."""

CACHED_MS: Final = 3_600_000
"""How long a client of the stateless version may keep the list of tools, which never changes."""

_META: Final = "io.modelcontextprotocol/"

LONGEST: Final = 65_536
"""Bytes of a line."""

NAME_LONGEST: Final = 60
"""Characters of a client's name that are told."""

PARSE_ERROR, INVALID, NO_METHOD, BAD_PARAMS = -32700, -32600, -32601, -32602
BAD_VERSION: Final = -32022

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


class _Meta(Struct, frozen=True):
    """What a request of the stateless version says of itself; empty in other versions."""

    version: str = msgspec.field(default="", name=f"{_META}protocolVersion")
    client: _Client = msgspec.field(default=_Client(), name=f"{_META}clientInfo")


class _Asked(Struct, frozen=True):
    meta: _Meta = msgspec.field(default=_Meta(), name="_meta")


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
    stamp: dict[str, Any] = {}
    """What the answer carries besides, by the version of the call."""


class Lines:
    """One client's conversation.

    Attributes:
        client: How the client names itself; empty before it has.
    """

    def __init__(self, version: str) -> None:
        """Nobody has said anything; `version` is this program's, for people."""
        self.client = ""
        self._version = version

    def receive(self, data: bytes) -> Call | bytes | None:
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
            meta = _meta(said.params)
            if meta.version:
                return self._stateless(said.id, said.method, said.params, meta)
            return self._requested(said.id, said.method, said.params)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            return _error(said.id, BAD_PARAMS, f"{said.method}: {error}")

    def _stateless(
        self, number: int | str, method: str, params: msgspec.Raw, meta: _Meta
    ) -> Call | bytes:
        """Answer a request that says which version it is of."""
        self.client = line(meta.client.name)[:NAME_LONGEST] or self.client
        if meta.version != STATELESS:
            supported = {"supported": [STATELESS], "requested": meta.version}
            return _error(number, BAD_VERSION, "the protocol's version is not spoken", supported)
        stamp = {"resultType": "complete", "_meta": {f"{_META}serverInfo": self._server}}
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
    def _abilities(self) -> dict[str, Any]:
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

    def _greeting(self, wanted: str) -> dict[str, Any]:
        return {
            "protocolVersion": wanted if wanted in VERSIONS else VERSIONS[0],
            "serverInfo": self._server,
            **self._abilities,
        }


def answer(call: Call, told: dict[str, Any], *, failed: bool = False) -> bytes:
    """The line that answers a call: an object, and the same as text for clients that read none."""
    content = [{"type": "text", "text": msgspec.json.encode(told).decode()}]
    result = {"content": content, "structuredContent": told, "isError": failed}
    return _result(call.id, result | call.stamp)


def _meta(params: msgspec.Raw) -> _Meta:
    """What a request says of itself; nothing if it says that in no way that is known."""
    try:
        return msgspec.json.decode(params, type=_Asked).meta
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return _Meta()


def _tools() -> dict[str, Any]:
    return {"tools": [_shown(tool) for tool in TOOLS.values()]}


def _called(number: int | str, params: _Params, stamp: dict[str, Any]) -> Call:
    given = bytes(params.arguments)
    return Call(number, params.name, "{}" if given == b"null" else _in_ascii(given), stamp)


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


def _error(
    number: int | str | None, code: int, message: str, data: dict[str, Any] | None = None
) -> bytes:
    error = {"code": code, "message": line(message)} | ({} if data is None else {"data": data})
    return msgspec.json.encode({"jsonrpc": "2.0", "id": number, "error": error}) + b"\n"
