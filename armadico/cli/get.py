"""Show the parameters of running agents that can be changed live, and their ranges."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import Command, argument, flag, group

if TYPE_CHECKING:
    from armadico.core.messages import Parameter, ParametersReply

EXAMPLES: Final = """\
  armadico get                     the parameters of all agents
  armadico get goto                of one agent
  armadico get goto v_max          one value
  armadico get --json | jq '.[] | select(.agent == "goto")'
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    agent: str = argument(
        "an agent's name or instance (default: all)", default="", nargs="?", metavar="AGENT"
    )
    name: str | None = argument("one parameter (default: all)", nargs="?", metavar="NAME")
    json: bool = flag("print a JSON array")
    timeout: float = options.timeout_option("wait so long for an agent's answer", 1.0)
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    with args.mesh.client() as client:
        replies = client.parameters(args.agent, args.timeout)
        left = [each for each in client.named(args.agent) if each not in replies]
        cards = client.cards() if left or not args.agent else {}
    # Other programs need not know parameters.
    silent = [each[0] for each in left if (card := cards.get(each)) is None or card.ours]
    if not args.agent:
        silent += args.mesh.lacks(cards)
    code = options.answered(silent, "parameters")
    rows = [
        (name, instance, row)
        for (name, instance), reply in replies.items()
        for row in reply.parameters
        if args.name in (None, row.name)
    ]
    if args.name is not None and not rows:
        if code:
            return code
        raise options.FailedError(_unknown(args.agent, args.name, replies))
    if args.json:
        print(json.dumps([plain(*row) for row in rows], indent=2))
    elif args.name is not None:
        for _, _, row in rows:
            print(shown(row.json))
    elif rows or not code:
        show(rows)
    return code


def plain(agent: str, instance: str, row: Parameter) -> dict[str, object]:
    """A parameter as a JSON object."""
    return {
        "agent": agent,
        "instance": instance,
        "name": row.name,
        "value": json.loads(row.json),
        "begun": json.loads(row.begun),
        "unit": row.unit,
        "wanted": row.wanted,
    }


def show(rows: Sequence[tuple[str, str, Parameter]]) -> None:
    """Print a table with one line for each parameter."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, header_style="bold", pad_edge=False)
    for title in ("AGENT", "PARAMETER", "VALUE", "UNIT", "BEFORE", "MAY BE"):
        table.add_column(title, overflow="fold")
    several = {name for name, instance, _ in rows for n, i, _ in rows if n == name and i > instance}
    for name, instance, row in rows:
        before = "" if row.begun == row.json else shown(row.begun)
        agent = instance[: len(name) + 9] if name in several else name
        words = (agent, row.name, shown(row.json), row.unit, before, row.wanted)
        table.add_row(*(Text(options.shown(word)) for word in words))
    Console().print(table)


def shown(value: str) -> str:
    """A JSON value as it is typed for `armadico set`."""
    return "none" if value == "null" else options.shown(value)


def _unknown(agent: str, name: str, replies: Mapping[tuple[str, str], ParametersReply]) -> str:
    from armadico.core.config_errors import advice

    known = {row.name for reply in replies.values() for row in reply.parameters}
    return f"{agent}: no parameter {name!r} that can be changed; {advice(name, known)}"


main: Final = Command(
    "armadico get",
    Options,
    run,
    "Show the parameters that can be changed while an agent runs: their values and ranges."
    " `armadico set` changes them. The exit code is 3 if an agent did not answer.",
    EXAMPLES,
)
