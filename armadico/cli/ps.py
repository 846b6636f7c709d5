"""List alive agents: services, held resources, and agents missing on each host.

Nobody keeps a list: everybody is asked for their card.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options

if TYPE_CHECKING:
    from rich.table import Table

    from armadico.cli.places import Place
    from armadico.core.messages import Card
    from armadico.observe.hosts import HostState
    from armadico.observe.view import Seen, View
    from armadico.runtime.client import Client

EXAMPLES: Final = """\
  armadico ps                              everybody in this robot's namespace
  armadico ps --hosts lab.toml             and what each host of the table lacks
  armadico ps --host lab1 --hosts lab.toml     that host alone; exit code 1 if it lacks anybody
  armadico ps --json | jq .hosts           the same, for programs
"""


def main(argv: Sequence[str]) -> int:
    """Show the agents that are there; 1 if nobody is, or the host asked for lacks somebody."""
    args = parser().parse_args(argv)
    where = _place(args)
    wanted = _wanted(args, where)
    mesh = options.join_at(args, where, starts=True)
    from armadico.observe.hosts import census  # noqa: PLC0415 - not for --help
    from armadico.observe.view import View  # noqa: PLC0415
    from armadico.runtime.client import Client  # noqa: PLC0415 - not for --help

    with options.at_once(mesh):
        client = Client(mesh)
        missing = "" if mesh.wait_joined(0.0) else mesh.missing
        if missing:
            cards = {}
        elif args.host is None:
            cards = client.cards(args.timeout)
        else:
            cards = _of_host(client, args.host, wanted[args.host], args.timeout)
    view = View.of(cards)
    hosts = census(view, wanted, client.ahead)
    if args.json:
        print(json.dumps(_plain(view, hosts), indent=2))
    elif args.host is not None:
        _show_host(hosts[0], view)
    else:
        show(args, view, hosts, everyone=where is not None, missing=bool(missing))
    if missing:
        raise options.FailedError(missing)
    if args.host is not None:
        return options.FAILED if hosts[0].lacks else 0
    return 0 if view.alive else options.FAILED


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico ps",
        "Who is there: from liveliness tokens, and the card that each agent gives when asked. With"
        " a host table also what each host lacks; on the machine where `armadico up` runs that is"
        " counted by what it started. --host names the host to look at, from any machine.",
        EXAMPLES,
    )
    made.add_argument("--json", action="store_true", help="a JSON object on stdout")
    options.add_timeout(made, "how long an agent may take to answer, or to be seen", 1.0)
    options.add_mesh_options(made, host="the host to look at, from any machine (default: all)")
    return made


def _place(args: argparse.Namespace) -> Place | None:
    """Where this machine is, whichever host is to be looked at. Raises ConfigError."""
    from armadico.cli.places import entry, wanted  # noqa: PLC0415 - not for --help

    anywhere = argparse.Namespace(**vars(args) | {"host": None, "hosts": wanted(args)})
    where = options.placed(anywhere)
    if args.host is not None and where is not None:
        entry(where.table, args.host)
    return where


def _wanted(args: argparse.Namespace, where: Place | None) -> dict[str, tuple[str, ...]]:
    """The agents of each host to look at: what was started there, if that is known, else all."""
    from armadico.launch.pidfile import shares  # noqa: PLC0415 - not for --help

    if where is None:
        return {}
    hosts = where.table.hosts
    names = hosts if args.host is None else [args.host]
    started = {share.host: share.agents for share in shares(args.namespace)}
    return {name: started.get(name, hosts[name].agents) for name in names}


def _of_host(
    client: Client, host: str, wanted: Sequence[str], timeout: float
) -> dict[tuple[str, str], Card | None]:
    """The cards of one host's agents, as soon as all that are wanted are there, or time is up."""
    found: dict[tuple[str, str], Card | None] = {}

    def complete() -> bool:
        for who in sorted(client.alive):
            if who[0] in wanted and who not in found:
                found[who] = None
                client.request_card(*who, timeout, partial(found.__setitem__, who))
        here = [card.name for card in found.values() if card is not None and card.host == host]
        return sorted(here) == sorted(wanted)

    client.wait_for(complete, timeout)
    return {who: card for who, card in found.items() if card is None or card.host == host}


