"""The Model Context Protocol for a server of tools, resources and prompts (sans-IO).

JSON-RPC 2.0, one message per line (modelcontextprotocol.io, versions below). The caller passes in
lines, has calls answered, and writes the resulting lines. An invalid line gives an error response;
no line raises an exception.
"""

from __future__ import annotations

import json
import re
from base64 import b64decode, b64encode
from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any, Final

import msgspec
from msgspec import UNSET, Struct, UnsetType
from msgspec.structs import replace

from armadico.core.messages import line
from armadico.observe.jsons import Json, JsonObject
from armadico.watch.assistant.tools import TOOLS, Tool
from armadico.watch.mcp.offers import RESOURCES, listed_prompts, listed_resources, prompted

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
INTERNAL: Final = -32603
BAD_HEADER: Final = -32020
BAD_VERSION: Final = -32022

# The HTTP statuses of errors in the stateless version; others are 200.
STATUSES: Final = {
    **dict.fromkeys((PARSE_ERROR, INVALID, BAD_PARAMS, BAD_HEADER, BAD_VERSION), 400),
    NO_METHOD: 404,
}

# HTTP headers of a request, in lower case. Those of the stateless version repeat its body.
VERSION_HEADER, METHOD_HEADER, NAME_HEADER = "mcp-protocol-version", "mcp-method", "mcp-name"

CODED: Final = re.compile(r"=\?base64\?(.*)\?=")

