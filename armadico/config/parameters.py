"""A set of parameters for a whole society: a TOML file with a table for each agent.

`thesis` is shipped: the text read literally. Without a set each agent has its own defaults.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from armadico.config.errors import ConfigError
from armadico.config.lines import line_of
from armadico.config.loading import document, read_text
from armadico.config.shipped import find


def load_set(name_or_path: str | Path) -> dict[str, tuple[str, ...]]:
    """For each agent the settings of a set, as `--set` takes them. Raises ConfigError."""
    path = find("parameters", name_or_path)
    text = read_text(path)
    found = {}
    for agent, table in document(text, path).items():
        if not isinstance(table, dict):
            line = line_of(text, (agent,))
            raise ConfigError(f"{agent}: expected a table, [{agent}]", path, line)
        found[agent] = tuple(_settings(table))
    return found


def _settings(table: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _settings(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}={json.dumps(value)}"
