"""The tree of sources as the tests of the house see it: modules, what they import, where they are.

The tree is the package: `agents/` lies beside `armadico/`, and a link in it makes a package of it.
There are two distributions, each with a project file: the product, and the laboratory in `tools/`.
"""

from __future__ import annotations

import ast
import os
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[3]

PARTS = ("agents", "bridge", "configs")
"""The packages of `armadico` that lie beside it; within it each is a link."""

PRODUCT = ("armadico", *PARTS)
LABORATORY = "tools"
FOLDERS = (*PRODUCT, LABORATORY)
"""Where there are sources, each of them once."""

JUNK = {"__pycache__", "build"}
"""What running and installing leave: `pip install ./tools` copies the sources to `tools/build`."""


def project(folder: str = ".") -> dict[str, Any]:
    """The project file of a distribution."""
    with (ROOT / folder / "pyproject.toml").open("rb") as file:
        return tomllib.load(file)


def package_files() -> Iterator[tuple[str, Path]]:
    """Everything in the packages: where it is installed, and where it is in the checkout."""
    yield from _files(ROOT, "armadico")
    yield from _files(ROOT / LABORATORY, "armadico_tools")


def _files(root: Path, package: str) -> Iterator[tuple[str, Path]]:
    for folder, inside, names in os.walk(root / package, followlinks=True):
        inside[:] = sorted(set(inside) - JUNK)
        for name in sorted(names):
            path = Path(folder, name)
            yield path.relative_to(root).as_posix(), path.resolve()


@cache
def modules() -> dict[str, Path]:
    """Every module of the packages, by name."""
    return {
        name.removesuffix(".py").removesuffix("/__init__").replace("/", "."): path
        for name, path in package_files()
        if path.suffix == ".py"
    }


@cache
def tree(path: Path) -> ast.Module:
    """A file's syntax tree."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(module: str) -> frozenset[str]:
    """Every module that a module imports, wherever in it, for type checking too."""
    found: set[str] = set()
    for node in ast.walk(tree(modules()[module])):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            assert node.module is not None, "it is absolute"
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                found.add(name if name in modules() else node.module)
    return frozenset(found)


def within(module: str, package: str) -> bool:
    """Whether a module is a package or in it."""
    return module == package or module.startswith(f"{package}.")


def sources(folder: str, pattern: str = "*.py") -> Iterator[Path]:
    """What lies in a folder of the checkout and is ours."""
    root = ROOT / folder
    for path in root.rglob(pattern):
        if not JUNK & set(path.relative_to(root).parts):
            yield path
