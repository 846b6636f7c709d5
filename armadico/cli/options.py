"""What all commands share: options, errors and exit codes.

Exit codes: 0 done, 1 it failed, 2 it was called or configured wrongly, 130 interrupted.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final, TypeVar

from armadico.cli.parsing import (
    PORT,
    BadValueError,
    UsageError,
    option,
    parser,
    several,
    version,
)
from armadico.config.errors import ConfigError
from armadico.core.errors import UnknownNameError
from armadico.mesh.ports import LOOPBACK
from armadico.mesh.topology import (
    DEFAULT_NAMESPACE,
    HOSTS_VARIABLE,
    NAMESPACE_VARIABLE,
    MeshError,
    TopologyError,
    default_namespace,
)
from armadico.runtime.errors import AbsentError, SocietyError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from armadico.config.worlds import World
    from armadico.mesh.endpoints import Endpoints
    from armadico.mesh.zenoh import ZenohMesh
    from armadico.runtime.client import Client

__all__ = ["UsageError", "parser", "version"]  # those that commands elsewhere take from here

FAILED: Final = 1
USAGE: Final = 2
INTERRUPTED: Final = 130

JOIN_S: Final = 1.0
"""How long a command that is soon done waits for a robot agent: it ends within 2 s without one."""

SAY_S: Final = 1.5
"""As in `armadico.mesh.zenoh`, which --help does without."""

NAMESPACE_HELP: Final = f"which robot (default: ${NAMESPACE_VARIABLE}, or {DEFAULT_NAMESPACE})"

M = TypeVar("M", bound="Mesh")


class FailedError(Exception):
    """The command could not do what it was asked for."""


WRONGLY_USED: Final = (UsageError, ConfigError, TopologyError, UnknownNameError)
BROKEN: Final = (FailedError, SocietyError, MeshError, ImportError)


def guarded(program: str, command: Callable[[], int]) -> int:
    """Run a command; an error is one line on stderr and an exit code."""
    try:
        code = command()
        sys.stdout.flush()  # a disk that is full says so now, and not when nobody listens
    except WRONGLY_USED as error:
        return _say(program, error, USAGE)
    except BROKEN as error:
        return _say(program, error, FAILED)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        return unheard()  # whoever read us has gone
    except OSError as error:  # no disk, no file descriptors, a name that is too long, ...
        what = ": ".join(map(str, filter(None, (error.filename, error.strerror or error))))
        if error.errno == errno.ENOSPC and error.filename is None:
            unheard()
        return _say(program, OSError(what), FAILED)
    except MemoryError:
        return _say(program, MemoryError("not enough memory for that"), FAILED)
    return code


def unheard() -> int:
    """Send standard output to nowhere, so that exit does not try again; returns FAILED."""
    with open(os.devnull, "wb") as nowhere:  # noqa: PTH123 - a descriptor is all that is needed
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
    return FAILED


# Where the mesh is --------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """The options that say which robot, and how to reach it."""

    namespace: str = option(NAMESPACE_HELP, metavar="NS", factory=default_namespace)
    host: str | None = option(
        "this machine's name in the host table (default: found by its addresses)", metavar="H"
    )
    hosts: str | None = option(
        "the host table: a TOML file, or the name of a shipped one, demo or localhost"
        f" (default: ${HOSTS_VARIABLE} unless --connect is given; with --host alone, localhost;"
        " else none is needed)",
        metavar="TABLE",
    )
    connect: tuple[str, ...] = several(
        "where the robot's router is, such as tcp/192.168.1.5:7447; may be repeated (default:"
        " the host table's, or this machine's)",
        metavar="ENDPOINT",
    )

    def endpoints(self, *, passing: bool = True) -> Endpoints:
        """Where that is: for a tool (`passing`), or for an agent. Raises ConfigError."""
        from armadico.mesh.endpoints import endpoints

        return endpoints(
            self.namespace,
            hosts=self.hosts,
            host=self.host,
            connect=self.connect,
            passing=passing,
        )

    def join(self, *, passing: bool = True, starts: bool = False) -> ZenohMesh:
        """The mesh, not opened yet; `starts` as in `ZenohMesh`. Raises TopologyError."""
        return self.endpoints(passing=passing).mesh(starts=starts)

    @contextmanager
    def joined(self) -> Iterator[ZenohMesh]:
        """The mesh, joined. Raises FailedError if there is no robot agent."""
        with at_once(self.join(starts=True)) as mesh:
            if not mesh.wait_joined(0.0):
                raise FailedError(mesh.missing)
            yield mesh

    @contextmanager
    def client(self) -> Iterator[Client]:
        """A client of the mesh, joined. Raises FailedError if there is no robot agent."""
        from armadico.runtime.client import Client

        with self.joined() as mesh:
            yield Client(mesh)

    def of(self: M, namespace: str) -> M:
        """The same for another robot."""
        return replace(self, namespace=namespace)

    def agents_by_host(self) -> dict[str, tuple[str, ...]]:
        """The agents of each host of the table; none without a table. Raises ConfigError."""
        from armadico.mesh.endpoints import table_of

        named = table_of(self.hosts, self.host, self.connect)
        if named is None:
            return {}
        from armadico.config.hosts import load_hosts

        return {name: host.agents for name, host in load_hosts(named).hosts.items()}


@dataclass(frozen=True, kw_only=True)
class Meshes(Mesh):
    """The same of several robots."""

    namespace: str = ""
    namespaces: tuple[str, ...] = several(
        f"which robot; may be repeated (default: ${NAMESPACE_VARIABLE}, or {DEFAULT_NAMESPACE})",
        "--namespace",
        metavar="NS",
    )

    def join_each(self, *, starts: bool = False) -> list[ZenohMesh]:
        """A mesh for each robot, not opened yet. Raises TopologyError for what is no namespace."""
        named = dict.fromkeys(self.namespaces or (default_namespace(),))
        return [self.of(name).join(starts=starts) for name in named]


@contextmanager
def at_once(mesh: ZenohMesh) -> Iterator[ZenohMesh]:
    """The mesh, opened, for a command that is soon done: joined, unless there is no robot agent."""
    until = time.monotonic() + JOIN_S
    with mesh:
        mesh.wait_joined(until - time.monotonic())
        yield mesh


def absent(mesh: ZenohMesh, waited: float, what: str) -> SocietyError | FailedError:
    """What a command ends with that waited for so long (s) in vain; `what` did not happen.

    A missing robot agent is reported once: by the mesh, if there was time for it.
    """
    if mesh.wait_joined(0.0):
        return AbsentError(what, mesh.namespace)
    return FailedError(what if waited > SAY_S else mesh.missing)


# Options of several commands ----------------------------------------------------------------------


def port_option(default: int) -> Any:
    """The field of the port at which a command listens."""
    help_ = f"where to listen, 0: a port that is free (default: {default})"
    return option(help_, default=default, metavar="P", must=PORT)


def bind_option(everybody: str) -> Any:
    """The field of the address at which a command listens; `everybody` may come from elsewhere."""
    return option(
        f"for whom: {LOOPBACK} for this machine only, 0.0.0.0 for {everybody}"
        f" (default: {LOOPBACK})",
        default=LOOPBACK,
        metavar="ADDRESS",
    )


def timeout_option(what: str, default: float | None = None) -> Any:
    """The field of how long a command waits, s; `what` says for what. None: for ever."""
    said = "" if default is None else f" (default: {default:g} s)"
    return option(f"{what}{said}", default=default, read=seconds, metavar="S")


def seconds(text: str) -> float:
    """A time in s. Raises BadValueError."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise BadValueError(f"{text!r}: expected seconds, more than 0")
    return value


