"""Which keys a struct knows, so that a misspelt one is named with its nearest neighbour.

msgspec refuses unknown keys only of structs that ask for it, and says nothing of what they know.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any

from msgspec import inspect

Path = tuple[str | int, ...]


def unknown_field(data: Any, kind: type) -> Path | None:
    """The path of the first key in `data` that the struct `kind` does not know."""
    return next(_unknown(data, _shape(kind), ()), None) if data else None  # the defaults


def known_fields(kind: type, path: Sequence[str | int]) -> list[str]:
    """The keys that a struct knows, at a path within `kind`."""
    node = _shape(kind)
    for step in path:
        node = _below(node, step)
    struct = _struct(node)
    return [field.encode_name for field in struct.fields] if struct else []


def choices(kind: type, path: Sequence[str | int]) -> list[str]:
    """The words that a `Literal` field may be, at a path within `kind`."""
    node = _shape(kind)
    for step in path:
        node = _below(node, step)
    literals = [option for option in _options(node) if isinstance(option, inspect.LiteralType)]
    return [str(value) for literal in literals for value in literal.values]


@cache
def _shape(kind: type) -> inspect.Type:
    """What msgspec knows of a type; it takes 10 ms for a robot's, which each agent loads."""
    return inspect.type_info(kind)


def _unknown(data: Any, node: inspect.Type, path: Path) -> Iterator[Path]:
    struct = _struct(node)
    for step, value in _items(data):
        below = _below(node, step)
        if struct and isinstance(data, dict) and isinstance(below, inspect.AnyType):
            if step not in {field.encode_name for field in struct.fields}:
                yield (*path, step)
            continue
        yield from _unknown(value, below, (*path, step))


def _items(data: Any) -> Iterable[tuple[str | int, Any]]:
    if isinstance(data, dict):
        return list(data.items())
    return list(enumerate(data)) if isinstance(data, list | tuple) else ()


def _below(node: inspect.Type, step: str | int) -> inspect.Type:
    """The type one step further down; AnyType where none is declared."""
    below: inspect.Type = inspect.AnyType()
    for option in _options(node):
        if isinstance(option, inspect.StructType):
            found = [field.type for field in option.fields if field.encode_name == step]
            below = found[0] if found else below
        elif isinstance(option, inspect.DictType):
            below = option.value_type
        elif isinstance(option, inspect.ListType | inspect.VarTupleType):
            below = option.item_type
    return below


def _struct(node: inspect.Type) -> inspect.StructType | None:
    return next((o for o in _options(node) if isinstance(o, inspect.StructType)), None)


def _options(node: inspect.Type) -> tuple[inspect.Type, ...]:
    node = node.type if isinstance(node, inspect.Metadata) else node
    return node.types if isinstance(node, inspect.UnionType) else (node,)