INSTRUCTIONS: Final = (
    "A wheeled robot that is driven by a society of agents; nobody is in charge, and you are not."
    " Look with where, places, why and history; answers are short, and `more` has all. goto knows"
    " places by name, and with wait_s says how it ended; cancel takes your goal back. goto and"
    " mission are refused while the robot is stopped or under way on another mission. You may stop"
    " it; only a person releases a stop. Your requests are published for people to see. Poses are"
    " metres, and degrees counter-clockwise."
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


class _Wanted(Struct, frozen=True):
    """The metadata of a request whose client wants to be told of its progress."""

    token: int | str | None = msgspec.field(default=None, name="progressToken")


class _Params(Struct, frozen=True):
    name: str
    arguments: msgspec.Raw = msgspec.Raw(b"{}")
    meta: _Wanted = msgspec.field(default=_Wanted(), name="_meta")


class _Read(Struct, frozen=True):
    uri: str


class _Prompted(Struct, frozen=True):
    name: str
    arguments: dict[str, str] | None = None


class _Dropped(Struct, frozen=True, rename="camel"):
    request_id: int | str


class _Message(Struct, frozen=True):
    """A request, or without an id a notification; a response has no method."""

    jsonrpc: str
    method: str | UnsetType = UNSET
    id: int | str | UnsetType | None = UNSET
    params: msgspec.Raw = msgspec.Raw(b"{}")


class _Outlined(Struct, frozen=True):
    meta: _Meta = msgspec.field(default=_Meta(), name="_meta")
    name: str = ""
    uri: str = ""


class _Outline(Struct, frozen=True):
    """What of a request its HTTP headers repeat."""

    method: str = ""
    id: int | str | None = None
    params: _Outlined = _Outlined()


class _Coded(Struct, frozen=True):
    code: int


class _Answered(Struct, frozen=True):
    error: _Coded | None = None
    id: int | str | UnsetType | None = UNSET


class Call(Struct, frozen=True):
    """A call of a tool; `text` has its arguments as JSON in one line of printable ASCII.

    The tool and its arguments are not checked here. The assistant agent records and refuses
    invalid ones.
    """

    id: int | str
    tool: str
    text: str
    stamp: dict[str, object] = {}  # further fields of the answer, by the version of the call
    by: str = ""  # the client's name
    # The token of progress notifications; None: the client wants none.
    progress: int | str | None = None
    uri: str = ""  # the resource that is read by this tool; empty: the tool is called


class Dropped(Struct, frozen=True):
    """The client does not want the answer to a request any more."""

    id: int | str


class Lines:
    """The conversation with one client."""

    def __init__(self, version: str, client: str = "") -> None:
        """Begin a conversation; `version` is this program's, shown to clients."""
        self.client = client  # the client's name; empty until it is received
        self.greeted = False  # whether the client has begun with the handshake of older versions
        self._version = version

    def receive(self, data: bytes) -> Call | Dropped | bytes | None:
        """Return a call to answer, a line to write at once, or None if nothing is to be done."""
        if len(data) > LONGEST:
            return _error(None, INVALID, f"a line of more than {LONGEST:,} bytes")
        try:
            message = msgspec.json.decode(data, type=_Message)
        except msgspec.ValidationError as error:
            return _error(None, INVALID, f"not a JSON-RPC message: {error}")
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            if plain := _without_nan(data):
                return self.receive(plain)
            return _error(None, PARSE_ERROR, f"not JSON: {error}")
        if message.method is UNSET or message.id is UNSET or message.id is None:
            return _dropped(message)
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
        self.client = named(meta.client.name) or self.client
        if meta.version != STATELESS:
            supported = {"supported": [STATELESS], "requested": meta.version}
            return _error(number, BAD_VERSION, "unsupported protocol version", supported)
        stamp: dict[str, object] = {
            "resultType": "complete",
            "_meta": {f"{_META}serverInfo": self._server},
        }
        cached = {"ttlMs": CACHED_MS, "cacheScope": "public"}
        if method == "server/discover":
            found = {"supportedVersions": [STATELESS]} | self._abilities
            return _result(number, found | cached | stamp)
        if method == "resources/read":
            stamp |= {"ttlMs": 0, "cacheScope": "private"}
        return self._found(number, method, params, stamp, cached)

    def _found(
        self,
        number: int | str,
        method: str,
        params: msgspec.Raw,
        stamp: dict[str, object],
        cached: Mapping[str, object],
    ) -> Call | bytes:
        """Answer what all versions have; lists that never change have also what is in `cached`."""
        if method in LISTS:
            return _result(number, {**LISTS[method](), **cached, **stamp})
        match method:
            case "tools/call":
                call = msgspec.json.decode(params, type=_Params)
                return replace(_called(number, call, stamp), by=self.client)
            case "resources/read":
                uri = msgspec.json.decode(params, type=_Read).uri
                if uri not in RESOURCES:
                    known = ", ".join(RESOURCES)
                    what = f"no resource {line(uri)[:NAME_LONGEST]!r}; known: {known}"
                    return _error(number, BAD_PARAMS, what, {"uri": line(uri)[:NAME_LONGEST]})
                return Call(number, RESOURCES[uri].tool, "{}", stamp, self.client, uri=uri)
            case "prompts/get":
                wanted = msgspec.json.decode(params, type=_Prompted)
                try:
                    prompt = prompted(wanted.name, wanted.arguments or {})
                except ValueError as error:
                    return _error(number, BAD_PARAMS, str(error))
                return _result(number, prompt | stamp)
        return _error(number, NO_METHOD, f"no method {line(method)[:NAME_LONGEST]!r}")

    @property
    def _server(self) -> dict[str, str]:
        return {"name": "armadico", "title": "Armadico", "version": self._version}

    @property
    def _abilities(self) -> JsonObject:
        abilities: JsonObject = {"tools": {}, "resources": {}, "prompts": {}}
        return {"capabilities": abilities, "instructions": INSTRUCTIONS}

    def _requested(self, number: int | str, method: str, params: msgspec.Raw) -> Call | bytes:
        match method:
            case "initialize":
                hello = msgspec.json.decode(params, type=_Hello)
                self.client, self.greeted = named(hello.client_info.name), True
                return _result(number, self._greeting(hello.protocol_version))
            case "ping":
                return _result(number, {})
        return self._found(number, method, params, {}, {})

    def _greeting(self, wanted: str) -> JsonObject:
        return {
            "protocolVersion": wanted if wanted in VERSIONS else VERSIONS[0],
            "serverInfo": self._server,
            **self._abilities,
        }


def answer(
    call: Call, found: Mapping[str, Json], *, failed: bool = False, picture: bytes | None = None
) -> bytes:
    """Return the line that answers a call.

    A tool's has the object, and the same as text for clients that do not read objects. A resource
    is the object, or the picture; a refused one is an error.
    """
    text = msgspec.json.encode(found).decode()
    if call.uri and failed:
        return _error(call.id, INTERNAL, str(found.get("refused", text)))
    if call.uri:
        kind = RESOURCES[call.uri].kind
        data = {"text": text} if picture is None else {"blob": b64encode(picture).decode()}
        contents = [{"uri": call.uri, "mimeType": kind} | data]
        return _result(call.id, {"contents": contents} | call.stamp)
    content = [{"type": "text", "text": text}]
    result = {"content": content, "structuredContent": found, "isError": failed}
    return _result(call.id, result | call.stamp)


def progress(call: Call, done: float, total: float, message: str) -> bytes:
    """Return the notification that tells how far a call is."""
    params = {"progressToken": call.progress, "progress": done, "total": total, "message": message}
    notification = {"jsonrpc": "2.0", "method": "notifications/progress", "params": params}
    return msgspec.json.encode(notification) + b"\n"


def status_of(data: bytes, version: str | None) -> int:
    """Return the HTTP status of a line that answers; `version` is in the request's header.

    Older clients take all but 200 for a broken connection, also where it answers a request.
    """
    found = msgspec.json.decode(data, type=_Answered)
    if found.error is None or (version != STATELESS and found.id is not None):
        return 200
    return STATUSES.get(found.error.code, 200)


def is_notification(data: bytes) -> bool:
    """Return whether a line of this server's is a notification: it answers nothing."""
    return msgspec.json.decode(data, type=_Answered).id is UNSET


def refused(code: int, why: str) -> bytes:
    """Return an error for a request whose number is not known."""
    return _error(None, code, why)


def mismatch(data: bytes, headers: Mapping[str, str]) -> bytes | None:
    """Return the error of a body that its HTTP headers contradict; None if they agree.

    Headers of the stateless version repeat the body, so that proxies need not read it. Others have
    the version's header alone, or none. A body that cannot be read is left to `Lines`. The names
    are in lower case, and repeated headers joined by commas.
    """
    try:
        body = msgspec.json.decode(data, type=_Outline)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        plain = _without_nan(data)
        return mismatch(plain, headers) if plain else None
    given, inside = headers.get(VERSION_HEADER), body.params.meta.version
    number = body.id if isinstance(body.id, int | str) else None
    if given != (inside or given) or (given == STATELESS and number is not None and not inside):
        what = f"{VERSION_HEADER} is {_short(given)}, and the body's version {_short(inside)}"
        return _error(number, BAD_HEADER, what)
    if given not in (None, STATELESS, *VERSIONS):
        supported = {"supported": [STATELESS, *VERSIONS], "requested": line(given)[:NAME_LONGEST]}
        return _error(number, BAD_VERSION, "unsupported protocol version", supported)
    if not inside or number is None:
        return None
    names = (body.params.uri,) if body.method == "resources/read" else (body.params.name,)
    named_ones = names if body.method in NAMED else ()
    wanted = {METHOD_HEADER: body.method, **dict(zip((NAME_HEADER,), named_ones, strict=False))}
    for header, value in wanted.items():
        if value and _decoded(headers.get(header)) != value:
            has = _short(headers.get(header))
            return _error(number, BAD_HEADER, f"{header} is {has}, and the body's {_short(value)}")
    return None


def named(name: str) -> str:
    """Return a client's name as it is shown."""
    return line(name)[:NAME_LONGEST]


def _without_nan(data: bytes) -> bytes | None:
    """Return a line with `NaN` and `Infinity` as text; None if it has none, or is no JSON either.

    JSON has no such numbers, but Python's `json` writes them. As text they are refused where they
    belong, in the answer to the call, and a stop is obeyed. Numbers beside them that are too large,
    such as 1e999, become text, too.
    """
    found: list[str] = []

    def text(constant: str) -> str:
        found.append(constant)
        return constant

    def whole(digits: str) -> int | str:
        return int(digits) if isfinite(float(digits)) else text(digits)

    def finite(digits: str) -> float | str:
        return float(digits) if isfinite(float(digits)) else text(digits)

    try:
        read = json.loads(data, parse_constant=text, parse_int=whole, parse_float=finite)
        plain = json.dumps(read)
    except (ValueError, RecursionError):
        return None
    return plain.encode() if found else None


def _decoded(header: str | None) -> str | None:
    """Return a header's value, which is in base64 if it is not printable ASCII."""
    coded = None if header is None else CODED.fullmatch(header)
    if coded is None:
        return header
    try:
        return b64decode(coded[1], validate=True).decode()
    except ValueError:
        return None


def _short(value: str | None) -> str:
    return repr(line(value)[:NAME_LONGEST]) if value else "missing"


def _dropped(message: _Message) -> Dropped | None:
    """Return what a notification withdraws; other ones, and responses, mean nothing here."""
    if message.method != "notifications/cancelled":
        return None
    try:
        return Dropped(msgspec.json.decode(message.params, type=_Dropped).request_id)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


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
    text = "{}" if given == b"null" else in_ascii(given)
    return Call(number, params.name, text, stamp, progress=params.meta.token)


LISTS: Final[Mapping[str, Callable[[], JsonObject]]] = {
    "tools/list": _tools,
    "resources/list": listed_resources,
    "resources/templates/list": lambda: {"resourceTemplates": []},
    "prompts/list": listed_prompts,
}

# Whose name, or URI, is repeated in a header.
NAMED: Final = ("tools/call", "prompts/get", "resources/read")


def in_ascii(data: bytes) -> str:
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
