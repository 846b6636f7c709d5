"""Installed agents, kinds of robots, transports and commands, found by their entry points.

Nothing is imported before it is used, so that a list is cheap. Agents of other packages are found
in the same way.
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
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from armadico.core.errors import UnknownNameError
from armadico.core.installed import entries, left_out
from armadico.core.installed import package as package_of

if TYPE_CHECKING:
    from armadico.core.agent import Agent
    from armadico.core.resources import Resource

AGENTS: Final = "armadico.agents"
ROBOTS: Final = "armadico.robots"
"""Kinds of robots: profile, session and simulator of each."""

COMMANDS: Final = "armadico.commands"
TASKS: Final = "armadico.tasks"
"""Tasks, which the steps of missions name."""

MISSIONS: Final = "armadico.missions"
"""The reader of mission files."""

ERRANDS: Final = "armadico.errands"
"""By a scenario's plan: the function that makes the run's order."""

MACHINES: Final = "armadico.machines"
"""What keeps a host's share of a society running; "virtual": on the virtual mesh."""

RUNS: Final = "armadico.runs"
"""By a field of a scenario: the function that drives such a scenario."""

GUESTS: Final = "armadico.guests"
"""Participants of a run that are not agents, such as the alarms of a building."""

PAGE: Final = "armadico.page"
"""What a capability adds to the control page: requests and views."""

OPTIONS: Final = "armadico.options"
"""Options that a package adds to the commands that run a society: `armadico.cli.additions`."""

TRANSPORTS: Final = "armadico.transports"
"""By the scheme of an address: the function that opens a device agent's port."""

TRANSLATORS: Final = "armadico.translators"
"""Translators of the society's messages for other tools."""

SLOTS: Final = "armadico.slots"
"""What a capability changes in the list of a society's agents, and what its tasks need."""

RECORDINGS: Final = "armadico.recordings"
"""Readers of Armadico's recordings: the messages of one robot."""

PICTURES: Final = "armadico.pictures"
"""By what is drawn: the function that draws a picture of it."""

REHEARSALS: Final = "armadico.rehearsals"
"""What drives a society's present virtually before it is asked to drive; "virtual": at once.
"told": what was told of a drive before it began."""

AUDITORS: Final = "armadico.auditors"
"""What judges a society's messages, within the monitor."""

MAPPERS: Final = "armadico.mappers"
"""Makers of an occupancy grid from readings at known poses."""

MAPS: Final = "armadico.maps"
"""What `armadico map` does with saved maps, by the name of the action."""

CORE: Final = str(Path(__file__).parents[1] / "core") + "/"

T = TypeVar("T")


@dataclass(frozen=True)
class Found:
    """An installed entry point, not imported yet."""

    name: str
    value: str  # "module:Class"; a module alone means its `main`
    package: str  # the distribution
    shares: bool = False  # whether other entry points of its group are in the same module

    @property
    def module(self) -> str:
        return self.value.partition(":")[0].strip()

    @property
    def path(self) -> Path | None:
        """The file of its module, without importing it, or None."""
        return _file(self.module)

    @property
    def summary(self) -> str:
        """The first line of its module's docstring, read without importing the module.

        If several entry points share a module, the docstring of the class comes first.
        """
        own = self.value.partition(":")[2].strip() if self.shares else ""
        return summary(self.module, own)

    def load(self) -> Any:
        """Import it. Raises ImportError with the entry point and the failing line."""
        module, _, attributes = (part.strip() for part in self.value.partition(":"))
        try:
            found: Any = import_module(module)
            for attribute in (attributes or "main").split("."):
                found = getattr(found, attribute)
        except (Exception, SystemExit) as error:  # a module may raise anything
            raise self.unusable(f"cannot be loaded: {_described(error)}") from error
        return found

    def unusable(self, why: str) -> ImportError:
        """The error for an entry point that cannot be used."""
        return ImportError(f"{self.name} ({self.value}) {why}")


def installed(group: str) -> dict[str, Found]:
    """The entry points of a group by name; see `core.installed.entries`."""
    return _installed(group, *sys.path)


@cache
def _installed(group: str, *_path: str) -> dict[str, Found]:
    points = entries(group)
    modules = Counter(entry.module for entry in points)
    return {
        entry.name: Found(entry.name, entry.value, package_of(entry), modules[entry.module] > 1)
        for entry in points
    }


def find(group: str, name: str) -> Found:
    """An entry point by name. Raises UnknownNameError."""
    found = installed(group)
    if name not in found:
        raise UnknownNameError(group.rpartition(".")[2].removesuffix("s"), name, found)
    return found[name]


def load(group: str, name: str, kind: type[T]) -> type[T]:
    """Import a class of a group. Raises UnknownNameError or ImportError."""
    what = find(group, name)
    loaded = what.load()
    if not (isinstance(loaded, type) and issubclass(loaded, kind)):
        raise what.unusable(f"must be a class derived from {kind.__name__}")
    return loaded


def agent_class(name: str) -> type[Agent]:
    """The class of an installed agent. Raises UnknownNameError or ImportError."""
    from armadico.core.agent import Agent
    from armadico.core.parameters import Parameters

    kind = load(AGENTS, name, Agent)
    if kind.name != name:  # a launcher that waits for `name` would wait forever
        why = f"has name = {kind.name!r}; expected {name!r}, the name of its entry point"
        raise find(AGENTS, name).unusable(why)
    given: object = kind.parameters
    if not (isinstance(given, type) and issubclass(given, Parameters)):
        raise find(AGENTS, name).unusable("has parameters that are not derived from Parameters")
    return kind


def agents() -> Iterator[tuple[str, type[Agent]]]:
    """All installed agents by name; those that cannot be used are left out."""
    for point in entries(AGENTS):
        try:
            yield point.name, agent_class(point.name)
        except ImportError as error:
            left_out(point, str(error))


def owners(names: Iterable[str], resource: Resource) -> Iterator[str]:
    """The agents among `names` that own a resource; only installed agents are known."""
    here = installed(AGENTS)
    return (name for name in names if name in here and resource in agent_class(name).owns)


@cache
def providers(key: str) -> tuple[str, ...]:
    """The installed agents that publish on a key, without those that cannot be loaded."""
    from armadico.core.services import rows_of

    found = []
    for name, kind in agents():
        rows = [row for message in kind.provides for row in rows_of(message)]
        keys = [row.key.replace("{name}", name) for row in rows]
        if key in (*keys, *(resource.ack_key for resource in kind.owns)):
            found.append(name)
    return tuple(found)


def summary(module: str, name: str = "") -> str:
    """The first line of the docstring of a class in a module, or else of the module.

    Without the full stop; empty if there is none, or the module cannot be read.
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
    except Exception:  # finding a module imports its parent packages
        return None
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    return Path(spec.origin)


def _described(error: BaseException) -> str:
    """An error of an import, with the line of the imported code that raised it."""
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg} ({error.filename}, line {error.lineno})"
    named = isinstance(error, (ImportError, AttributeError))  # their texts need no class name
    text = str(error) if named else f"{type(error).__name__}: {error}"
    lines = [at for at in traceback.extract_tb(error.__traceback__) if _is_code(at.filename)]
    return f"{text} ({lines[-1].filename}, line {lines[-1].lineno})" if lines else text


def _is_code(filename: str) -> bool:
    """Whether a file is neither this one, nor of the core, nor part of the import machinery.

    The core refuses a class where it is made: the line of the class is what helps.
    """
    machinery = {__file__, import_module.__code__.co_filename}
    return filename not in machinery and filename[:1] != "<" and not filename.startswith(CORE)
