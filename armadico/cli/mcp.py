"""Let programs and language models look and ask, by the Model Context Protocol (stdio)."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from armadico.cli import options

if TYPE_CHECKING:
    from armadico.launch.processes import Process

EXAMPLES: Final = """\
  armadico mcp --world house
  claude mcp add robot -- armadico mcp --world house
  {"mcpServers": {"robot": {"command": "armadico", "args": ["mcp", "--world", "house"]}}}
"""


def main(argv: Sequence[str]) -> int:
    """Serve until standard input ends."""
    args = parser().parse_args(argv)
    world = options.world(args)
    mesh = options.join(args)
    from armadico.config.discovery import providers  # noqa: PLC0415 - not for --help
    from armadico.config.missions import load_mission  # noqa: PLC0415
    from armadico.config.shipped import names  # noqa: PLC0415
    from armadico.observe.mcp.answers import Society  # noqa: PLC0415
    from armadico.observe.mcp.lines import Lines  # noqa: PLC0415
    from armadico.observe.mcp.server import Server  # noqa: PLC0415
    from armadico.observe.watching import Watcher  # noqa: PLC0415
    from armadico.runtime.client import Client  # noqa: PLC0415

    missions = {name: load_mission(name).title for name in names("missions")}
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:  # the helper leaves in order
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    with ExitStack() as stack:
        stack.enter_context(mesh)
        watcher = Watcher([mesh])
        watcher.watch_alive()
        watcher.hear()
        words = [*options.joining(args), "--namespace", args.namespace]
        server = Server(
            (Client(mesh), Client(mesh)),
            watcher,
            Society(world, missions, providers),
            Lines(options.version()),
            stack.enter_context(Helper(words)).start,
            sys.stdout.buffer,
        )
        server.serve(sys.stdin.buffer)
    return 0


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    made = options.parser(
        "armadico mcp",
        "Serve a society to one program on standard input and output: where, map, who, why,"
        " history, missions, goto, stop. What is asked for goes through the assistant agent, which"
        " is started if there is none: it takes everything down for people to see, drives nobody"
        " off, and releases no stop.",
        EXAMPLES,
    )
    made.add_argument("--world", metavar="MAP", help="the world that the robot is in")
    options.add_mesh_options(made)
    return made


class Helper:
    """The assistant agent that is started here, and leaves with this process."""

    def __init__(self, words: Sequence[str]) -> None:
        """Nothing is started; `words` say which mesh it joins."""
        self._words = words
        self._folder = TemporaryDirectory(prefix="armadico-mcp-")
        self._process: Process | None = None

    def __enter__(self) -> Helper:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        self._folder.cleanup()

    def end(self) -> None:
        """End it, if there is one."""
        from armadico.launch.processes import end  # noqa: PLC0415 - not for --help

        if self._process is not None:
            end(self._process.popen)
            self._process = None

    def start(self) -> None:
        """Start it; the one before it has not answered, and would only keep this one out."""
        from armadico.config.scenarios import society  # noqa: PLC0415 - not for --help
        from armadico.launch.processes import Process  # noqa: PLC0415 - not for --help

        self.end()
        name = society().assistant
        log = Path(self._folder.name) / f"{name}.log"
        self._process = Process(name, ["agent", name, *self._words], log, tied=True)
