"""Options, errors and exit codes that all commands share.

Exit codes: 0 success, 1 failure, 2 wrong command line or configuration, 3 unknown (a judgement that
lacks evidence), 130 interrupted.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final, TypeVar

from armadico.cli.parsing import (
    PORT,
    BadValueError,
    UsageError,
    flag,
    option,
    parser,
    several,
    version,
)
from armadico.core.config_errors import ConfigError
from armadico.core.errors import UnknownNameError
from armadico.core.judgement import UNKNOWN_EXIT
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
    from pathlib import Path

    from rich.console import Console
    from rich.table import Table

    from armadico.config.endpoints import Endpoints
    from armadico.config.named import Gazetteer
    from armadico.config.worlds import World
    from armadico.core.messages import Card
    from armadico.launch.client import Client
    from armadico.mesh.zenoh import ZenohMesh
    from armadico.observe.findings import Demand

__all__ = ["UsageError", "parser", "version"]  # imported from here by other packages' commands

FAILED: Final = 1
USAGE: Final = 2
UNKNOWN: Final = UNKNOWN_EXIT
INTERRUPTED: Final = 130

JOIN_S: Final = 1.0
"""How long a short command waits for a robot agent: without one it ends within 2 s."""

STARTS_S: Final = 15.0
"""How old a society of this computer is that may still be starting its robot agent, s."""

AGAIN_S: Final = 0.2
"""How often that is checked, s."""

BESIDE: Final = 9
"""Societies beside the first one that need no name of their own."""

REPORT_S: Final = 1.5
"""As in `armadico.mesh.zenoh`, which --help does not import."""

NAMESPACE_HELP: Final = f"the robot (default: ${NAMESPACE_VARIABLE}, or {DEFAULT_NAMESPACE})"

M = TypeVar("M", bound="Mesh")
S = TypeVar("S", bound=float | None)


class FailedError(Exception):
    """The command failed; the message is printed."""


class UnknownError(Exception):
    """The command cannot tell how it ended; the message says why, and what to do."""


WRONGLY_USED: Final = (UsageError, ConfigError, TopologyError, UnknownNameError)
BROKEN: Final = (FailedError, SocietyError, MeshError, ImportError)


def guarded(program: str, command: Callable[[], int]) -> int:
    """Run a command and return its exit code; an error is printed as one line on stderr."""
    try:
        code = command()
        sys.stdout.flush()  # a full disk raises here, where it is caught
    except WRONGLY_USED as error:
        return _say(program, error, USAGE)
    except BROKEN as error:
        return _say(program, error, FAILED)
    except UnknownError as error:
        return _say(program, error, UNKNOWN)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        return discard_output()  # the reader of the pipe has ended
    except OSError as error:  # full disk, no file descriptors, a name that is too long, ...
        what = ": ".join(map(str, filter(None, (error.filename, error.strerror or error))))
        if error.errno == errno.ENOSPC and error.filename is None:
            discard_output()
        return _say(program, OSError(what), FAILED)
    except MemoryError:
        return _say(program, MemoryError("not enough memory for that"), FAILED)
    return code


def discard_output() -> int:
    """Discard standard output, so that the flush at exit does not fail again; returns FAILED."""
    with open(os.devnull, "wb") as nowhere:  # noqa: PTH123 - only the descriptor is used
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
    return FAILED


# Where the mesh is --------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """The options that select the robot and the way to it."""

    namespace: str = option(NAMESPACE_HELP, metavar="NS", factory=default_namespace)
    host: str | None = option(
        "this machine's name in the host table (default: found by its addresses)", metavar="H"
    )
    hosts: str | None = option(
        "the host table: a TOML file, or a shipped one, demo or localhost (default:"
        f" ${HOSTS_VARIABLE}, unless --connect is given; with --host alone localhost; else none)",
        metavar="TABLE",
    )
    connect: tuple[str, ...] = several(
        "the endpoint of the robot's router, such as tcp/192.168.1.5:7447; may be repeated"
        " (default: the host table's, or this machine's)",
        metavar="ENDPOINT",
    )
    open: bool = flag(
        "let any program that reaches the robot's port drive it; without keys in the host table"
        " agents that other machines could reach are refused otherwise"
    )

    def endpoints(self, *, passing: bool = True) -> Endpoints:
        """The endpoints of the mesh, for a tool (`passing`) or for an agent. Raises ConfigError."""
        from armadico.config.endpoints import endpoints

        return endpoints(
            self.namespace,
            hosts=self.hosts,
            host=self.host,
            connect=self.connect,
            passing=passing,
            open=self.open,
        )

    def join(self, name: str = "", *, passing: bool = True, starts: bool = False) -> ZenohMesh:
        """The mesh, not open yet, by an identity as in `Endpoints.door`; see `Endpoints.mesh`."""
        return self.endpoints(passing=passing).mesh(name, starts=starts)

    @contextmanager
    def joined(self, within: float = JOIN_S) -> Iterator[ZenohMesh]:
        """The joined mesh, as `at_once`. Raises FailedError if there is no robot agent."""
        with at_once(self.join(starts=True), within) as mesh:
            if not mesh.wait_joined(0.0):
                raise FailedError(mesh.missing)
            yield mesh

    @contextmanager
    def client(self) -> Iterator[Client]:
        """A client of the joined mesh. Raises FailedError if there is no robot agent."""
        from armadico.launch.client import Client

        with self.joined() as mesh:
            yield Client(mesh)

    def of(self: M, namespace: str) -> M:
        """The same options for another robot."""
        return replace(self, namespace=namespace)

    @contextmanager
    def beside_others(self: M) -> Iterator[M]:
        """The same options for a new society: in a free namespace, if none was chosen.

        No other new society takes it inside the `with` block. Raises FailedError if one has just
        taken the chosen namespace.
        """
        from armadico.launch.pidfile import PidFile, TakenError
        from armadico.mesh.sockets import holder, is_held, shares_of, socket_of

        names: tuple[str, ...] = (self.namespace,)
        if NAMESPACE_VARIABLE not in os.environ and self.namespace == DEFAULT_NAMESPACE:
            names += tuple(f"{DEFAULT_NAMESPACE}-{n}" for n in range(2, BESIDE + 2))
        with ExitStack() as stack:
            for name in names:
                if holder(socket_of(name)) is not None or any(map(is_held, shares_of(name))):
                    continue
                # Its router listens only later, so a share of no host holds the name until then.
                with suppress(TakenError):
                    stack.enter_context(PidFile(name, ""))
                    break
            else:
                if holder(socket_of(self.namespace)) is None:
                    raise FailedError(
                        f"another society starts or is in namespace {self.namespace!r}:"
                        " end it, or choose another one with --namespace"
                    )
                name = self.namespace  # its refusal says what to do
            if name != self.namespace:
                report(
                    f"another society is in namespace {self.namespace!r}: this one is in {name!r}"
                )
            yield self.of(name)

    def lacks(self, cards: Mapping[tuple[str, str], Card | None]) -> list[str]:
        """The agents that should be alive, by `demand`, and are not. Raises ConfigError.

        `cards` has those of the live agents, by (name, instance); None: no answer.
        """
        from armadico.observe.diagnosis import hosts_of
        from armadico.observe.view import View

        hosts = hosts_of(View.of(cards), self.demand(), 0.0)
        return [agent for host in hosts for agent in host.lacks]

    def demand(self) -> Demand:
        """What the society should be, by the host table and what `armadico up` started here.

        Raises ConfigError.
        """
        from armadico.config.endpoints import table_of
        from armadico.core.discovery import providers
        from armadico.launch.pidfile import shares
        from armadico.observe.findings import Demand

        named, hosts, digest = table_of(self.hosts, self.host, self.connect), {}, ""
        port = ""
        if named is not None:
            from armadico.config.hosts import load_hosts

            table = load_hosts(named)
            port = table.open_port
            if len(self.connect) < 2:  # else it may be another robot of the fleet
                digest = table.digest
                hosts = {name: host.agents for name, host in table.hosts.items()}
        with suppress(TopologyError):  # no folder for sockets: nothing was started here
            here = [*shares(self.namespace)]
            hosts |= {share.host: share.agents for share in here}
            port = port or next((share.open for share in here if share.open), "")
        with suppress(ConfigError, TopologyError):  # joining names what is wrong with keys
            door = self.endpoints().door()
            if door is not None:
                return Demand(hosts, digest, providers, port, door.ending, lambda: door.doubts(()))
        return Demand(hosts, digest, providers, port)


@dataclass(frozen=True, kw_only=True)
class Recorded(Mesh):
    """The same options beside a recording; that of one robot needs no namespace."""

    namespace: str = option(NAMESPACE_HELP, default="", metavar="NS")


@dataclass(frozen=True, kw_only=True)
class Meshes(Mesh):
    """The same options for several robots."""

    namespace: str = ""
    namespaces: tuple[str, ...] = several(
        f"a robot; may be repeated (default: ${NAMESPACE_VARIABLE}, or {DEFAULT_NAMESPACE})",
        "--namespace",
        metavar="NS",
    )

    def join_each(self, name: str = "", *, starts: bool = False) -> list[ZenohMesh]:
        """A mesh for each robot, not open yet; as `join`."""
        spaces = dict.fromkeys(self.namespaces or (default_namespace(),))
        return [self.of(space).join(name, starts=starts) for space in spaces]


@contextmanager
def at_once(mesh: ZenohMesh, within: float = JOIN_S) -> Iterator[ZenohMesh]:
    """The open mesh for a short command; joined, unless there is no robot agent within a time, s.

    The robot agent of a society that has just been started on this computer is waited for longer.
    """
    from armadico.mesh.sockets import starting

    until = time.monotonic() + within
    with mesh:
        while not mesh.wait_joined(max(until - time.monotonic(), 0.0)):
            if not starting(mesh.namespace, STARTS_S):
                break
            until = time.monotonic() + AGAIN_S
        yield mesh


def absent(mesh: ZenohMesh, waited: float, what: str) -> SocietyError | FailedError:
    """The error of a command that waited in vain, s; `what` did not happen.

    A missing robot agent is reported once: by the mesh, if the wait was long enough.
    """
    if mesh.wait_joined(0.0):
        return AbsentError(what, mesh.namespace)
    return FailedError(what if waited > REPORT_S else mesh.missing)


def answered(silent: Iterable[str], what: str) -> int:
    """The exit code of a command that asked agents; `UNKNOWN` if some did not answer.

    What they would have answered is missing in the output, and is reported as unknown.
    """
    names = ", ".join(map(shown, dict.fromkeys(silent)))
    if not names:
        return 0
    report(f"armadico: {what} of {names}: unknown, no answer; `armadico doctor` tells more")
    return UNKNOWN


# Options of several commands ----------------------------------------------------------------------


def port_option(default: int) -> int:
    """The field of the port at which a command listens."""
    help_ = f"listen on this port; 0: a free port (default: {default})"
    return option(help_, default=default, metavar="P", must=PORT)


def accept_option(what: str) -> bool:
    """The option that lets an unknown result pass."""
    return flag(f"return 0 instead of 3 for {what}")


def timeout_option(what: str, default: S = None) -> S:  # type: ignore[assignment]
    """The field of a timeout, s; None: no limit."""
    shown_default = "" if default is None else f" (default: {default:g} s)"
    return option(f"{what}{shown_default}", default=default, read=seconds, metavar="S")


def seconds(text: str) -> float:
    """A time in s. Raises BadValueError."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise BadValueError(f"{text!r}: expected more than 0 seconds")
    return value


