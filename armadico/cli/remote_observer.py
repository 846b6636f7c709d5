"""Watches a society from one of its hosts, and prints what it receives as lines of JSON.

A payload is in base64, with its key. Times are ns of the observer's own clock, and are compared
with no other's.

python -m armadico.cli.remote_observer --host lab3 --hosts demo
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Final

import msgspec

from armadico.cli import options
from armadico.core.resources import WHEELS
from armadico.observe.view import View
from armadico.observe.watching import Heard, Presence, Watcher, show

ASK_S: Final = 0.25
"""How often all agents are queried for their bids, and for their cards while one is missing."""

KEYS: Final = (WHEELS.ack_key, WHEELS.command_pattern, "mission/status")

EXAMPLES: Final = """\
  python -m armadico.cli.remote_observer --host lab3 --hosts demo
"""

_DECODER: Final[msgspec.json.Decoder[Heard | Presence]] = msgspec.json.Decoder(Heard | Presence)


def written(item: Heard | Presence) -> str:
    """One line, without its end."""
    return msgspec.json.encode(item).decode()


def read(line: str) -> Heard | Presence | None:
    """The item on a line; None if it is none of ours."""
    try:
        return _DECODER.decode(line)
    except msgspec.DecodeError:
        return None


def main(argv: Sequence[str] | None = None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    return options.guarded("watch", lambda: _main(arguments))


def _main(arguments: Sequence[str]) -> int:
    made = options.parser(
        "watch", "Print what is published and who is alive, a JSON line each.", EXAMPLES
    )
    options.add_mesh_options(made)
    with options.join(made.parse_args(arguments)) as mesh:
        watcher, view = Watcher([mesh]), View()
        watcher.watch_alive()
        for key in KEYS:
            watcher.hear(key)
        while True:
            watcher.ask_for_bids(ASK_S)
            if not view.complete:
                watcher.ask_for_cards(ASK_S)
            for item in watcher.until(time.monotonic() + ASK_S):
                show(view, item)
                print(written(item), flush=True)


if __name__ == "__main__":
    sys.exit(main())
