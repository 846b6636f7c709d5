"""The keys of a struct, so that an error can name the key nearest to a misspelt one.

msgspec rejects unknown keys only if a struct forbids them, and does not list the known ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

from msgspec import Struct, inspect

Path = tuple[str | int, ...]


def unknown_field(data: object, value: object) -> Path | None:
    """The path of the first key in `data` that the struct `value`, made from it, does not have."""
    return next(_unknown(data, value, ()), None)


def known_fields(kind: type, path: Sequence[str | int]) -> list[str]:
    """The keys of the struct at a path within `kind`."""
    structs = (o for o in _options(kind, path) if isinstance(o, inspect.StructType))
    struct = next(structs, None)
    return [field.encode_name for field in struct.fields] if struct else []


def choices(kind: type, path: Sequence[str | int]) -> list[str]:
    """The values of the `Literal` or `Enum` field at a path within `kind`."""
    found: list[object] = []
    for option in _options(kind, path):
        if isinstance(option, inspect.LiteralType):
            found += option.values
        elif isinstance(option, inspect.EnumType):
            found += [each.value for each in option.cls]
    return [str(value) for value in found]


@cache
def _shape(kind: type) -> inspect.Type:
    """A type as msgspec describes it; 10 ms for a robot profile, so for errors only."""
    return inspect.type_info(kind)


def _unknown(data: object, value: object, path: Path) -> Iterator[Path]:
    if isinstance(value, Struct) and isinstance(data, dict):
        kind = type(value)
        names = dict(zip(kind.__struct_encode_fields__, kind.__struct_fields__, strict=True))
        for key, item in data.items():
            if key in names:
                yield from _unknown(item, getattr(value, names[key]), (*path, key))
            elif key != kind.__struct_config__.tag_field:
                yield (*path, key)
    elif isinstance(value, dict) and isinstance(data, dict):
        for (key, item), below in zip(data.items(), value.values(), strict=False):
            yield from _unknown(item, below, (*path, key))
    elif isinstance(value, list | tuple) and isinstance(data, list | tuple):
        for index, (item, below) in enumerate(zip(data, value, strict=False)):
            yield from _unknown(item, below, (*path, index))


def _below(node: inspect.Type, step: str | int) -> inspect.Type:
    """The type one step further down; AnyType if none is declared."""
    below: inspect.Type = inspect.AnyType()
    for option in _alternatives(node):
        if isinstance(option, inspect.StructType):
            found = [field.type for field in option.fields if field.encode_name == step]
            below = found[0] if found else below
        elif isinstance(option, inspect.DictType):
            below = option.value_type
        elif isinstance(option, inspect.ListType | inspect.VarTupleType):
            below = option.item_type
    return below


def _options(kind: type, path: Sequence[str | int]) -> tuple[inspect.Type, ...]:
    """The types that the value at a path within `kind` may have."""
    node = _shape(kind)
    for step in path:
        node = _below(node, step)
    return _alternatives(node)


def _alternatives(node: inspect.Type) -> tuple[inspect.Type, ...]:
    node = node.type if isinstance(node, inspect.Metadata) else node
    return node.types if isinstance(node, inspect.UnionType) else (node,)