def world_of(named: str | None) -> World | None:
    """The world of `--world`, or None. Raises ConfigError."""
    if named is None:
        return None
    from armadico.config.worlds import load_world

    return load_world(named)


# Messages to the user -----------------------------------------------------------------------------


def _say(program: str, error: Exception, code: int) -> int:
    lines = str(error).split("\n") if str(error) else [type(error).__name__]
    print(f"{program}: " + "\n".join(map(shown, lines)), file=sys.stderr)
    return code


def need(module: str, extra: str, *, of: str = "armadico") -> None:
    """Raises FailedError with what to install, if the module of an extra is missing."""
    if find_spec(module) is None:
        raise FailedError(f"{module} is not installed: pip install '{of}[{extra}]'")


def check_map(path: Path) -> None:
    """Raises ConfigError or FailedError if a map could not be written to a path now."""
    from armadico.config.grid_map import check_suffix, check_writable

    check_suffix(path)
    if not path.resolve().parent.is_dir():
        raise FailedError(f"cannot write {path}: there is no such folder")
    try:
        check_writable(path)
    except OSError as error:
        raise FailedError(f"cannot write {path}: {error.strerror}") from None


def apart(path: Path) -> Path:
    """Where a map is written that must not replace the one at a path."""
    return path.with_stem(f"{path.stem}-apart")


