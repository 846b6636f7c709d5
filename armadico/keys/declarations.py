"""Finds the line of the source that declares something, for people who ask why a right exists."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Final

from armadico.core import services
from armadico.core.messages import OLDEST
from armadico.core.services import Service
from armadico.keys.rights import Because

PACKAGE: Final = Path(services.__file__).parents[1]
"""Files below it are shown from its name on."""


def declared(cls: type, attribute: str) -> Because:
    """Return the class and line that declare an attribute, which a base class may do."""
    holder = next((base for base in cls.__mro__ if attribute in vars(base)), cls)
    what = f"{cls.__name__}.{attribute}"
    if holder is not cls:
        what += f", of {holder.__name__}"
    return Because(*_line_of(holder, attribute), what)


@cache
def in_module(module: ModuleType, name: str, what: str) -> Because:
    """Return the line of a module's own function or constant."""
    source = str(inspect.getsourcefile(module))
    return Because(_shown(source), _bound(_tree(source).body, name), what)


@cache
def registered(service: Service, what: str) -> Because:
    """Return the line of a service's key in the module that registers it."""
    first = service.key.partition("/{")[0] if service.since > OLDEST else service.key
    for module in (services, sys.modules[service.message.__module__]):
        source = str(inspect.getsourcefile(module))
        for node in ast.walk(_tree(source)):
            if isinstance(node, ast.Constant) and node.value in (service.key, first):
                return Because(_shown(source), node.lineno, what)
    return in_module(services, "services", what)


@cache
def _line_of(cls: type, attribute: str) -> tuple[str, int]:
    try:
        source = inspect.getsourcefile(cls)
    except TypeError:  # made in an interactive session
        source = None
    if source is None:
        return "?", 0
    for node in ast.walk(_tree(source)):
        if isinstance(node, ast.ClassDef) and node.name == cls.__name__:
            return _shown(source), _bound(node.body, attribute) or node.lineno
    return _shown(source), 0


@cache
def _tree(source: str) -> ast.Module:
    try:
        return ast.parse(Path(source).read_text(encoding="utf-8"))
    except (OSError, ValueError, SyntaxError):
        return ast.Module([], [])


def _bound(body: Iterable[ast.stmt], name: str) -> int:
    """Return the line of the statement that binds a name; 0 if none does."""
    for statement in body:
        match statement:
            case (
                ast.Assign(targets=[ast.Name(id=bound)])
                | ast.AnnAssign(target=ast.Name(id=bound))
                | ast.FunctionDef(name=bound)
            ) if bound == name:
                return statement.lineno
    return 0


def _shown(source: str) -> str:
    path = Path(source)
    try:
        return str(Path(PACKAGE.name) / path.relative_to(PACKAGE))
    except ValueError:
        return str(path)
