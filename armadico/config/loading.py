"""TOML files as frozen structs (`msgspec.Struct`). Errors have the file, the line and the value.

Any struct can be loaded: `load(find("worlds", "mine.toml"), Mine)`.
"""

from __future__ import annotations

import re
import tomllib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from armadico.config.fields import choices, known_fields, unknown_field
from armadico.config.lines import line_of
from armadico.config.shipped import find, names, resource_path
from armadico.core.config_errors import ConfigError, ConfigNameError, ConfigValueError, advice

__all__ = [
    "ConfigError",
    "convert",
    "find",
    "load",
    "load_entry",
    "load_parameters",
    "load_table",
    "names",
    "parse",
    "parse_entries",
    "resource_path",
    "set_values",
]

T = TypeVar("T")
LONGEST: Final = 64_000_000
"""Most bytes of a file; maps with many walls are the largest."""

Document = dict[str, object]

WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "a string",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "none",
}
"""The types that msgspec names, in the words of TOML."""

_PATH = re.compile(r"^(?P<what>.*?)(?: - at `\$?(?P<path>.*)`)?$", re.DOTALL)
_STEP = re.compile(r"\.(?P<key>[^.\[\]]+)|\[(?:(?P<index>\d+)|\.\.\.)\]")
_LINE = re.compile(r"^(?P<what>.*) \(at (?:line (?P<line>\d+), column \d+|end of document)\)$")
_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`$", re.DOTALL)
_RANGE = re.compile(r"Expected `(\w+)` (>|>=|<|<=) (.+)")


def load(path: Path | str, kind: type[T]) -> T:
    """Read a TOML file into a `kind`. Raises ConfigError."""
    return parse(read_text(path), kind, path)


def load_table(path: Path | str, kind: type[T]) -> dict[str, T]:
    """Read a file of named `kind`s, one table `[name]` each. Raises ConfigError."""
    text = read_text(path)
    return parse_entries(document(text, path), kind, path, text)


def parse_entries(
    entries: Mapping[str, object], kind: type[T], file: Path | str, text: str
) -> dict[str, T]:
    """Entries of a file's `text` as `kind`s; the name "" is the whole file. Raises ConfigError."""
    return {
        name: convert(entry, kind, file, text, (name,) if name else ())
        for name, entry in entries.items()
    }


def load_entry(path: Path | str, kind: type[T], name: str) -> T:
    """One entry of a file that `load_table` reads. Raises ConfigError."""
    entries = load_table(path, kind)
    if name not in entries:
        raise ConfigNameError("entry", name, entries, path)
    return entries[name]


def read_text(path: Path | str, longest: int = LONGEST, or_else: str | None = None) -> str:
    """The text of a file in UTF-8, UTF-16 or `or_else`, without a BOM. Raises ConfigError."""
    try:
        with Path(path).open("rb") as file:  # bounded, since a device may have no end
            data = file.read(longest + 1)
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", path) from None
    if len(data) > longest:
        raise ConfigError(f"expected at most {longest:,} bytes", path)
    coded = "utf-16" if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig"
    try:
        text = data.decode(coded)
    except UnicodeDecodeError:
        if or_else is None:
            raise ConfigError("expected a text in UTF-8", path) from None
        text = data.decode(or_else)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def parse(text: str, kind: type[T], file: Path | str = "<text>") -> T:
    """A TOML text as a `kind`; `file` is its name in errors. Raises ConfigError."""
    return convert(document(text, file), kind, file, text)


def document(text: str, file: Path | str) -> Document:
    """A TOML text as dicts and lists. Raises ConfigError."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = _LINE.match(str(error))
        what, line = (found["what"], found["line"]) if found else (str(error), None)
        last = max(len(text.splitlines()), 1)
        raise ConfigError(f"not TOML: {what}", file, int(line) if line else last) from None
    except RecursionError:
        raise ConfigError("not TOML: lists and tables are nested too deeply", file) from None
    except ValueError as error:  # a number with thousands of digits
        raise ConfigError(f"not TOML: {error}", file) from None


def load_parameters(kind: type[T], file: Path | str | None, sets: Sequence[str]) -> T:
    """An agent's parameters: its defaults, then a file's values, then each `key=value`."""
    if file is None:
        return set_values(convert({}, kind, "the defaults", ""), sets)
    return set_values(load(file, kind), sets)


def set_values(value: T, sets: Sequence[str]) -> T:
    """The struct with some values changed, as by `--set zones.stop=0.2`.

    A value is written as in TOML, or else is a string; `none` clears an optional value. Raises
    ConfigError, which quotes the setting.
    """
    for setting in sets:
        value = _set_value(value, setting)
    return value


def _set_value(value: T, setting: str) -> T:
    key, equals, text = setting.partition("=")
    keys = [part.strip() for part in key.split(".")]
    if not equals or not all(keys):
        raise ConfigError(f"--set {setting}: expected KEY=VALUE, such as zones.stop=0.2")
    first: ConfigError | None = None
    for candidate in _readings(text.strip()):
        changed: Document = msgspec.to_builtins(value)
        _put(changed, keys, candidate)
        try:
            return convert(changed, type(value), f"--set {setting}", "")
        except ConfigError as error:
            first = first or error
    assert first is not None, "a setting has at least one reading"
    raise first


def _readings(text: str) -> list[object]:
    """The possible meanings of a value on the command line, the likeliest first."""
    if text == "none":
        return [None, text]
    try:
        return [tomllib.loads(f"value = {text}")["value"], text]
    except tomllib.TOMLDecodeError:
        return [text]


def _put(node: Document, keys: Sequence[str], value: object) -> None:
    for key in keys[:-1]:
        below = node.setdefault(key, {})
        if not isinstance(below, dict):
            below = node[key] = {}
        node = below
    node[keys[-1]] = value


def convert(
    data: object, kind: type[T], file: Path | str, text: str, at: tuple[str | int, ...] = ()
) -> T:
    """`data`, which is at the path `at` of a text, as a `kind`. Raises ConfigError."""
    try:
        value = msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        found = _PATH.match(str(error))
        assert found is not None, "the pattern matches anything"
        inner = _steps(data, kind, found["path"] or "")
        key = _UNKNOWN.match(found["what"])
        if key is not None:
            raise _unknown(kind, (*inner, key[1]), file, text, at) from None
        error_ = _explained(_value(data, inner), at + inner, found["what"], choices(kind, inner))
        raise error_.at(file, line_of(text, at + inner)) from None
    unknown = unknown_field(data, value)  # in structs that do not forbid unknown keys
    if unknown is not None:
        raise _unknown(kind, unknown, file, text, at)
    return value


def _unknown(
    kind: type,
    path: tuple[str | int, ...],
    file: Path | str,
    text: str,
    at: tuple[str | int, ...],
) -> ConfigError:
    """The error for an unknown key of `kind`."""
    key, known = str(path[-1]), known_fields(kind, path[:-1])
    message = f"unknown key {_dotted(at + path)}; {advice(key, known)}"
    return ConfigNameError("key", key, known, file, line_of(text, at + path), message)


def _steps(data: object, kind: type, path: str) -> tuple[str | int, ...]:
    """The keys and indices of msgspec's path `.a.b[3]`.

    In a table with arbitrary keys msgspec reports `[...]`, so the key is searched.
    """
    steps: tuple[str | int, ...] = ()
    for step in _STEP.finditer(path):
        if step["index"] is not None:
            steps = (*steps, int(step["index"]))
        else:
            steps = (*steps, step["key"] or _wrong_key(data, kind, steps, path))
    return steps


def _wrong_key(data: object, kind: type, at: tuple[str | int, ...], path: str) -> str:
    """The first key of the table at `at` whose value alone gives the same error path."""
    table = _value(data, at)
    for key, value in table.items():
        try:
            msgspec.convert(_with(data, at, {key: value}), kind)
        except msgspec.ValidationError as error:
            found = _PATH.match(str(error))
            if found is not None and found["path"] == path:
                return str(key)
    return str(next(iter(table)))


def _with(data: Any, at: Sequence[str | int], value: object) -> object:
    """`data` with another value at a path."""
    if not at:
        return value
    items: Any = dict(data) if isinstance(data, dict) else list(data)
    items[at[0]] = _with(items[at[0]], at[1:], value)
    return items


def _explained(
    value: object, path: Sequence[str | int], what: str, known: Sequence[str]
) -> ConfigError:
    """The error for what msgspec reports of a value at a path, which may be one of `known`."""
    key = _dotted(path)
    begin = f"{key} = {_quoted(value)}: " if path else ""
    if what.startswith("Invalid enum value"):
        message = begin + advice(str(value), known)
        return ConfigNameError(key, str(value), known, message=message)
    if what.startswith("Object missing required field"):
        where = f" in {key}" if path else ""
        return ConfigError(f"missing key {what.split('`')[1]}{where}")
    allowed = _RANGE.sub(r"Expected a number \2 \3", what)
    allowed = re.sub(r"`([\w |]+)`", lambda kinds: _named(kinds[1]), allowed)
    allowed = allowed.replace(", got ", ", not ").replace("Expected", "expected").replace("`", "")
    return ConfigValueError(key, value, allowed.removeprefix("expected "), message=begin + allowed)


def _named(kinds: str) -> str:
    """Msgspec's `float | null` in the words of TOML."""
    return " or ".join(WORDS.get(kind, kind) for kind in kinds.split(" | "))


def _value(data: Any, path: Sequence[str | int]) -> Any:
    for step in path:
        data = data[step]
    return data


def _quoted(value: object) -> str:
    if isinstance(value, float):
        return str(value)  # JSON has no nan
    text = msgspec.json.encode(value, enc_hook=str).decode()
    return text if len(text) <= 60 else text[:57] + "..."


def _dotted(path: Sequence[str | int]) -> str:
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).lstrip(
        "."
    )