def end_as_by_ctrl_c() -> list[int]:
    """Let SIGTERM and SIGHUP act as Ctrl-C, which ends everything that was started.

    Returns the list to which each of these signals is added when it comes.
    """
    received: list[int] = []

    def interrupt(number: int, _frame: object) -> None:
        received.append(number)
        raise KeyboardInterrupt

    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # nohup ignores SIGHUP
            signal.signal(number, interrupt)
    return received


def report(text: str) -> None:
    """Print a line on stderr; stdout is for the command's result."""
    print(text, file=sys.stderr, flush=True)


def reporter(program: str) -> Callable[[str], None]:
    """A function that prints `PROGRAM: text` on stderr."""

    def report(text: str) -> None:
        print(f"{program}: {shown(text)}", file=sys.stderr, flush=True)

    return report


def fits(table: Table, console: Console) -> bool:
    """Whether a table fits on the terminal without folding or truncation."""
    anywhere = console.options.update(width=sys.maxsize)
    return console.measure(table, options=anywhere).maximum <= console.width


def shown(value: object) -> str:
    """A text from the mesh that is safe on a terminal: one line without control characters."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in str(value))


def gazetteer(world: str | None, namespace: str) -> Gazetteer | None:
    """The named places of `--world`, else of the world of what `armadico up` runs here.

    None: neither names a world. Raises ConfigError.
    """
    from armadico.config.named import DEFAULT_ROBOT, Gazetteer
    from armadico.launch.pidfile import shares

    with suppress(TopologyError):  # no folder for sockets: nothing was started here
        share = next((each for each in shares(namespace) if each.world), None)
        if share is not None and world in (None, share.world):
            return Gazetteer(share.world, share.robot or DEFAULT_ROBOT)
    return None if world is None else Gazetteer(world)


def known_gazetteer(world: str | None, namespace: str) -> Gazetteer:
    """The same. Raises UsageError without a world."""
    found = gazetteer(world, namespace)
    if found is None:
        raise UsageError(
            "names of places need the robot's world: give --world MAP (nothing that `armadico up`"
            f" started here as {namespace!r} names one)"
        )
    return found
