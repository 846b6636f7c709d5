"""Sets of parameters for a whole society: TOML files with one table per agent.

The shipped set `thesis` follows the thesis literally. Without a set agents have their defaults.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from armadico.config.lines import line_of
from armadico.config.loading import Document, document, read_text, set_values
from armadico.config.shipped import find
from armadico.config.writing import write_files
from armadico.core.config_errors import ConfigError, ConfigNameError
from armadico.core.discovery import agent_class
from armadico.core.errors import UnknownNameError


def load_set(name_or_path: str | Path) -> dict[str, tuple[str, ...]]:
    """The settings of a set by agent, in the form of `--set`.

    Raises ConfigError for a value that an agent would reject, ImportError for a broken agent.
    """
    path = find("parameters", name_or_path)
    text = read_text(path)
    found = {}
    for agent, table in document(text, path).items():
        if not isinstance(table, dict):
            line = line_of(text, (agent,))
            raise ConfigError(f"{agent}: expected a table, [{agent}]", path, line)
        found[agent] = tuple(setting for _, setting in _settings(table))
        _check(agent, table, path, text)
    return found


SAVED: Final = "parameters.toml"
"""The default file of saved live changes."""

_TABLE: Final = re.compile(r"^\s*\[")
"""A line that begins a table."""


def save(path: Path, agent: str, values: Mapping[str, bool | float | str | None]) -> None:
    """Write parameters of an agent into a set, which is created if needed; the rest is kept.

    None removes a parameter. Raises ConfigError if the file cannot be changed or written.
    """
    there = path.exists() and (path.is_file() or path.is_dir())  # reading a pipe would block
    text = read_text(path) if there else ""
    lines = text.splitlines()
    for name, value in values.items():
        _write(lines, agent, name, value)
    made = "\n".join(lines).strip("\n") + "\n"
    wanted = _flat(document(text, path)) | {f"{agent}.{k}": v for k, v in values.items()}
    try:
        written = _flat(document(made, path))
    except ConfigError:
        written = {}
    if written != {name: value for name, value in wanted.items() if value is not None}:
        names = ", ".join(f"{agent}.{name}" for name in values)
        raise ConfigError(f"{names}: cannot be added to this file; edit it by hand", path)
    try:
        write_files({path: made.encode()})
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        what = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot be written: {what}", path) from None


def _flat(table: Document, at: str = "") -> Document:
    """All values by dotted names."""
    found: Document = {}
    for key, value in table.items():
        found |= _flat(value, f"{at}{key}.") if isinstance(value, dict) else {f"{at}{key}": value}
    return found


def _write(lines: list[str], agent: str, name: str, value: bool | float | str | None) -> None:
    """Write one line of a table in place of the old one; None removes it."""
    header = f"[{agent}]"
    at = next((n for n, line in enumerate(lines) if line.split("#")[0].strip() == header), None)
    if at is None:
        lines += ["", header]
        at = len(lines) - 1
    end = next((n for n in range(at + 1, len(lines)) if _TABLE.match(lines[n])), len(lines))
    old = [n for n in range(at + 1, end) if lines[n].partition("=")[0].strip() == name]
    new = [] if value is None else [f"{name} = {json.dumps(value)}"]
    if old:
        lines[old[0] : old[0] + 1] = new
    else:
        lines[at + 1 : at + 1] = new


def _check(agent: str, table: Document, path: Path, text: str) -> None:
    """Raises ConfigError for a value that the agent would reject."""
    try:
        parameters = agent_class(agent).parameters()
    except UnknownNameError as error:
        line = line_of(text, (agent,))
        raise ConfigNameError(error.kind, agent, error.known, path, line) from None
    for place, setting in _settings(table):
        try:
            set_values(parameters, [setting])
        except ConfigError as error:
            raise error.at(path, line_of(text, (agent, *place)), f"{agent}: ") from None


def _settings(table: Document, at: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    """(path, setting) of each value of an agent's table."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _settings(value, (*at, key))
        else:
            yield (*at, key), f"{'.'.join((*at, key))}={json.dumps(value)}"
