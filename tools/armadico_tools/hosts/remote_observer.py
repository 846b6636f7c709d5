"""Watches a society from one of its hosts, and tells whoever reads its output, line by line.

python -m armadico_tools.hosts.remote_observer --host lab3 --hosts demo
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.core.messages import Ack, BidHistory, Card, Command, Message, MissionStatus
from armadico.core.resources import WHEELS
from armadico.observe.view import driver
from armadico.observe.watching import Heard, Presence, Watcher, read_or_none
from armadico_tools.hosts import events

if TYPE_CHECKING:
    from armadico.mesh.zenoh import ZenohMesh

ASK_S: Final = 0.25
"""How often everybody is asked for their bids, and for a card that is missing."""

KEYS: Final = (WHEELS.ack_key, WHEELS.command_pattern, "mission/status")

EXAMPLES: Final = """\
  python -m armadico_tools.hosts.remote_observer --host lab3 --hosts demo
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Watch until interrupted."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    return options.guarded("watch", lambda: _main(arguments))


def _main(arguments: Sequence[str]) -> int:
    made = options.parser(
        "watch", "Tell what is said and who is there, a JSON line each.", EXAMPLES
    )
    options.add_mesh_options(made)
    args = made.parse_args(arguments)
    mesh = options.join(args)
    with mesh:
        for each in _watch(mesh):
            print(events.written(each), flush=True)
    return 0


def _watch(mesh: ZenohMesh) -> Iterator[events.News]:
    watcher = Watcher([mesh])
    watcher.watch_alive()
    for key in KEYS:
        watcher.hear(key)
    here: set[str] = set()
    homes: set[str] = set()
    ask_at = 0.0
    while True:
        now = time.monotonic()
        if now >= ask_at:
            ask_at = now + ASK_S
            watcher.ask_for_bids(ASK_S)
            if here - homes:
                watcher.ask_for_cards(ASK_S)
        item = watcher.take(ask_at - now)
        if isinstance(item, Presence):
            if item.there != (item.instance in here):
                (here.add if item.there else here.discard)(item.instance)
                yield events.Token(item.at / 1e9, item.instance, item.there)
        elif isinstance(item, Heard):
            for each in told(read_or_none(item), item.at / 1e9):
                if not isinstance(each, events.Home):
                    yield each
                elif each.instance not in homes:
                    homes.add(each.instance)
                    yield each


def told(message: Message | None, at: float) -> Iterator[events.News]:
    """What a message is worth telling; `at` in s."""
    if isinstance(message, Ack) and message.resource == WHEELS.name:
        yield _cycle(message, at)
    elif isinstance(message, Command) and message.resource == WHEELS.name:
        yield events.Commanded(at, message.ballot.instance, message.cycle.number)
    elif isinstance(message, Card):
        yield events.Home(message.instance, message.host)
    elif isinstance(message, BidHistory) and message.bids:
        last = message.bids[-1]
        yield events.Bidding(at, message.instance, last.utility, last.reason)
    elif isinstance(message, MissionStatus):
        yield events.Mission(at, message.state.value, message.to_go)


def _cycle(ack: Ack, at: float) -> events.Cycle:
    v = float(ack.measured[0]) if ack.measured else 0.0
    obeyed, answered = ack.obeyed, ack.obeyed_cycle
    if driver(ack) is None or obeyed is None or answered is None:
        return events.Cycle(at, ack.cycle.number, "", 0, v)
    return events.Cycle(at, ack.cycle.number, obeyed.instance, answered.number, v)


if __name__ == "__main__":
    sys.exit(main())
