"""Run one agent as one process, on any machine that reaches the others."""

from __future__ import annotations

import argparse
import json
import logging
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.config.discovery import AGENTS, agent_class, installed, owners

if TYPE_CHECKING:
    from armadico.core.agent import Agent

EXAMPLES: Final = """\
  armadico-agent --list
  armadico-agent goto avoid gothrough        three agents in one process, each as if alone
  armadico-agent robot --set port=serial:///dev/ttyUSB0
  armadico-agent goto --set v_max=0.4
  armadico-agent avoid --connect tcp/192.168.1.5:7447     the robot's router, from another machine
  armadico-agent goto --host lab2 --hosts lab.toml        this machine is lab2 of that host table
"""

LOG_FORMAT: Final = "%(asctime)s.%(msecs)03d {name} %(levelname)s %(message)s"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one agent; returns only if it could not begin, or only a list was wanted."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    return options.guarded("armadico-agent", lambda: _main(arguments))


def _main(arguments: Sequence[str]) -> int:
    made = parser()
    args = made.parse_args(arguments)
    if args.list:
        _list(as_json=args.json)
        return 0
    if not args.names:
        made.error("which agent? `armadico-agent --list` shows them")
    with _signals_held():
        return _serve(args)


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico-agent",
        "Run an agent. It finds the others, and shares with them whatever it competes for. Several"
        " share one process: what they publish for each other does not leave it, and one that fails"
        " ends them all.",
        EXAMPLES,
    )
    made.add_argument("names", nargs="*", metavar="NAME", help="which agents; see --list")
    made.add_argument("--list", action="store_true", help="the agents that are installed")
    made.add_argument("--json", action="store_true", help="with --list: a JSON array")
    made.add_argument("--config", metavar="FILE", help="its parameters, in TOML")
    made.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="one parameter, over the file's; AGENT.KEY=VALUE of several; may be repeated",
    )
    made.add_argument(
        "--journal",
        action="store_true",
        help="publish what enters and leaves it, so that a recording can be replayed",
    )
    options.add_mesh_options(made)
    return made


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
    """Keep SIGTERM and SIGINT until `serve` waits for them.

    What an agent imports may start threads, numpy does; one that does not block a signal gets it
    in place of the thread that waits for it.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGTERM, signal.SIGINT))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(args: argparse.Namespace) -> int:
    kinds = [agent_class(name) for name in args.names]
    from armadico.core.agent import DeviceAgent  # noqa: PLC0415 - not for --help
    from armadico.core.resources import WHEELS  # noqa: PLC0415
    from armadico.runtime.blame import blaming  # noqa: PLC0415
    from armadico.runtime.port_reader import open_port  # noqa: PLC0415
    from armadico.runtime.process import identity, serve  # noqa: PLC0415

    parameters = [_parameters(kind, args) for kind in kinds]
    where = options.placed(args, passing=False)
    router = any(owners(args.names, WHEELS))
    mesh = options.join_at(args, where, router=router, starts=True)
    logging.basicConfig(
        level=logging.INFO,
        stream=sys.stderr,
        format=LOG_FORMAT.format(name="+".join(args.names)),
        datefmt="%H:%M:%S",
    )
    host = None if where is None else where.name
    agents = []
    for kind, values in zip(kinds, parameters, strict=True):
        with blaming(kind):
            agents.append(kind(identity(kind.name, host), values))
    devices = (a for a in agents if isinstance(a, DeviceAgent) and a.address)
    connect = {device.instance: partial(open_port, device.address) for device in devices}
    serve(agents, mesh, connect, head=_head() if args.journal else None)


def _head() -> Callable[[Agent], bytes]:
    from armadico.observe.journals import head  # noqa: PLC0415 - only who keeps one needs it

    return head


def _parameters(kind: type[Agent], args: argparse.Namespace) -> Any:
    """What is set of one agent: of several, each setting names whose it is."""
    from armadico.config.loading import load_parameters  # noqa: PLC0415 - not for --help

    if len(args.names) == 1:
        return load_parameters(kind.parameters, args.config, args.set)
    if args.config is not None:
        raise UsageError(f"--config {args.config}: of several agents, use --set AGENT.KEY=VALUE")
    mine = []
    for setting in args.set:
        whose, dot, rest = setting.partition(".")
        if not dot or whose not in args.names:
            raise UsageError(f"--set {setting}: of which agent? {'.KEY=, '.join(args.names)}.KEY=")
        if whose == kind.name:
            mine.append(rest)
    return load_parameters(kind.parameters, None, mine)