def world_of(named: str | None) -> World | None:
    """The world that --world names, if it does. Raises ConfigError."""
    if named is None:
        return None
    from armadico.config.worlds import load_world

    return load_world(named)


# What people are told -----------------------------------------------------------------------------


def _say(program: str, error: Exception, code: int) -> int:
    lines = str(error).split("\n") if str(error) else [type(error).__name__]
    print(f"{program}: " + "\n".join(map(shown, lines)), file=sys.stderr)
    return code


def need(module: str, extra: str) -> None:
    """Raises FailedError, saying what to install, where a module of an extra is not there."""
    if find_spec(module) is None:
        raise FailedError(f"{module} is not installed: pip install 'armadico[{extra}]'")


def end_as_by_ctrl_c() -> None:
    """SIGTERM and SIGHUP do as Ctrl-C: everything that was started is taken down."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # under nohup it is not
            signal.signal(number, signal.default_int_handler)


def say(text: str) -> None:
    """A line for people, on stderr: stdout is for what was asked for."""
    print(text, file=sys.stderr, flush=True)


def teller(program: str) -> Callable[[str], None]:
    """Says something on stderr, a line at a time, for programs that go on."""

    def tell(text: str) -> None:
        print(f"{program}: {shown(text)}", file=sys.stderr, flush=True)

    return tell


def fits(table: Table, console: Console) -> bool:
    """Whether a table has room on a terminal with nothing folded or cut off."""
    anywhere = console.options.update(width=sys.maxsize)
    return console.measure(table, options=anywhere).maximum <= console.width


def shown(value: object) -> str:
    """Something from the mesh as a terminal may have it: one line, nothing that controls it."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in str(value))
