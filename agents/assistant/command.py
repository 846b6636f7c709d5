"""Let programs and language models look and ask, by the Model Context Protocol (stdio)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Final

from armadico.cli import options
from armadico.cli.beside import Helpers

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
    from armadico.agents.assistant.mcp_answers import Society  # noqa: PLC0415
    from armadico.agents.assistant.mcp_lines import Lines  # noqa: PLC0415
    from armadico.agents.assistant.mcp_server import Server  # noqa: PLC0415
    from armadico.config.discovery import providers  # noqa: PLC0415 - not for --help
    from armadico.config.errands import load_mission  # noqa: PLC0415
    from armadico.config.scenarios import society as standard  # noqa: PLC0415
    from armadico.config.shipped import names  # noqa: PLC0415
    from armadico.observe.watching import Watcher  # noqa: PLC0415
    from armadico.runtime.client import Client  # noqa: PLC0415

    missions = {name: load_mission(name).title for name in names("missions")}
    options.end_as_by_ctrl_c()  # the helper leaves in order
    with ExitStack() as stack:
        stack.enter_context(mesh)
        watcher = Watcher([mesh])
        society = Society(world, missions, providers, begun=watcher.clock() / 1e9)
        watcher.watch_alive()
        watcher.watch_router(society.view)
        watcher.hear()
        helpers = stack.enter_context(Helpers(args))
        server = Server(
            (Client(mesh), Client(mesh)),
            watcher,
            society,
            Lines(options.version()),
            lambda: helpers.start(args.namespace, standard().assistant),
            sys.stdout.buffer,
        )
        server.serve(sys.stdin.buffer)
    return 0


def parser() -> argparse.ArgumentParser:
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
