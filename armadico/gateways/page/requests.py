"""A browser's requests: one JSON object each, with an `id` that the answer repeats.

Capabilities add further kinds (`part.py`). Anything else is rejected. Integers of 64 bits are sent
as text, because JavaScript's numbers have 53 bits.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Final, Union

import msgspec
from msgspec import Meta, Struct

from armadico.core.messages import Bits64, Name, Real, Text

LONGEST: Final = 4096
"""Bytes; no request is nearly as long."""

Number = Annotated[str, Meta(pattern=r"^[0-9]{1,19}\Z")]
Turned = Annotated[float, Meta(ge=-7.0, le=7.0)]


class Asked(Struct, frozen=True, forbid_unknown_fields=True, tag_field="do"):
    """What all have: a number of the browser's, and the robot's namespace."""

    id: Annotated[int, Meta(ge=0, le=2**53)]
    robot: Name


class Goto(Asked, frozen=True, tag="go"):
    """Drive to a place, m; without a heading (rad) it is that from the robot to there."""

    x: Real
    y: Real
    theta: Turned | None = None


class Halt(Asked, frozen=True, tag="stop"):
    """Stop the robot."""


class Resume(Asked, frozen=True, tag="resume"):
    """Release the stop that whoever asks has seen, and no other."""

    press: Number


class Start(Asked, frozen=True, tag="start"):
    """Start an agent on a host that could."""

    agent: Name


class Tune(Asked, frozen=True, tag="set"):
    """Give a parameter of an instance another value, as JSON."""

    instance: Name
    name: Name
    json: Text


class RequestError(ValueError):
    """What a browser said is none of these; the message says why.

    Attributes:
        id: The number that the answer repeats, or the browser would wait for it for ever; -1: none.
    """

    def __init__(self, why: str, number: int = -1) -> None:
        super().__init__(why)
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
            why = f"{len(data)} bytes; no request is longer than {LONGEST}"
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
