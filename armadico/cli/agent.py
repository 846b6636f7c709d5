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
from armadico.discovery import AGENTS, agent_class, installed

if TYPE_CHECKING:
    from armadico.device import Port

EXAMPLES: Final = """\
  armadico-agent --list
  armadico-agent robot --set port=serial:///dev/ttyUSB0
  armadico-agent goto --set v_max=0.4
  armadico-agent encoder --listen tcp/192.168.1.5:7450    this machine's address: others may connect
  armadico-agent avoid --connect tcp/192.168.1.5:7450     from any machine, this one too
  armadico-agent goto --host lab2 --hosts lab.toml        this machine is lab2 of that host table
"""

LOG_FORMAT: Final = "%(asctime)s.%(msecs)03d {name} %(levelname)s %(message)s"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one agent; returns only if it could not begin, or only a list was wanted."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    return options.guarded("armadico-agent", lambda: _main(arguments))


def _main(arguments: Sequence[str]) -> int:
    made = _parser()
    args = made.parse_args(arguments)
    if args.list:
        _list(as_json=args.json)
        return 0
    if args.name is None:
        made.error("which agent? `armadico-agent --list` shows them")
    with _signals_held():
        return _serve(args)


def _parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico-agent",
        "Run one agent. It finds the others, and shares with them whatever it competes for.",
        EXAMPLES,
    )
    made.add_argument("name", nargs="?", metavar="NAME", help="which agent; see --list")
    made.add_argument("--list", action="store_true", help="the agents that are installed")
    made.add_argument("--json", action="store_true", help="with --list: a JSON array")
    made.add_argument("--config", metavar="FILE", help="its parameters, in TOML")
    made.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="one parameter, over the file's; may be repeated",
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
    kind = agent_class(args.name)
    from armadico.config.loading import load_parameters  # noqa: PLC0415 - not for --help
    from armadico.runtime import identity, serve  # noqa: PLC0415 - not for --help

    parameters = load_parameters(kind.parameters, args.config, args.set)
    where = options.placed(args, passing=False)
    mesh = options.join_at(args, where, passing=False)
    logging.basicConfig(
        level=logging.INFO,
        stream=sys.stderr,
        format=LOG_FORMAT.format(name=args.name),
        datefmt="%H:%M:%S",
    )
    agent = kind(identity(kind.name, None if where is None else where.name), parameters)
    serve(agent, mesh, _port(parameters))


def _port(parameters: Any) -> Callable[[], Port] | None:
    """What opens the device that an agent's parameters name, if they do."""
    url = getattr(parameters, "port", None)
    if url is None:
        return None
    from armadico.bridge.p2os.transports import open_transport  # noqa: PLC0415 - not for --help

    return partial(open_transport, url)
