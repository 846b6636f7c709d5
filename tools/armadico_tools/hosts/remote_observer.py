"""Hears a society from one of its hosts, and passes it on as lines of JSON to who reads its output.

Times are of the observer's own clock, and are compared with nobody else's.

python -m armadico_tools.hosts.remote_observer --host lab3 --hosts demo
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

import msgspec

from armadico.cli import options
from armadico.core.resources import WHEELS
from armadico.observe.view import View
from armadico.observe.watching import Heard, Presence, Watcher, show

if TYPE_CHECKING:
    from armadico.mesh.zenoh import ZenohMesh

ASK_S: Final = 0.25
"""How often everybody is asked for their bids, and for their cards while one is missing."""

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
            print(written(each), flush=True)
    return 0


def _watch(mesh: ZenohMesh) -> Iterator[Heard | Presence]:
    watcher, view = Watcher([mesh]), View()
    watcher.watch_alive()
    for key in KEYS:
        watcher.hear(key)
    ask_at = 0.0
    while True:
        now = time.monotonic()
        if now >= ask_at:
            ask_at = now + ASK_S
            watcher.ask_for_bids(ASK_S)
            if not view.complete:
                watcher.ask_for_cards(ASK_S)
        item = watcher.take(ask_at - now)
        if item is not None:
            show(view, item)
            yield item


_DECODER: Final[msgspec.json.Decoder[Heard | Presence]] = msgspec.json.Decoder(Heard | Presence)


def written(item: Heard | Presence) -> str:
    """One line, without its end."""
    return msgspec.json.encode(item).decode()


def read(line: str) -> Heard | Presence | None:
    """What a line says; None if it is none of ours."""
    try:
        return _DECODER.decode(line)
    except msgspec.DecodeError:
        return None


if __name__ == "__main__":
    sys.exit(main())
