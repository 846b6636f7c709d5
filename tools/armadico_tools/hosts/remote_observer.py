"""Watches a society from one of its hosts, and tells whoever reads its output, line by line.

python -m armadico_tools.hosts.remote_observer --host lab3 --hosts demo

A line is what came, as JSON: a payload (in base64) with its key, or a token. Times are ns of the
observer's own clock, and are compared with nobody else's.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

import msgspec

from armadico.cli import options
from armadico.core.resources import WHEELS
from armadico.observe.watching import Heard, Presence, Watcher

ASK_S: Final = 0.25
"""How often everybody is asked for their bids, and for their cards."""

KEYS: Final = (WHEELS.ack_key, WHEELS.command_pattern, "mission/status")

EXAMPLES: Final = """\
  python -m armadico_tools.hosts.remote_observer --host lab3 --hosts demo
"""


def read(line: str) -> Heard | Presence | None:
    """What a line says; None if it is none of ours."""
    with suppress(msgspec.DecodeError):
        return msgspec.json.decode(line, type=Heard)
    with suppress(msgspec.DecodeError):
        return msgspec.json.decode(line, type=Presence)
    return None


def main(argv: Sequence[str] | None = None) -> int:
    """Watch until interrupted."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    return options.guarded("watch", lambda: _main(arguments))


def _main(arguments: Sequence[str]) -> int:
    made = options.parser(
        "watch", "Tell what is said and who is there, a JSON line each.", EXAMPLES
    )
    options.add_mesh_options(made)
    with options.join(made.parse_args(arguments)) as mesh:
        watcher = Watcher([mesh])
        watcher.watch_alive()
        for key in KEYS:
            watcher.hear(key)
        while True:
            watcher.ask_for_bids(ASK_S)
            watcher.ask_for_cards(ASK_S)
            for item in watcher.until(time.monotonic() + ASK_S):
                print(msgspec.json.encode(item).decode(), flush=True)


if __name__ == "__main__":
    sys.exit(main())
