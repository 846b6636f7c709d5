"""A set of parameters for a whole society: a TOML file with a table for each agent.

`thesis` is shipped: the text read literally. Without a set each agent has its own defaults.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from armadico.config.discovery import UnknownNameError, agent_class
from armadico.config.errors import ConfigError
from armadico.config.lines import line_of
from armadico.config.loading import document, read_text, set_values
from armadico.config.shipped import find


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


def _check(agent: str, table: dict[str, Any], path: Path, text: str) -> None:
    """Raises ConfigError with the line of what the agent would refuse."""
    try:
        parameters = agent_class(agent).parameters()
    except UnknownNameError as error:
        raise ConfigError(str(error), path, line_of(text, (agent,))) from None
    for place, setting in _settings(table):
        try:
            set_values(parameters, [setting])
        except ConfigError as error:
            line = line_of(text, (agent, *place))
            raise ConfigError(f"{agent}: {error.message}", path, line) from None


def _settings(
    table: dict[str, Any], at: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Where each value of an agent's table is, and the setting that it is."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _settings(value, (*at, key))
        else:
            yield (*at, key), f"{'.'.join((*at, key))}={json.dumps(value)}"
