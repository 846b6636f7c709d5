"""Show who is there, what they offer and what they hold.

Nobody keeps a list: everybody is asked for their card.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options

if TYPE_CHECKING:
    from armadico.messages import Card

EXAMPLES: Final = """\
  armadico ps                      everybody in this robot's namespace
  armadico ps --json | jq .        the same, for programs
  armadico ps --connect tcp/192.168.1.5:7450
"""


def main(argv: Sequence[str]) -> int:
    """Show the agents that are there."""
    made = options.parser(
        "armadico ps",
        "Who is there: from liveliness tokens, and the card that each agent gives when asked.",
        EXAMPLES,
    )
    made.add_argument("--json", action="store_true", help="a JSON array on stdout")
    made.add_argument(
        "--timeout",
        type=float,
        default=1.0,
        metavar="S",
        help="how long an agent may take to answer (default: 1 s)",
    )
    options.add_mesh_options(made)
    args = made.parse_args(argv)
    mesh = options.join(args)
    from armadico.client import Client  # noqa: PLC0415 - not for --help

    with mesh:
        cards = Client(mesh).cards(args.timeout)
    if args.json:
        print(json.dumps([_plain(who, card) for who, card in cards.items()], indent=2))
    elif cards:
        _show(cards)
    else:
        print(f"nobody is there in namespace {args.namespace!r}")
    return 0


def _plain(who: tuple[str, str], card: Card | None) -> dict[str, Any]:
    name, instance = who
    if card is None:
        return {"name": name, "instance": instance, "answering": False}
    from armadico.messages import plain  # noqa: PLC0415 - not for --help

    return {**plain(card), "answering": True}


def _show(cards: Mapping[tuple[str, str], Card | None]) -> None:
    from rich.console import Console  # noqa: PLC0415 - not for --help
    from rich.table import Table  # noqa: PLC0415 - not for --help

    table = Table(box=None, header_style="bold", pad_edge=False)
    for title in ("AGENT", "INSTANCE", "HOST", "PID", "VERSION", "PROVIDES", "SHARES", "HOLDS"):
        table.add_column(title, overflow="fold")
    for (name, instance), card in cards.items():
        short = instance.removeprefix(f"{name}-")[:8]  # enough for people; --json has it whole
        if card is None:
            table.add_row(name, short, "not answering", style="red")
            continue
        table.add_row(
            name,
            short,
            card.host,
            str(card.pid),
            card.version,
            ", ".join(card.provides),
            ", ".join(card.resources),
            ", ".join(card.holds),
        )
    Console().print(table)
