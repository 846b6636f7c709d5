"""Zenoh's key expressions, compared as Zenoh does it: sans-IO.

`*` is one part of a key, `**` any number of parts, `$*` any text within a part.
"""

from __future__ import annotations

import re
from functools import cache


def covers(rule: str, key: str) -> bool:
    """Return whether a rule's key expression includes a key, or another expression, entirely."""
    return _covers(tuple(rule.split("/")), tuple(key.split("/")))


def _covers(rule: tuple[str, ...], key: tuple[str, ...]) -> bool:
    if not rule or not key:
        return all(chunk == "**" for chunk in rule) and not key
    if rule[0] == "**":
        return _covers(rule[1:], key) or _covers(rule, key[1:])
    return (
        key[0] != "**"
        and _chunk(rule[0]).fullmatch(key[0]) is not None
        and _covers(rule[1:], key[1:])
    )


@cache
def _chunk(chunk: str) -> re.Pattern[str]:
    if chunk == "*":
        return re.compile(".*", re.DOTALL)
    return re.compile(".*".join(map(re.escape, chunk.split("$*"))), re.DOTALL)


def meet(one: str, other: str) -> bool:
    """Return whether two key expressions have a key in common, as far as `$*` can be compared."""
    return _meet(tuple(one.split("/")), tuple(other.split("/")))


def _meet(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    if not one or not other:
        return all(chunk == "**" for chunk in one + other)
    if "**" in (one[0], other[0]):
        return _meet(one[1:], other) or _meet(one, other[1:])
    alike = _chunk(one[0]).fullmatch(other[0]) or _chunk(other[0]).fullmatch(one[0])
    return alike is not None and _meet(one[1:], other[1:])
