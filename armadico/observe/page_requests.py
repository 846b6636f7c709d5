"""Requests of browsers: one JSON object each, with an `id` that the answer repeats.

Capabilities add further kinds (`part.py`). All others are rejected. Integers of 64 bits are sent as
text, because JavaScript's numbers have 53 bits.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Final, Union

import msgspec
from msgspec import Meta, Struct

from armadico.core.messages import Bits64, Name, Real, Text

LONGEST: Final = 4096  # bytes of a request; valid ones are much shorter

Number = Annotated[str, Meta(pattern=r"^[0-9]{1,19}\Z")]
Turned = Annotated[float, Meta(ge=-7.0, le=7.0)]


class Asked(Struct, frozen=True, forbid_unknown_fields=True, tag_field="do"):
    """The base of all requests: the browser's number, and the robot's namespace."""

    free: ClassVar[bool] = False
    """A browser without the page's token may send it, too."""

    id: Annotated[int, Meta(ge=0, le=2**53)]
    robot: Name


class Goto(Asked, frozen=True, tag="go"):
    """Drive to a place, m; the default heading (rad) is the direction from the robot to it."""

    x: Real
    y: Real
    theta: Turned | None = None


class Halt(Asked, frozen=True, tag="stop"):
    """Stop the robot: no token may keep a stop out."""

    free = True


class Resume(Asked, frozen=True, tag="resume"):
    """Release the stop that the browser has shown, and no other."""

    press: Number


class Start(Asked, frozen=True, tag="start"):
    """Start an agent on a host that can, or beside the page."""

    agent: Name


class Tune(Asked, frozen=True, tag="set"):
    """Set a parameter of an instance to a value, as JSON."""

    instance: Name
    name: Name
    json: Text


class RequestError(ValueError):
    """A request is invalid or cannot be met; the message has the reason."""

    def __init__(self, why: str, number: int = -1) -> None:
        super().__init__(why)
        # The number that the answer repeats, so that the browser does not wait forever; -1: none.
        self.id = number


class _Numbered(Struct, frozen=True):
    id: Annotated[int, Meta(ge=0, le=2**53)]


_UNREAD: Final = (msgspec.DecodeError, UnicodeError, RecursionError)


class Reader:
    """Reads requests of these kinds."""

    def __init__(self, kinds: Iterable[type[Asked]]) -> None:
        union: Any = Union[tuple(kinds)]  # noqa: UP007 - its members are known when it runs
        self._decoder: msgspec.json.Decoder[Asked] = msgspec.json.Decoder(union)

    def read(self, data: str | bytes) -> Asked:
        """The request in a browser's message. Raises RequestError."""
        if len(data) > LONGEST:
            why = f"a request may have at most {LONGEST} bytes (got {len(data)})"
            raise RequestError(why, _number(data))
        try:
            return self._decoder.decode(data)
        except _UNREAD as error:
            raise RequestError(str(error), _number(data)) from None


def _number(data: str | bytes) -> int:
    try:
        return msgspec.json.decode(data, type=_Numbered).id
    except _UNREAD:
        return -1


def bits(number: str) -> Bits64:
    """The number in a text. Raises RequestError if it has more than 63 bits."""
    found = int(number)
    if found >= 2**63:
        raise RequestError(f"{number} has more than 63 bits")
    return found
