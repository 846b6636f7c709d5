"""List alive agents: services, held resources, and agents missing on each host.

There is no registry: each agent answers a query with its card.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import Command, flag, group, option
from armadico.config.endpoints import Endpoints, endpoints, entry, table_of
from armadico.core.judgement import Answer
from armadico.observe.findings import Finding, short, sight, summary

if TYPE_CHECKING:
    from rich.table import Table

    from armadico.core.messages import Card
    from armadico.observe.diagnosis import HostState
    from armadico.observe.view import View

EXAMPLES: Final = """\
  armadico ps                              all agents in this robot's namespace
  armadico ps --hosts lab.toml             and the agents missing on each host of the table
  armadico ps --host lab1 --hosts lab.toml     one host; exit code 1 if an agent is missing
  armadico ps --json | jq .hosts           the same as JSON
"""


@dataclass(frozen=True, kw_only=True)
class AnyHost(options.Mesh):
    """The mesh, and the host to list, which need not be this machine."""

    host: str | None = option("list this host, from any machine (default: all)", metavar="H")

    def endpoints(self, *, passing: bool = True) -> Endpoints:
        """The endpoints of the mesh, independent of the listed host. Raises ConfigError."""
        hosts = table_of(self.hosts, self.host, self.connect)
        found = endpoints(
            self.namespace, hosts=hosts, connect=self.connect, passing=passing, open=self.open
        )
        if self.host is not None and found.table is not None:
            entry(found.table, self.host)
        return found


@dataclass(frozen=True, kw_only=True)
class Options:
    json: bool = flag("print a JSON object")
    timeout: float = options.timeout_option("wait at most so long for an agent's answer", 4.5)
    mesh: AnyHost = group(AnyHost, "the mesh")


def run(args: Options) -> int:
    """Print the alive agents; the exit code is that of `sight`, or the host's."""
    where, host, demand = args.mesh.endpoints(), args.mesh.host, args.mesh.demand()
    if host is not None:
        demand = replace(demand, hosts={host: demand.hosts.get(host, ())})
    findings: Sequence[Finding] = ()
    mesh = where.mesh(starts=True)
    from armadico.observe.diagnosis import OF_HOSTS, hosts_of
    from armadico.observe.view import View
    from armadico.observe.watching import Observer

    view, now = View(), 0.0
    with options.at_once(mesh):
        missing = "" if mesh.wait_joined(0.0) else mesh.missing
        if not missing:
            observer = Observer(mesh, demand, view)
            # A host's state alone needs no rates, which take longer to be known.
            of = OF_HOSTS if host is not None and not args.json else None
            findings = observer.settle(most_s=args.timeout, of=of)
            now = observer.now
    hosts = [each for each in hosts_of(view, demand, now) if host in (None, each.name)]
    if args.json:
        print(json.dumps(_plain(view, hosts, findings, host), indent=2))
    elif host is not None:
        _show_host(hosts[0])
    else:
        everyone = where.table is not None
        show(where.namespace, view, hosts, everyone=everyone, missing=bool(missing))
        for line in short(findings):
            print(options.shown(line))
    if missing:
        raise options.FailedError(missing)
    if host is not None:
        return options.FAILED if hosts[0].lacks or hosts[0].silent else 0
    return sight(findings) if view.alive else options.FAILED


def _plain(
    view: View, hosts: Sequence[HostState], findings: Sequence[Finding], host: str | None
) -> dict[str, object]:
    import msgspec

    from armadico.observe import described

    return {
        "summary": summary(findings),
        "findings": [msgspec.to_builtins(f) for f in findings if f.answer is not Answer.YES],
        "agents": [
            described.agent(seen)
            for seen in view.agents
            if seen.card is None or host in (None, seen.card.host)
        ],
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


def _show_host(host: HostState) -> None:
    skew = f"; {host.skew}" if host.skew else ""
    print(options.shown(f"{host.name}: {host.state}{skew}"))


def show(
    namespace: str,
    view: View,
    hosts: Sequence[HostState],
    *,
    everyone: bool,
    missing: bool = False,
) -> None:
    """Print the alive agents; a narrow terminal gets fewer columns."""
    from rich.console import Console

    console = Console()
    if not view.alive and not missing:
        print(f"no agent is alive in namespace {namespace!r}")
    elif view.alive:
        tables = [_table(view, hosts, *narrow) for narrow in NARROWER]
        fitting = (table for table in tables if options.fits(table, console))
        console.print(next(fitting, tables[-1]))
    for host in hosts:
        if everyone or host.skew:
            print(options.shown(f"{host.name}: {host.state}{'; ' if host.skew else ''}{host.skew}"))


TITLES: Final = ("HOST", "AGENT", "INSTANCE", "PID", "VERSION", "PROVIDES", "SHARES", "HOLDS")
NARROWER: Final = (
    (", ", ()),
    ("\n", ()),
    ("\n", ("VERSION", "PID")),
    ("\n", ("VERSION", "PID", "INSTANCE")),
    ("\n", ("VERSION", "PID", "INSTANCE", "SHARES")),
)
"""Formats of the table, widest first: the separator of keys, and the columns left out."""


def _table(view: View, hosts: Sequence[HostState], between: str, without: Sequence[str]) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, header_style="bold", pad_edge=False)
    for title in TITLES:
        if title not in without:
            table.add_column(title, overflow="fold")
    order = {host.name: number for number, host in enumerate(hosts)}
    for name, instance, card in sorted(view.agents, key=lambda row: _place_of(row.card, order)):
        short = instance.removeprefix(f"{name}-")[:8]  # --json has all of it
        row: list[Sequence[object]] = [(), [name], [short], (), (), ["not answering"], (), ()]
        if card is not None:
            shares = dict.fromkeys((*card.owns, *card.resources))
            row = [[card.host], [name], [short], [card.pid], [card.version]]
            row += [card.provides, [*shares], card.holds]
        cells = (
            Text(between.join(map(options.shown, words)))  # Text does not interpret markup
            for title, words in zip(TITLES, row, strict=True)
            if title not in without
        )
        table.add_row(*cells, style="red" if card is None else None)
    return table


def _place_of(card: Card | None, order: Mapping[str, int]) -> int:
    """The sort key: the host; agents that do not answer come last."""
    return len(order) if card is None else order[card.host]


main: Final = Command(
    "armadico ps",
    Options,
    run,
    "List alive agents, from liveliness tokens and each agent's card. With a host table, also list"
    " the agents missing on each host; on the machine where `armadico up` runs, these are the"
    " ones it started.",
    EXAMPLES,
)
