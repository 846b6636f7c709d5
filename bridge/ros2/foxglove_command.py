"""Serve a society live to Foxglove, with ROS 2's types and nothing of ROS installed."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Final

from armadico.cli import options
from armadico.cli.options import FailedError
from armadico.cli.parsing import Command, flag, group, option

PORT: Final = 8765
"""The port that Foxglove connects to by default."""

INSTALL: Final = f"{sys.executable} -m pip install 'armadico[foxglove]'"

EXAMPLES: Final = """\
  armadico foxglove --world sc4              then, in Foxglove: open ws://localhost:8765
  armadico foxglove --goals                  and take goals from its 3D panel
  armadico foxglove --port 0                 a port that is free; it is printed
  armadico foxglove --namespace robot1 --namespace robot2
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    port: int = options.port_option(PORT)
    bind: str = options.bind_option("any machine")
    goals: bool = flag(
        "accept goals, from any program that reaches the port, including pages in a browser"
    )
    world: str | None = option(
        "show the walls of this world as the map (default: none)", metavar="MAP"
    )
    mesh: options.Meshes = group(options.Meshes, "the mesh")


def run(args: Options) -> int:
    meshes = args.mesh.join_each()
    namespaces = [mesh.namespace for mesh in meshes]
    world = options.world_of(args.world)
    if find_spec("foxglove") is None:
        raise FailedError(f"Foxglove's SDK is not installed; it is an extra: {INSTALL}")
    options.end_as_by_ctrl_c()
    from armadico.bridge.ros2.gateway.foxglove import Served, Server, ServerError
    from armadico.bridge.ros2.gateway.gateway import Gateway, serve
    from armadico.observe.translators import translators

    made = translators(namespaces, dict.fromkeys(namespaces, world))
    goals = {ns: [each.goals.topic for each in made[ns]] if args.goals else [] for ns in namespaces}
    with ExitStack() as stack:
        try:
            topics = [topic for several in goals.values() for topic in several]
            server = Server(" ".join(namespaces), args.bind, args.port, topics)
        except ServerError as error:
            raise FailedError(str(error)) from None
        stack.callback(server.close)
        gateways = []
        for mesh in meshes:
            stack.enter_context(mesh)
            ns = mesh.namespace
            offered = [channel for each in made[ns] for channel in each.channels]
            outside = Served(server, offered, goals[ns])
            report = options.reporter("armadico foxglove")
            gateways.append(Gateway(mesh, made[ns], outside, report))
        print(f"foxglove: ws://{args.bind}:{server.port}", flush=True)
        serve(gateways)
    return 0


main: Final = Command(
    "armadico foxglove",
    Options,
    run,
    "Serve a society live to Foxglove: maps, pose, path, sensors and holders, with ROS 2's"
    " types. Ctrl-C ends it.",
    EXAMPLES,
)