def _plain(view: View, hosts: Sequence[HostState]) -> dict[str, Any]:
    return {
        "agents": [_plain_card(agent) for agent in view.agents],
        "doubled": view.doubled,
        "hosts": [
            {
                "name": host.name,
                "state": host.state,
                "agents": host.agents,
                "lacks": host.lacks,
                "clock_s": None if host.clock_s is None else round(host.clock_s, 1),
            }
            for host in hosts
        ],
    }


def _plain_card(agent: Seen) -> dict[str, Any]:
    from armadico.core.messages import plain  # noqa: PLC0415 - not for --help

    name, instance, card = agent
    if card is None:
        return {"name": name, "instance": instance, "answering": False}
    return {**plain(card), "answering": True}


def _show_host(host: HostState, view: View) -> None:
    silent = [agent.name for agent in view.agents if agent.card is None]
    more = f"; not answering: {', '.join(silent)}" if host.lacks and silent else ""
    skew = f"; {host.skew}" if host.skew else ""
    print(options.shown(f"{host.name}: {host.state}{more}{skew}"))


def show(
    args: argparse.Namespace,
    view: View,
    hosts: Sequence[HostState],
    *,
    everyone: bool,
    missing: bool = False,
) -> None:
    """Print who is there, and on a narrow terminal less of each."""
    from rich.console import Console  # noqa: PLC0415 - not for --help

    console = Console()
    if not view.alive and not missing:
        print(f"no agent is alive in namespace {args.namespace!r}")
    elif view.alive:
        tables = [_table(view, hosts, *narrow) for narrow in NARROWER]
        fitting = (table for table in tables if options.fits(table, console))
        console.print(next(fitting, tables[-1]))
    for key, whose in view.doubled.items():
        print(options.shown(f"{key} is published by {' and '.join(whose)}: end one"))
    for host in hosts:
        if everyone or host.skew:
            print(options.shown(f"{host.name}: {host.state}{'; ' if host.skew else ''}{host.skew}"))


TITLES: Final = ("HOST", "AGENT", "INSTANCE", "PID", "VERSION", "PROVIDES", "SHARES", "HOLDS")
NARROWER: Final = (
    (", ", ()),
    ("\n", ()),
    ("\n", ("VERSION", "PID")),
    ("\n", ("VERSION", "PID", "INSTANCE", "HOST")),
)
"""How a table gets into a narrow terminal: what is between keys, and what is left out."""


def _table(view: View, hosts: Sequence[HostState], between: str, without: Sequence[str]) -> Table:
    from rich.table import Table  # noqa: PLC0415 - not for --help
    from rich.text import Text  # noqa: PLC0415 - not for --help

    table = Table(box=None, header_style="bold", pad_edge=False)
    for title in TITLES:
        if title not in without:
            table.add_column(title, overflow="fold")
    order = {host.name: number for number, host in enumerate(hosts)}
    for name, instance, card in sorted(view.agents, key=lambda row: _place_of(row.card, order)):
        short = instance.removeprefix(f"{name}-")[:8]  # enough for people; --json has it whole
        row: list[Sequence[object]] = [(), [name], [short], (), (), ["not answering"], (), ()]
        if card is not None:
            shares = dict.fromkeys((*card.owns, *card.resources))
            row = [[card.host], [name], [short], [card.pid], [card.version]]
            row += [card.provides, [*shares], card.holds]
        cells = (
            Text(between.join(map(options.shown, words)))  # no markup, whatever they say
            for title, words in zip(TITLES, row, strict=True)
            if title not in without
        )
        table.add_row(*cells, style="red" if card is None else None)
    return table


def _place_of(card: Card | None, order: Mapping[str, int]) -> int:
    """By host, who does not answer last."""
    return len(order) if card is None else order[card.host]
