"""What is read of Nav2's parameter files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import yaml

from armadico.config.loading import read_text
from armadico.core.config_errors import ConfigError
from armadico.core.unseen import DRIVE, REFUSE, Rule

LONGEST: Final = 1_000_000
"""Most bytes of a parameter file."""

PLANNERS: Final = "planner_server"


def unseen_rule(path: Path | str) -> Rule:
    """`refuse` if a planner's `allow_unknown` is false, else `drive`. Raises ConfigError."""
    text = read_text(path, LONGEST)
    try:
        root = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = None if mark is None else mark.line + 1
        raise ConfigError("not YAML", path, line) from None
    planners = [*_values(root, PLANNERS)]
    if not planners:
        raise ConfigError(f"not Nav2's parameters: no key {PLANNERS}", path)
    allowed = [value for planner in planners for value in _values(planner, "allow_unknown")]
    for value in allowed:
        if not isinstance(value, bool):
            raise ConfigError(f"allow_unknown: {value!r}: expected true or false", path)
    return DRIVE if all(allowed) else REFUSE  # Nav2's default is true


def _values(node: object, key: str) -> Iterator[object]:
    """All values of a key, at any depth of the tables."""
    for name, value in node.items() if isinstance(node, dict) else ():
        if name == key:
            yield value
        else:
            yield from _values(value, key)
