"""The messages as the protocol page shows them: each field's place, type, range and default.

Ranges come from the annotations that `decode` checks by; what a field means, from the comment
beside it, or the text below it, where the message is defined.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

import msgspec
from msgspec import inspect as types

from armadico.core.messages import Message
from armadico.core.services import Service, message_types, services

COMMENT: Final = re.compile(r"^ {4}(\w+): .*?  # (.+)$", re.MULTILINE)

BELOW: Final = re.compile(r'^ {4}(\w+): [^\n]*\n {4}"""(.+?)"""$', re.MULTILINE | re.DOTALL)

POWERS: Final = {2**52: "2^52", 2**63 - 1: "2^63 - 1", 1e6: "1e6", -1e6: "-1e6"}
"""Bounds that are read more easily as powers."""


@dataclass(frozen=True)
class Field:
    """One place of a message's array."""

    index: int
    name: str
    type: str
    default: str  # what an array that is too short stands for; empty: it must be there
    meaning: str


def ours() -> tuple[list[Service], list[type[Message]]]:
    """The services and messages of the product, whatever else has been imported."""
    inside = "armadico."
    return (
        [row for row in services() if row.message.__module__.startswith(inside)],
        [kind for kind in message_types() if kind.__module__.startswith(inside)],
    )


def fields_of(kind: type[Message]) -> list[Field]:
    """The fields of a message in the order of the wire."""
    info = types.type_info(kind)
    assert isinstance(info, types.StructType), f"{kind.__name__} is a struct"
    source = inspect.getsource(kind)
    below = {name: re.sub(r"\s+", " ", text) for name, text in BELOW.findall(source)}
    comments = below | dict(COMMENT.findall(source))
    return [
        Field(
            index,
            field.name,
            type_text(field.type),
            "" if field.required else _default(field.default),
            comments.get(field.name, "").rstrip(","),
        )
        for index, field in enumerate(info.fields)
    ]


def type_text(info: types.Type) -> str:
    """A type and its range in words."""
    match info:
        case types.UnionType(types=members):
            rest = [type_text(member) for member in members if not _is_none(member)]
            text = " or ".join([*rest, *(["null"] if len(rest) < len(members) else [])])
        case types.VarTupleType(item_type=item, max_length=most):
            text = f"array of{'' if most is None else f' up to {most:,}'} ({type_text(item)})"
        case types.StructType(cls=cls):
            text = f"[{cls.__name__}](#{cls.__name__.lower()})"
        case types.EnumType(cls=cls):
            text = "one of " + ", ".join(f'"{member.value}"' for member in cls)
        case types.FloatType():
            text = "float" + _bounds(info)
        case types.IntType():
            text = "int" + _bounds(info)
        case types.StrType(min_length=least, max_length=most):
            text = "text" + (f", {least or 0} to {most} characters" if most is not None else "")
        case types.BoolType():
            text = "bool"
        case types.BytesType(max_length=most):
            text = "bytes" + ("" if most is None else f", up to {most:,}")
        case _:
            raise TypeError(f"no words for {info}")
    return text


def _is_none(info: types.Type) -> bool:
    return isinstance(info, types.NoneType)


def _bounds(info: types.FloatType | types.IntType) -> str:
    low = f"above {_number(info.gt)}" if info.gt is not None else _number(info.ge)
    return f", {low} to {_number(info.le)}" if info.le is not None else ""


def _number(value: float | None) -> str:
    assert value is not None, "both bounds are given"
    return POWERS.get(value, f"{value:g}")


def _default(value: Any) -> str:
    """A default as it would stand on the wire."""
    if value is None:
        return "null"
    if isinstance(value, Enum):
        return str(value.value)
    return msgspec.json.encode(value).decode()
