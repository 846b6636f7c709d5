"""Parameters that may be changed while their agent runs.

An agent's class names them with their units (`Agent.changeable`). The allowed values come from the
types of the parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, TypeVar

import msgspec
from msgspec import inspect, structs

from armadico.core.errors import no_such
from armadico.core.messages import Parameter, Setting
from armadico.core.parameters import Parameters

P = TypeVar("P", bound=Parameters)

MOST_FIXED: Final = 16_000
"""Most characters of the fixed parameters in a reply."""


@dataclass(frozen=True)
class Allowed:
    """The allowed values of a parameter."""

    wanted: str  # for people
    least: float | None = None
    most: float | None = None
    words: tuple[str, ...] = ()
    optional: bool = False


def allowed(kind: type[Parameters], units: Mapping[str, str]) -> Mapping[str, Allowed]:
    """Return the allowed values of the parameters in `units`, by name, with dots into tables.

    Raises ValueError for an unknown parameter, or one that is neither a number, nor a word, nor a
    truth value.
    """
    return _allowed(kind, tuple(units.items()))


def listed(now: Parameters, begun: Parameters, units: Mapping[str, str]) -> tuple[Parameter, ...]:
    """Return the changeable parameters with their values now and at the start."""
    values, first = msgspec.to_builtins(now), msgspec.to_builtins(begun)
    return tuple(
        Parameter(
            name,
            _json(_value(values, name)),
            _json(_value(first, name)),
            units[name],
            may.wanted,
            may.least,
            may.most,
            may.words,
            may.optional,
        )
        for name, may in allowed(type(now), units).items()
    )


def changed(now: P, units: Mapping[str, str], settings: Sequence[Setting]) -> P:
    """Return the parameters with all of the settings applied.

    Raises ValueError with the wrong value and the allowed ones.
    """
    known = allowed(type(now), units)
    values = msgspec.to_builtins(now)
    for setting in settings:
        name = setting.name
        if name not in known:
            raise ValueError(_unknown(name, now, known))
        try:
            value = msgspec.json.decode(setting.json)
            _put(values, name, value)
            msgspec.convert(values, type(now))
        except (msgspec.MsgspecError, RecursionError, ValueError):
            raise ValueError(f"{name} = {setting.json}: expected {known[name].wanted}") from None
    return msgspec.convert(values, type(now))


def differences(before: Parameters, now: Parameters, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return (name, JSON before, JSON now) of those of the named parameters that differ."""
    old, new = msgspec.to_builtins(before), msgspec.to_builtins(now)
    both = [(name, _json(_value(old, name)), _json(_value(new, name))) for name in names]
    return [row for row in both if row[1] != row[2]]


def fixed(now: Parameters, units: Mapping[str, str]) -> tuple[Setting, ...] | None:
    """Return the parameters that are not changeable and differ from the defaults of their class.

    None: they do not fit into a reply.
    """
    try:
        usual = msgspec.to_builtins(type(now)())
    except TypeError:  # some have no default
        usual = {}
    found = differing(msgspec.to_builtins(now), usual)
    rows = [Setting(name, _json(value)) for name, value in found if name not in units]
    size = sum(len(row.name) + len(row.json) for row in rows)
    fit = size <= MOST_FIXED and all(len(row.json) <= 2000 for row in rows) and len(rows) <= 256
    return tuple(rows) if fit else None


def differing(values: Mapping[str, Any], usual: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the values that differ from the usual ones, by their names with dots into tables."""
    for name, value in values.items():
        other = usual.get(name)
        if isinstance(value, dict) and value != other:
            below = differing(value, other if isinstance(other, dict) else {})
            yield from ((f"{name}.{key}", inner) for key, inner in below)
        elif value != other:
            yield name, value


def _unknown(name: str, parameters: Parameters, known: Mapping[str, Allowed]) -> str:
    """Return the error for a parameter that does not exist or is not changeable."""
    if not known:
        return "no parameter of this agent can be changed while it runs"
    try:
        _field(type(parameters), name)
    except KeyError:
        return no_such("parameter", name, known)
    listed = f"can be changed: {', '.join(sorted(known))}"
    return f"{name} cannot be changed while the agent runs ({listed})"


@cache
def _allowed(kind: type[Parameters], units: tuple[tuple[str, str], ...]) -> dict[str, Allowed]:
    found = {}
    for name, unit in units:
        try:
            found[name] = _read(_field(kind, name), unit)
        except KeyError:
            raise ValueError(f"changeable: no parameter {name!r}") from None
        except TypeError as error:
            raise ValueError(f"changeable: {name} is {error}") from None
    return found


def _field(kind: type[Parameters], name: str) -> inspect.Type:
    """Return the type of a parameter. Raises KeyError if there is none of that name."""
    node: object = kind
    for part in name.split("."):
        node = _types(node)[part]
    return _bare(inspect.type_info(node))


@cache
def _types(kind: object) -> dict[str, object]:
    """Return the types of a struct's fields, by name; empty for another type."""
    if not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
        return {}
    return {field.encode_name: field.type for field in structs.fields(kind)}


def _bare(node: inspect.Type) -> inspect.Type:
    return node.type if isinstance(node, inspect.Metadata) else node


def _read(node: inspect.Type, unit: str) -> Allowed:
    """Return the allowed values of a type. Raises TypeError if it is no single simple type."""
    options = list(map(_bare, node.types)) if isinstance(node, inspect.UnionType) else [node]
    kinds = [option for option in options if not isinstance(option, inspect.NoneType)]
    optional = len(kinds) < len(options)
    or_none = ", or none" if optional else ""
    if len(kinds) != 1:
        raise TypeError("of several types")
    (one,) = kinds
    if isinstance(one, inspect.FloatType | inspect.IntType):
        what = "a number" if isinstance(one, inspect.FloatType) else "a whole number"
        bounds = [
            (one.gt, "above"),
            (one.ge, "at least"),
            (one.lt, "below"),
            (one.le, "at most"),
        ]
        limits = ", ".join(f"{word} {bound:g}" for bound, word in bounds if bound is not None)
        wanted = " ".join(part for part in (what, limits, unit) if part)
        least = one.gt if one.ge is None else one.ge
        most = one.lt if one.le is None else one.le
        return Allowed(f"{wanted}{or_none}", least, most, (), optional)
    if isinstance(one, inspect.BoolType):
        return Allowed(f"true or false{or_none}", optional=optional)
    if isinstance(one, inspect.LiteralType):
        words = tuple(str(word) for word in one.values)
        return Allowed(f"one of {', '.join(words)}{or_none}", words=words, optional=optional)
    raise TypeError("neither a number, nor a word, nor true or false")


def _value(values: Any, name: str) -> Any:
    for part in name.split("."):
        values = values[part]
    return values


def _put(values: Any, name: str, value: object) -> None:
    *tables, last = name.split(".")
    for part in tables:
        values = values[part]
    values[last] = value


def _json(value: object) -> str:
    return msgspec.json.encode(value).decode()
