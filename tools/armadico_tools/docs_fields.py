"""The fields of messages for the protocol page: index, type, range and default.

Ranges come from the annotations that `decode` checks. The meaning of a field is the comment beside
it, or the text below it, in the message's definition.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Final

import msgspec
from msgspec import inspect as types

from armadico.core.messages import Message
from armadico.core.services import Service, message_types, services

COMMENT: Final = re.compile(r"^ {4}(\w+): .*?  # (.+)$", re.MULTILINE)

BELOW: Final = re.compile(r'^ {4}(\w+): [^\n]*\n {4}"""(.+?)"""$', re.MULTILINE | re.DOTALL)

POWERS: Final = {2**52: "2^52", 2**63 - 1: "2^63 - 1", 1e6: "1e6", -1e6: "-1e6"}
"""Bounds that are easier to read as powers."""


@dataclass(frozen=True)
class Field:
    """One element of a message's array."""

    index: int
    name: str
    type: str
    default: str  # for a shorter array; "": the field is required
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


def parameters_of(kind: type[msgspec.Struct]) -> Iterator[Field]:
    """The parameters of an agent by dotted names, including those of nested structs."""
    yield from _nested(kind, kind(), "")


def _nested(kind: type[msgspec.Struct], default: object, prefix: str) -> Iterator[Field]:
    comments: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):  # without `object`; a subclass may override
        if base.__module__.startswith("armadico."):
            comments |= COMMENT.findall(inspect.getsource(base))
    info = types.type_info(kind)
    assert isinstance(info, types.StructType), f"{kind.__name__} is a struct"
    for index, field in enumerate(info.fields):
        value, name = getattr(default, field.name), f"{prefix}{field.name}"
        if isinstance(field.type, types.StructType):
            yield from _nested(field.type.cls, value, f"{name}.")
            continue
        text = f"{value:.4g}" if isinstance(value, float) else _default(value)
        meaning = comments.get(field.name, "").rstrip(",")
        # Without the links to messages of the protocol page.
        kinds = re.sub(r"\[(\w+)\]\(#\w+\)", r"\1", type_text(field.type))
        yield Field(index, name, kinds, text, meaning)


def type_text(info: types.Type) -> str:
    """A type and its range in words."""
    match info:
        case types.UnionType(types=members):
            rest = [type_text(member) for member in members if not _is_none(member)]
            text = " or ".join([*rest, *(["null"] if len(rest) < len(members) else [])])
        case types.VarTupleType(item_type=item, max_length=most):
            text = f"array of{'' if most is None else f' up to {most:,}'} ({type_text(item)})"
        case types.DictType(value_type=value):
            text = f"table of name = {type_text(value)}"
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
        case types.LiteralType(values=values):
            text = "one of " + ", ".join(f'"{value}"' for value in values)
        case types.BytesType(max_length=most):
            text = "bytes" + ("" if most is None else f", up to {most:,}")
        case _:
            raise TypeError(f"no words for {info}")
    return text


def _is_none(info: types.Type) -> bool:
    return isinstance(info, types.NoneType)


def _bounds(info: types.FloatType | types.IntType) -> str:
    low = None if info.ge is None else _number(info.ge)
    low = low if info.gt is None else f"above {_number(info.gt)}"
    if info.le is not None:
        return f", {low} to {_number(info.le)}" if low else f", at most {_number(info.le)}"
    return "" if low is None else f", {low}" if info.gt is not None else f", at least {low}"


def _number(value: float) -> str:
    return POWERS.get(value, f"{value:g}")


def _default(value: object) -> str:
    """A default in the form of the wire."""
    if value is None:
        return "null"
    if isinstance(value, Enum):
        return str(value.value)
    return msgspec.json.encode(value).decode()
