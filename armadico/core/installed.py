"""Installed entry points, of this and of other packages; one that cannot be used is left out.

A package that fails on import, brings a name that exists, or does not fit this version is reported
on stderr with its distribution and the reason, once per process. All others work.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import (
    Distribution,
    EntryPoint,
    EntryPoints,
    PackageNotFoundError,
    entry_points,
    version,
)
from inspect import Parameter, isfunction, signature
from typing import Any, Final

GROUP: Final = "armadico.messages"  # modules that register messages and resources on import

OURS: Final = "armadico"
"""The distribution whose names no other package can take."""


def entries(group: str) -> tuple[EntryPoint, ...]:
    """The installed entry points of a group, by the present `sys.path`; ours first, by name.

    If several packages have one name, this distribution's counts, else the first on the path; the
    others are left out.
    """
    return _of_group(group, *sys.path)


@cache
def _of_group(group: str, *path: str) -> tuple[EntryPoint, ...]:
    found: dict[str, EntryPoint] = {}
    points = _entries(*path)(group=group)
    for point in sorted(points, key=lambda each: (package(each) != OURS, each.name)):
        first = found.setdefault(point.name, point)
        if (point.value, package(point)) != (first.value, package(first)):
            left_out(point, f"{package(first)} has an entry point of this name")
    return tuple(found.values())


@cache  # a search of the installed packages takes 20 ms, for one group or for all
def _entries(*_path: str) -> Callable[..., EntryPoints]:
    return entry_points().select


def package(point: EntryPoint) -> str:
    """The name of the distribution of an entry point."""
    return "" if point.dist is None else _name(point.dist)


@cache  # `name` parses all metadata, 0.5 ms for each entry point
def _name(distribution: Distribution) -> str:
    return str(distribution.name)


def version_of(name: str) -> str:
    """The version of an installed distribution; "unknown" if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


@cache
def left_out(point: EntryPoint, why: str) -> None:
    """Report once that an entry point is not used."""
    import logging

    where = f"{point.group}, {point.name} = {point.value}"
    text = "package %s: %s is left out: %s"
    logging.getLogger("armadico.installed").warning(text, package(point), where, why)


def loaded(group: str, like: type | None = None) -> Iterator[tuple[EntryPoint, Any]]:
    """Import what the entry points of a group name; with `like`, classes derived from that one."""
    for point in entries(group):
        try:
            found = point.load()
        except (Exception, SystemExit) as error:  # a module may raise anything
            left_out(point, f"{type(error).__name__}: {error}")
            continue
        if why := "" if like is None else unfit(found, like):
            left_out(point, why)
        else:
            yield point, found


def made(group: str, method: str, *arguments: object) -> list[Any]:
    """What each entry point of a group returns when it is called; it must have a method."""
    found = []
    for point, make in loaded(group):
        try:
            one = make(*arguments)
        except (Exception, SystemExit) as error:
            left_out(point, f"{type(error).__name__}: {error}")
            continue
        if callable(getattr(one, method, None)):
            found.append(one)
        else:
            left_out(point, f"returned {one!r}, which has no method {method!r}")
    return found


def unfit(found: object, like: type) -> str:
    """Why an object is no class that can be used in place of `like`; "" if it is one."""
    if not (isinstance(found, type) and issubclass(found, like)):
        return f"must be a class derived from {like.__name__}"
    for name, method in vars(like).items():
        own = getattr(found, name)
        if name.startswith("_") or not isfunction(method) or own is method:
            continue
        parameters = signature(method).parameters.values()
        named = {each.name: None for each in parameters if each.kind is Parameter.KEYWORD_ONLY}
        try:
            signature(own).bind(*(None for _ in range(len(parameters) - len(named))), **named)
        except (TypeError, ValueError):
            return f"{name} must take {signature(method)}"
    return ""


@cache
def load_all() -> None:
    """Import all modules of messages; a failing one only lacks its messages."""
    for _ in loaded(GROUP):
        pass
