"""Connect programs and language models to a society by the Model Context Protocol (stdio)."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final

from armadico.cli import options
from armadico.cli.parsing import Command, group, option
from armadico.mesh.door import MCP
from armadico.watch.beside import Helpers

EXAMPLES: Final = """\
  armadico mcp --world house
  claude mcp add robot -- armadico mcp --world house
  {"mcpServers": {"robot": {"command": "armadico", "args": ["mcp", "--world", "house"]}}}
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    world: str | None = option("the world that the robot is in", metavar="MAP")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    """Serve until standard input ends."""
    world = options.world_of(args.world)
    mesh = args.mesh.join(MCP)
    from armadico.config.errands import load_mission
    from armadico.config.shipped import names
    from armadico.core.discovery import MISSIONS, installed
    from armadico.launch.client import Client
    from armadico.observe.watching import Watcher
    from armadico.watch.mcp.answers import Society
    from armadico.watch.mcp.guest import ASSISTANT
    from armadico.watch.mcp.lines import Lines
    from armadico.watch.mcp.server import Server

    missions = {n: load_mission(n).title for n in names("missions") if installed(MISSIONS)}
    options.end_as_by_ctrl_c()  # the helper leaves in order
    with ExitStack() as stack:
        stack.enter_context(mesh)
        watcher = Watcher([mesh])
        society = Society(world, missions, args.mesh.demand(), begun=watcher.clock() / 1e9)
        watcher.watch_alive()
        watcher.watch_router(society.view)
        watcher.subscribe()
        helpers = stack.enter_context(Helpers(args.mesh))
        server = Server(
            (Client(mesh), Client(mesh)),
            watcher,
            society,
            Lines(options.version()),
            lambda: helpers.start(args.mesh.namespace, ASSISTANT),
            sys.stdout.buffer,
        )
        server.serve(sys.stdin.buffer)
    return 0


main: Final = Command(
    "armadico mcp",
    Options,
    run,
    "Serve a society to one program on standard input and output: where, map, who, why,"
    " history, missions, goto, stop. What is asked for goes through the assistant agent, which"
    " is started if there is none: it publishes every request for people to see, replaces no"
    " mission, and releases no stop.",
    EXAMPLES,
)
