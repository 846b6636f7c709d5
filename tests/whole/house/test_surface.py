"""The public surface: `armadico` has exactly these names, and costs nothing to import."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys

import pytest

import armadico
from tests.whole.docs.blocks import Block, blocks
from tests.whole.house.tree import modules, tree


def for_type_checkers() -> dict[str, str]:
    """The names that a type checker is told of, and their modules."""
    known = next(node for node in tree(modules()["armadico"]).body if isinstance(node, ast.If))
    return {
        alias.name: str(node.module)
        for node in known.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def test_each_name_is_what_type_checkers_take_it_for() -> None:
    known = for_type_checkers()
    assert set(known) == set(armadico.__all__)
    for name, module in known.items():
        assert getattr(armadico, name) is getattr(importlib.import_module(module), name)


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Arbiter'"):
        armadico.Arbiter  # noqa: B018


def test_importing_it_loads_nothing() -> None:
    call = "import sys; before = {*sys.modules}; import armadico; print(*{*sys.modules} - before)"
    done = subprocess.run(
        [sys.executable, "-c", call], capture_output=True, text=True, check=True, cwd="/"
    )
    assert done.stdout.split() == ["armadico"]


def test_an_agent_of_ones_own_loads_no_mesh_and_no_other_agent() -> None:
    call = (
        "import sys; from armadico import WHEELS, Behaviour, Bid, Obstacles, Parameters, Pose; "
        "print(*(m for m in sys.modules if m.startswith(('zenoh', 'armadico.agents'))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", call], capture_output=True, text=True, check=True, cwd="/"
    )
    assert done.stdout.split() == []


PAGES = {f"docs/{name}.md" for name in ("api", "own-agent", "own-resource", "own-task")}
PYTHON = [block for block in blocks() if block.language == "python" and block.document in PAGES]


@pytest.mark.parametrize("block", PYTHON, ids=str)
def test_what_documents_show_imports_of_ours_only_the_surface(block: Block) -> None:
    ours = {
        node.module if isinstance(node, ast.ImportFrom) else alias.name
        for node in ast.walk(ast.parse(block.text))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    }
    shown = {name for name in ours if str(name).startswith("armadico")}
    assert shown <= {
        *("armadico", "armadico.testing", "armadico.contracts", "armadico.agents.missions.api")
    }
