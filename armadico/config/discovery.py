"""What is installed, by name: agents, kinds of robots, transports, commands, found by entry points.

Nothing that is found is imported before it is used, so a list costs nothing however heavy the
things on it are. A third party's agent is found exactly as ours are.
"""

from __future__ import annotations

import ast
import sys
import traceback
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import Distribution, EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from armadico.core.errors import UnknownNameError
from armadico.core.installed import entries

if TYPE_CHECKING:
    from armadico.core.agent import Agent
    from armadico.core.resources import Resource

AGENTS: Final = "armadico.agents"
ROBOTS: Final = "armadico.robots"
"""Kinds of robots: how each is described, spoken to and simulated."""

COMMANDS: Final = "armadico.commands"
TASKS: Final = "armadico.tasks"
"""What the steps of missions ask for."""

MISSIONS: Final = "armadico.missions"
"""What reads the file of a mission."""

ERRANDS: Final = "armadico.errands"
"""By the plan of a scenario, what orders it."""

MACHINES: Final = "armadico.machines"
"""What keeps a host's share of a society up; "virtual": on the virtual mesh."""

RUNS: Final = "armadico.runs"
"""By a field of a scenario, what drives one that has it."""

GUESTS: Final = "armadico.guests"
"""What takes part in a run besides the agents, as the alarms of a building."""

PAGE: Final = "armadico.page"
"""What a capability adds to the control page: requests, and what is shown."""

TRANSPORTS: Final = "armadico.transports"
"""By the scheme of an address: what opens it as a device agent's port."""

TRANSLATORS: Final = "armadico.translators"
"""What says the society's messages in the words of other people's tools."""

MAPPERS: Final = "armadico.mappers"
"""What makes an occupancy grid of readings at known poses."""

T = TypeVar("T")


@dataclass(frozen=True)
class Found:
    """One thing that is installed, not imported yet."""

    name: str
    value: str  # "module:Class"; a module alone stands for its `main`
    package: str  # the distribution that brought it
    shares: bool = False  # its module with others of its group

    @property
    def module(self) -> str:
        return self.value.partition(":")[0].strip()

    @property
    def path(self) -> Path | None:
        """The file of its module, which is not imported; None if there is none."""
        return _file(self.module)

    @property
    def summary(self) -> str:
        """The first line of its module's docstring, read without importing the module.

        Of a module that brings several, each is described by its own docstring, if it has one.
        """
        own = self.value.partition(":")[2].strip() if self.shares else ""
        return summary(self.module, own)

    def load(self) -> Any:
        """Import it. Raises ImportError saying which entry point is to blame, and where."""
        module, _, attributes = (part.strip() for part in self.value.partition(":"))
        try:
            found: Any = import_module(module)
            for attribute in (attributes or "main").split("."):
                found = getattr(found, attribute)
        except (Exception, SystemExit) as error:  # a module is anybody's code
            raise self.unusable(f"cannot be loaded: {_said(error)}") from error
        return found

    def unusable(self, why: str) -> ImportError:
        """What to raise of an entry point that leads to nothing that can be used."""
        return ImportError(f"{self.name} ({self.value}) {why}")


def installed(group: str) -> dict[str, Found]:
    """Everything in a group, by name. If two packages bring one name, the first stands."""
    return _installed(group, *sys.path)


@cache
def _installed(group: str, *_path: str) -> dict[str, Found]:
    found: dict[str, Found] = {}
    points = sorted(entries(group), key=lambda entry: entry.name)
    modules = Counter(module for _, module in {(entry.name, entry.module) for entry in points})
    for entry in points:
        shares = modules[entry.module] > 1
        found.setdefault(entry.name, Found(entry.name, entry.value, _package(entry), shares))
    return found


def find(group: str, name: str) -> Found:
    """One thing of a group. Raises `UnknownNameError`."""
    found = installed(group)
    if name not in found:
        raise UnknownNameError(group.rpartition(".")[2].removesuffix("s"), name, found)
    return found[name]


def load(group: str, name: str, kind: type[T]) -> type[T]:
    """Import a class of a group. Raises `UnknownNameError`, or ImportError."""
    what = find(group, name)
    loaded = what.load()
    if not (isinstance(loaded, type) and issubclass(loaded, kind)):
        raise what.unusable(f"is no {kind.__name__}: an entry point names a class derived from it")
    return loaded


def agent_class(name: str) -> type[Agent]:
    """The class of an agent that is installed. Raises `UnknownNameError`."""
    from armadico.core.agent import Agent
    from armadico.core.parameters import Parameters

    kind = load(AGENTS, name, Agent)
    if kind.name != name:  # whoever waits for the one would never see the other
        why = f"calls itself {kind.name!r}: its class says name = {name!r}, as its entry point does"
        raise find(AGENTS, name).unusable(why)
    given: object = kind.parameters
    if not (isinstance(given, type) and issubclass(given, Parameters)):
        raise find(AGENTS, name).unusable(
            "has parameters that are no class derived from Parameters"
        )
    return kind


def owners(names: Iterable[str], resource: Resource) -> Iterator[str]:
    """Those of the agents that own a resource; who is not installed here is not known to."""
    here = installed(AGENTS)
    return (name for name in names if name in here and resource in agent_class(name).owns)


@cache
def providers(key: str) -> tuple[str, ...]:
    """The installed agents that publish on a key; who cannot be loaded here is not known to."""
    from armadico.core.services import rows_of

    found = []
    for name in installed(AGENTS):
        try:
            kind = agent_class(name)
        except ImportError:
            continue
        rows = [row for message in kind.provides for row in rows_of(message)]
        keys = [row.key.replace("{name}", name) for row in rows]
        if key in (*keys, *(resource.ack_key for resource in kind.owns)):
            found.append(name)
    return tuple(found)


def summary(module: str, name: str = "") -> str:
    """The first line of the docstring of a module, or of what goes by a name in it.

    Without its full stop; empty if there is none, or the module cannot be read.
    """
    path = _file(module)
    if path is None:
        return ""
    try:
        tree = ast.parse(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, SyntaxError, RecursionError):
        return ""
    named = (n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name)
    own = next((text for n in named if (text := ast.get_docstring(n))), None)
    return (own or ast.get_docstring(tree) or "").partition("\n")[0].rstrip(".")


def _file(module: str) -> Path | None:
    try:
        spec = find_spec(module)
    except Exception:  # to find it, the packages that it is in are imported
        return None
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    return Path(spec.origin)


def _said(error: BaseException) -> str:
    """An error while importing, with the line of theirs that raised it, if one did."""
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg} ({error.filename}, line {error.lineno})"
    named = isinstance(error, (ImportError, AttributeError))  # which say it all
    said = str(error) if named else f"{type(error).__name__}: {error}"
    lines = [at for at in traceback.extract_tb(error.__traceback__) if _is_code(at.filename)]
    return f"{said} ({lines[-1].filename}, line {lines[-1].lineno})" if lines else said


def _is_code(filename: str) -> bool:
    """Neither this file nor what imports."""
    return filename not in {__file__, import_module.__code__.co_filename} and filename[:1] != "<"


def _package(entry: EntryPoint) -> str:
    return _name(entry.dist) if entry.dist is not None else ""


@cache  # to say its name it parses all its metadata, half a millisecond for each of its entries
def _name(package: Distribution) -> str:
    return package.name
