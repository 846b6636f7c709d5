"""The framework names no agent: who an agent is, its class says, found by its entry point."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator

from .tree import ROOT, modules

ROOMS = ("core", "config", "mesh", "runtime", "observe", "launch", "cli")

EXCEPTIONS = {
    ("armadico.mesh.topology", "fleet"): "the first part of keys that robots share",
    ("armadico.core.messages", "sonar"): "the sensor of whoever names none: others came later",
    ("armadico.core.tools", "goto"): "a tool: what programs ask for, and the command's name",
    ("armadico.cli.fleet", "robot"): "an option, --robot, and a column",
    ("armadico.config.scenarios", "robot"): "a key of a scenario's file: its robot's profile",
    ("armadico.config.hosts", "robot"): "a key of a host's entry: its robot's address",
    ("armadico.cli.run_options", "robot"): "an option, --robot",
    ("armadico.cli.doctor", "monitor"): "what is checked: a row of the table",
    ("armadico.cli.top", "robot"): "a part of a snapshot: what the robot does",
}
"""What is spelt like an agent and is none. Each is there, and no other is."""


def agents() -> frozenset[str]:
    """What is installed as an agent or a simulator, ours all."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = project["entry-points"]
    return frozenset({*groups["armadico.agents"], *groups["armadico.simulators"]})


def quoted(tree: ast.Module) -> Iterator[str]:
    """The strings of a module that are one word; docstrings and examples are sentences."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_there_are_agents_to_be_named() -> None:
    assert {"robot", "goto", "avoid", "gothrough", "interface", "encoder"} <= agents()
    assert "avoid" in quoted(ast.parse("HOLDERS = {None: 'x', 'avoid': 'y'}"))


def test_no_agents_name_stands_quoted_in_the_framework() -> None:
    ours = agents()
    found = {
        (name, text)
        for name, path in modules().items()
        if name.startswith(tuple(f"armadico.{room}" for room in ROOMS))
        for text in quoted(ast.parse(path.read_text(encoding="utf-8")))
        if text in ours
    }
    assert found == set(EXCEPTIONS)
