"""Run one agent as one process, on any machine that reaches the others."""

from __future__ import annotations

import json
import logging
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, argument, flag, group, option, several
from armadico.core.discovery import AGENTS, agent_class, installed, owners
from armadico.runtime.signals import ending

if TYPE_CHECKING:
    from armadico.core.agent import Agent, Parameters

EXAMPLES: Final = """\
  armadico-agent --list
  armadico-agent goto avoid gothrough        three agents in one process, each as if alone
  armadico-agent robot --set port=serial:///dev/ttyUSB0
  armadico-agent goto --set v_max=0.4
  armadico-agent avoid --connect tcp/192.168.1.5:7447     the robot's router, from another machine
  armadico-agent goto --host lab2 --hosts lab.toml        this machine is lab2 of that host table
"""

LOG_FORMAT: Final = "%(asctime)s.%(msecs)03d {name} %(levelname)s %(message)s"


@dataclass(frozen=True, kw_only=True)
class Options:
    names: tuple[str, ...] = argument("the agents to run; see --list", nargs="*", metavar="NAME")
    list: bool = flag("list the installed agents")
    json: bool = flag("with --list: print a JSON array")
    config: str | None = option("read the agent's parameters from a TOML file", metavar="FILE")
    set: tuple[str, ...] = several(
        "set one parameter, over the file's; with several agents AGENT.KEY=VALUE; may be repeated",
        metavar="KEY=VALUE",
    )
    protocol: int | None = option(
        "use an older version of the protocol, to try an upgrade (default: the newest)", metavar="N"
    )
    journal: bool = flag("publish the agent's inputs and outputs, so that it can be replayed")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    """Run the agents until a signal ends the process; returns only with `--list`."""
    if args.list:
        _list(as_json=args.json)
        return 0
    if not args.names:
        raise UsageError("name an agent; `armadico-agent --list` lists them")
    with _signals_held():
        return _serve(args)


COMMAND: Final = Command(
    "armadico-agent",
    Options,
    run,
    "Run one or several agents as one process. The agents find the others over the mesh."
    " Messages between agents of one process do not leave it, and one that fails ends all of them.",
    EXAMPLES,
)

parser = COMMAND.parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run agents; returns only with `--list` or if they cannot start."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    return options.guarded("armadico-agent", lambda: COMMAND(arguments))


def _list(*, as_json: bool) -> None:
    found = installed(AGENTS).values()
    if as_json:
        rows = [
            {"name": f.name, "value": f.value, "package": f.package, "summary": f.summary}
            for f in found
        ]
        print(json.dumps(rows, indent=2))
        return
    for agent in found:
        print(f"{agent.name:<16} {agent.summary}")


@contextmanager
def _signals_held() -> Iterator[None]:
    """Block the signals that end it until `serve` waits for them.

    Imported libraries such as numpy start threads. A thread that does not block a signal would
    receive it instead of the waiting thread.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ending())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(args: Options) -> int:
    kinds = [agent_class(name) for name in args.names]
    from armadico.core.agent import DeviceAgent
    from armadico.core.messages import OLDEST, PROTOCOL
    from armadico.core.resources import WHEELS
    from armadico.mesh.door import ROBOT, name_of
    from armadico.runtime.blame import attributed
    from armadico.runtime.port_reader import open_line, open_port
    from armadico.runtime.process import identity, serve

    protocol = PROTOCOL if args.protocol is None else args.protocol
    if not OLDEST <= protocol <= PROTOCOL:
        raise UsageError(f"--protocol must be from {OLDEST} to {PROTOCOL} (got {protocol})")
    parameters = [_parameters(kind, args) for kind in kinds]
    where = args.mesh.endpoints(passing=False)
    router = any(owners(args.names, WHEELS))
    mesh = where.mesh(ROBOT if router else name_of(args.names), router=router, starts=True)
    logging.basicConfig(
        level=logging.INFO,
        stream=sys.stderr,
        format=LOG_FORMAT.format(name="+".join(args.names)),
        datefmt="%H:%M:%S",
    )
    agents = []
    for kind, values in zip(kinds, parameters, strict=True):
        with attributed(kind):
            own = identity(kind.name, where.name, where.digest, protocol, mesh.door)
            agents.append(kind(replace(own, map=_map(values)), values))
    devices = (a for a in agents if isinstance(a, DeviceAgent) and a.address)
    connect = {
        device.instance: partial(open_line, device.address, mesh.namespace)
        if any(resource.stops for resource in device.owns)
        else partial(open_port, device.address)
        for device in devices
    }
    serve(agents, mesh, connect, head=_head() if args.journal else None)


def _head() -> Callable[[Agent], bytes]:
    from armadico.observe.journals import head

    return head


def _map(parameters: Parameters) -> str:
    """The digest of the map that an agent is launched with; empty without one.

    A parameter of that name may be something else in an agent of another package.
    """
    from armadico.config.worlds import digest, load_world
    from armadico.core.config_errors import ConfigError

    world = getattr(parameters, "world", None)
    try:
        return digest(load_world(world)) if world and isinstance(world, str) else ""
    except (ConfigError, OSError):
        return ""


def _parameters(kind: type[Agent], args: Options) -> Parameters:
    """The parameters of one agent; with several agents each setting begins with an agent's name."""
    from armadico.config.loading import load_parameters

    if len(args.names) == 1:
        return load_parameters(kind.parameters, args.config, args.set)
    if args.config is not None:
        raise UsageError(
            f"--config {args.config}: only for one agent; with several use --set AGENT.KEY=VALUE"
        )
    own = []
    for setting in args.set:
        name, dot, rest = setting.partition(".")
        if not dot or name not in args.names:
            keys = f"{'.KEY=, '.join(args.names)}.KEY="
            raise UsageError(f"--set {setting}: name the agent: {keys}")
        if name == kind.name:
            own.append(rest)
    return load_parameters(kind.parameters, None, own)
