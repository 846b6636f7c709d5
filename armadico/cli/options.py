"""What all commands share: options, errors and exit codes.

Exit codes: 0 done, 1 it failed, 2 it was called or configured wrongly, 130 interrupted.
"""

from __future__ import annotations

import argparse
import errno
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final

from armadico.config.discovery import UnknownNameError
from armadico.config.errors import ConfigError
from armadico.mesh.topology import (
    DEFAULT_NAMESPACE,
    NAMESPACE_VARIABLE,
    MeshError,
    TopologyError,
    checked_namespace,
    default_namespace,
    topology,
)
from armadico.runtime.errors import AbsentError, SocietyError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from armadico.cli.places import Place
    from armadico.config.worlds import World
    from armadico.mesh.zenoh import ZenohMesh

FAILED: Final = 1
USAGE: Final = 2
INTERRUPTED: Final = 130

HOSTS_VARIABLE: Final = "ARMADICO_HOSTS"
"""As in `armadico.config.hosts`, which --help does without."""


NEGATIVE: Final = re.compile(r"-((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|inf(inity)?|nan)$", re.IGNORECASE)
"""A negative number, as Python writes them: a value, and no option."""

JOIN_S: Final = 1.0
"""How long a command that is soon done waits for a robot agent: it ends within 2 s without one."""

SAY_S: Final = 1.5
"""As in `armadico.mesh.zenoh`, which --help does without."""

HOST_HELP: Final = "this machine's name in the host table (default: found by its addresses)"


class UsageError(Exception):
    """The command was called wrongly."""


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


def version() -> str:
    """The version that is installed."""
    try:
        return installed("armadico")
    except PackageNotFoundError:
        return "unknown"


def parser(program: str, description: str, examples: str) -> argparse.ArgumentParser:
    """A parser whose help ends with examples."""
    made = argparse.ArgumentParser(
        prog=program,
        description=description,
        epilog="examples:\n" + examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,  # --seed is not --seeds, and a typing error is no other option
    )
    # argparse takes -1e5 and -inf for options that it does not know.
    made._negative_number_matcher = NEGATIVE
    made.add_argument("--version", action="version", version=f"armadico {version()}")
    return made


def add_mesh_options(
    made: argparse.ArgumentParser, *, host: str = HOST_HELP, several: bool = False
) -> None:
    """The options that say which robot, or `several`, and how to reach it.

    `host` is what --host is for.
    """
    mesh = made.add_argument_group("the mesh")
    if several:
        _add_namespaces_option(mesh)
    else:
        add_namespace_option(mesh)
    mesh.add_argument("--host", metavar="H", help=host)
    mesh.add_argument(
        "--hosts",
        metavar="TABLE",
        help=f"the host table: a TOML file, or the name of a shipped one, demo or localhost"
        f" (default: ${HOSTS_VARIABLE} unless --connect is given; with --host alone, localhost;"
        " else none is needed)",
    )
    mesh.add_argument(
        "--connect",
        metavar="ENDPOINT",
        action="append",
        default=[],
        help="where the robot's router is, such as tcp/192.168.1.5:7447; may be repeated (default:"
        " the host table's, or this machine's)",
    )


def add_serving_options(made: argparse.ArgumentParser, port: int, *, everybody: str) -> None:
    """The options that say where a command listens; `everybody` is who may come from elsewhere."""
    from armadico.mesh.ports import LOOPBACK  # noqa: PLC0415 - few commands serve

    made.add_argument(
        "--port",
        type=int,
        default=port,
        metavar="P",
        help=f"where to listen, 0: a port that is free (default: {port})",
    )
    made.add_argument(
        "--bind",
        default=LOOPBACK,
        metavar="ADDRESS",
        help=f"for whom: {LOOPBACK} for this machine only, 0.0.0.0 for {everybody}"
        f" (default: {LOOPBACK})",
    )


