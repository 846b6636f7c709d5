"""What mypyc cannot make of the modules that are compiled, without the minutes that it takes."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tests.house.tree import ROOT


def compiled() -> list[Path]:
    """The modules that `setup.py` has compiled, and a few more of the simulated robot's."""
    said = re.findall(r'"([\w/]+)"', (ROOT / "setup.py").read_text())
    paths = [path for name in said if (path := ROOT / f"{name}.py").is_file()]
    return [*paths, *(ROOT / "bridge" / "simulator").glob("*.py")]


def test_names_of_any_kind_follow_no_default() -> None:
    """mypyc 2.4: "non-default argument follows default argument", and nothing is compiled."""
    assert len(compiled()) > 30
    both = [
        f"{path.name}: {node.name}"
        for path in compiled()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef) and node.args.kwarg and node.args.defaults
    ]
    assert not both


def test_no_constant_is_a_tuple_that_begins_with_a_number_and_has_no_type() -> None:
    """mypyc 2.4 looks at the first number of such a tuple, and finds that it "was not set".

    `Final[tuple[float, ...]]` is an object like others.
    """
    bare = [
        f"{path.name}: {ast.unparse(node.target)}"
        for path in compiled()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.AnnAssign)
        and ast.unparse(node.annotation) == "Final"
        and isinstance(node.value, ast.Tuple)
        and node.value.elts
        and isinstance(first := node.value.elts[0], ast.Constant)
        and isinstance(first.value, (int, float))
    ]
    assert not bare
