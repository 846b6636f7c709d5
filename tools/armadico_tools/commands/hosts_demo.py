"""Four hosts as network namespaces of this machine, one of them lost in the middle of a run."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from typing import Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError

INSTEAD: Final = (
    "`make demo` shows the same four hosts as containers (an engine with Compose v2), and"
    " `make run` drives on this machine alone"
)

EXAMPLES: Final = """\
  sudo .venv/bin/armadico hosts-demo
  sudo .venv/bin/armadico hosts-demo sc3 --cable        lab2 loses its network, not its power
  sudo .venv/bin/armadico hosts-demo --seed 7 --link 'lab2->robot:delay=50ms,jitter=10ms,loss=5%'
  sudo .venv/bin/armadico hosts-demo --link '*->*:delay=20ms' --link 'lab1<->lab3:cut'
"""


def main(argv: Sequence[str]) -> int:
    """Show it; the exit code is that of the run."""
    args = parser().parse_args(argv)
    from armadico.config.hosts import load_hosts  # noqa: PLC0415 - not for --help
    from armadico.config.scenarios import load_scenario  # noqa: PLC0415
    from armadico_tools.hosts.demo import demo  # noqa: PLC0415
    from armadico_tools.hosts.namespace_hosts import NamespaceHosts  # noqa: PLC0415
    from armadico_tools.hosts.namespaces import lacking  # noqa: PLC0415
    from armadico_tools.hosts.switch import LinkError, parse_link  # noqa: PLC0415
    from armadico_tools.testbed import TABLE  # noqa: PLC0415

    load_scenario(args.scenario)
    names = tuple(load_hosts(TABLE).hosts)
    try:
        links = [parse_link(text, names) for text in args.link]
    except LinkError as error:
        raise UsageError(f"--link {error}") from None
    trouble = lacking()
    if trouble is not None:
        raise FailedError(f"{trouble}. Without it, {INSTEAD}")
    options.end_as_by_ctrl_c()
    hosts = NamespaceHosts(args.scenario, seed=args.seed, links=links, cable=args.cable)
    with hosts:
        try:
            return demo(hosts, args.scenario, partial(print, flush=True))
        except FailedError as error:
            raise FailedError(f"{error}\n{hosts.last_words()}") from None


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    made = options.parser(
        "armadico hosts-demo",
        "The four hosts of the shipped table `demo` as network namespaces on a switch of our own,"
        " each with `armadico up`. In the middle of the run lab2 is lost, with a second avoid"
        " standing by on lab1; later it comes back. Needs root and Linux; this machine's own"
        " network is not touched, and nothing is left behind.",
        EXAMPLES,
    )
    made.add_argument("scenario", nargs="?", default="sc4", help="what is driven (default: sc4)")
    made.add_argument("--seed", type=int, default=0, help="of links and simulator (default: 0)")
    made.add_argument(
        "--link",
        action="append",
        default=[],
        metavar="A->B:FAULTS",
        help="what is wrong with a link, in one direction (A<->B: in both; *: every host), of cut,"
        " delay=50ms, jitter=10ms, loss=5%%, duplicate=1%%, reorder=2%%, rate=1Mbit; may be"
        " repeated",
    )
    made.add_argument(
        "--cable", action="store_true", help="lab2 loses its network only, and keeps its processes"
    )
    return made