def seconds(text: str) -> float:
    """A time in s, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r}: expected seconds, more than 0")
    return value


def add_timeout(made: argparse.ArgumentParser, what: str, default: float | None = None) -> None:
    """How long a command waits, s; `what` says for what. None: for ever."""
    said = "" if default is None else f" (default: {default:g} s)"
    made.add_argument("--timeout", type=seconds, default=default, metavar="S", help=f"{what}{said}")


def add_namespace_option(made: argparse._ActionsContainer) -> None:
    """The option that says which robot."""
    made.add_argument(
        "--namespace",
        metavar="NS",
        default=default_namespace(),
        help=f"which robot (default: ${NAMESPACE_VARIABLE}, or {DEFAULT_NAMESPACE})",
    )


def _add_namespaces_option(made: argparse._ActionsContainer) -> None:
    """The option that says which robots."""
    made.add_argument(
        "--namespace",
        dest="namespaces",
        action="append",
        metavar="NS",
        help=f"which robot; may be repeated (default: ${NAMESPACE_VARIABLE}, or"
        f" {DEFAULT_NAMESPACE})",
    )


def world(args: argparse.Namespace) -> World | None:
    """The world that --world names, if it does. Raises ConfigError."""
    if args.world is None:
        return None
    from armadico.config.worlds import load_world  # noqa: PLC0415 - not for --help

    return load_world(args.world)


def namespaces(args: argparse.Namespace) -> list[str]:
    """Which robots the options of a command for several say, each once. Raises TopologyError."""
    named = args.namespaces or [default_namespace()]
    return [checked_namespace(name) for name in dict.fromkeys(named)]


def join_each(
    args: argparse.Namespace, namespaces: Sequence[str], *, starts: bool = False
) -> list[ZenohMesh]:
    """A mesh for each namespace, not opened yet; `starts` as in `ZenohMesh`."""
    return [
        join(argparse.Namespace(**{**vars(args), "namespace": namespace}), starts=starts)
        for namespace in namespaces
    ]


def join(args: argparse.Namespace, *, passing: bool = True, starts: bool = False) -> ZenohMesh:
    """The mesh that the options name, not opened yet.

    `passing`: by a tool, and not by an agent; `starts` as in `ZenohMesh`.
    """
    return join_at(args, placed(args, passing=passing), starts=starts)


@contextmanager
def at_once(mesh: ZenohMesh) -> Iterator[ZenohMesh]:
    """The mesh, opened, for a command that is soon done: joined, unless there is no robot agent."""
    until = time.monotonic() + JOIN_S
    with mesh:
        mesh.wait_joined(until - time.monotonic())
        yield mesh


@contextmanager
def joined(args: argparse.Namespace) -> Iterator[ZenohMesh]:
    """The mesh that the options name, joined. Raises FailedError if there is no robot agent."""
    with at_once(join(args, starts=True)) as mesh:
        if not mesh.wait_joined(0.0):
            raise FailedError(mesh.missing)
        yield mesh


def absent(mesh: ZenohMesh, waited: float, what: str) -> SocietyError | FailedError:
    """What a command ends with that waited for so long (s) in vain; `what` did not happen.

    A missing robot agent is reported once: by the mesh, if there was time for it.
    """
    if mesh.wait_joined(0.0):
        return AbsentError(what, mesh.namespace)
    return FailedError(what if waited > SAY_S else mesh.missing)


def placed(args: argparse.Namespace, *, passing: bool = True) -> Place | None:
    """The host table that the options name, and this machine's entry; None without a table.

    Raises ConfigError if they contradict each other, or this machine.
    """
    if args.host is None and args.hosts is None and HOSTS_VARIABLE not in os.environ:
        return None
    from armadico.cli.places import place  # noqa: PLC0415 - not for --help

    return place(args, passing=passing)


def agents_by_host(args: argparse.Namespace) -> dict[str, tuple[str, ...]]:
    """The agents that each host of the table runs; none without a table. Raises ConfigError."""
    if args.host is None and args.hosts is None and HOSTS_VARIABLE not in os.environ:
        return {}
    from armadico.cli.places import wanted  # noqa: PLC0415 - not for --help
    from armadico.config.hosts import load_hosts  # noqa: PLC0415

    named = wanted(args)
    table = {} if named is None else load_hosts(named).hosts
    return {name: host.agents for name, host in table.items()}


def join_at(
    args: argparse.Namespace,
    where: Place | None,
    *,
    router: bool = False,
    starts: bool = False,
) -> ZenohMesh:
    """The mesh as it is reached from a place, not opened yet. Raises TopologyError."""
    if where is None:
        chosen = topology(router=router, connect=args.connect)
    else:
        chosen = where.topology(router=router, connect=args.connect)
    namespace = checked_namespace(args.namespace)
    from armadico.mesh.zenoh import ZenohMesh  # noqa: PLC0415 - not for --help

    return ZenohMesh(namespace, chosen, starts=starts)


def joining(args: argparse.Namespace) -> list[str]:
    """The options by which another process on this machine finds the same mesh.

    Which robot is said apart.
    """
    given = {"--host": args.host, "--hosts": args.hosts}
    words = [word for option, value in given.items() if value for word in (option, value)]
    return words + [word for endpoint in args.connect for word in ("--connect", endpoint)]


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
