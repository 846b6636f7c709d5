"""The line of a value in a TOML text.

tomllib reports lines of syntax errors only. The line of any other value is searched by its path of
keys and indices.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence

Path = tuple[str | int, ...]
"""The path of a value: `("sonar", "sonars", 3, "x_m")`."""

_HEADER = re.compile(r"^\s*(\[\[?)([^\[\]]+)\]\]?\s*(?:#.*)?$")
_NAME = r"""(?:[\w-]+|"[^"]*"|'[^']*')"""
_KEY = re.compile(rf"^\s*({_NAME}(?:\s*\.\s*{_NAME})*)\s*=")


def line_of(text: str, path: Sequence[str | int]) -> int | None:
    """The line, from 1, of the value at `path`, or of its nearest parent that has a line."""
    places = _places(text)
    for length in range(len(path), 0, -1):
        line = places.get(tuple(path[:length]))
        if line is not None:
            return line
    return None


def _places(text: str) -> dict[Path, int]:
    """The lines of all keys, headers, and elements of arrays with one element a line."""
    places: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    table: Path = ()
    array: Path | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        if array is not None:
            array = _element(places, counts, array, line, number)
        elif header := _HEADER.match(line):
            table = _keys(header[2])
            if header[1] == "[[":
                places.setdefault(table, number)
                table = _next(counts, table)
            places.setdefault(table, number)
        elif key := _KEY.match(line):
            place = (*table, *_keys(key[1]))
            places.setdefault(place, number)
            array = place if _opens(line[key.end() :]) else None
    return places


def _element(
    places: dict[Path, int], counts: dict[Path, int], array: Path, line: str, number: int
) -> Path | None:
    stripped = line.strip()
    if stripped.startswith("]"):
        return None
    if stripped and not stripped.startswith("#"):
        places[_next(counts, array)] = number
    return array


def _next(counts: dict[Path, int], array: Path) -> Path:
    """The path of an array's next element."""
    index = counts.get(array, 0)
    counts[array] = index + 1
    return (*array, index)


def _opens(value: str) -> bool:
    """Whether a value is an array that continues on the next lines."""
    return value.split("#", maxsplit=1)[0].strip() == "["


def _keys(dotted: str) -> tuple[str, ...]:
    """The keys of `a."b.c".d`, by the TOML parser."""
    keys: list[str] = []
    node: object = tomllib.loads(f"{dotted} = 0")
    while isinstance(node, dict):
        key, node = next(iter(node.items()))
        keys.append(key)
    return tuple(keys)
