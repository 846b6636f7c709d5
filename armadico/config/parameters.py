"""A set of parameters for a whole society: a TOML file with a table for each agent.

`thesis` is shipped: the text read literally. Without a set each agent has its own defaults.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from armadico.config.discovery import agent_class
from armadico.config.errors import ConfigError, ConfigNameError
from armadico.config.lines import line_of
from armadico.config.loading import document, read_text, set_values
from armadico.config.shipped import find
from armadico.config.writing import write_files
from armadico.core.errors import UnknownNameError


def load_set(name_or_path: str | Path) -> dict[str, tuple[str, ...]]:
    """For each agent the settings of a set, as `--set` takes them.

    Raises ConfigError with the line of what the agent would refuse, ImportError if one is broken.
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
"""Where live changes are saved, unless another file is named."""

_TABLE: Final = re.compile(r"^\s*\[")
"""A line that begins a table."""


def save(path: Path, agent: str, values: Mapping[str, bool | float | str | None]) -> None:
    """Write some of an agent's parameters into a set, which need not be there; the rest stays.

    None takes one out. Raises ConfigError if there is no place for them in what is there, or if it
    cannot be written.
    """
    there = path.exists() and (path.is_file() or path.is_dir())  # a pipe would never end
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
        raise ConfigError(f"{names}: no place beside what is written there; write it there", path)
    try:
        write_files({path: made.encode()})
    except (OSError, ValueError) as error:  # a name with a zero in it, too
        what = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot be written: {what}", path) from None


def _flat(table: dict[str, Any], at: str = "") -> dict[str, Any]:
    """All values, by their names with dots."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        found |= _flat(value, f"{at}{key}.") if isinstance(value, dict) else {f"{at}{key}": value}
    return found


def _write(lines: list[str], agent: str, name: str, value: bool | float | str | None) -> None:
    """One line of a table, in place of the one that was there; None: no line."""
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


def _check(agent: str, table: dict[str, Any], path: Path, text: str) -> None:
    """Raises ConfigError with the line of what the agent would refuse."""
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


def _settings(
    table: dict[str, Any], at: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Where each value of an agent's table is, and the setting that it is."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _settings(value, (*at, key))
        else:
            yield (*at, key), f"{'.'.join((*at, key))}={json.dumps(value)}"
