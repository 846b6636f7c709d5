"""Publish a society as ROS 2 topics, for RViz and other tools; a goal_pose sends the robot."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError

if TYPE_CHECKING:
    from armadico.bridge.ros2.samples import Address
    from armadico.gateways.gateway import Gateway
    from armadico.gateways.ros2.society import Society
    from armadico.mesh.zenoh import ZenohMesh

EXAMPLES: Final = """\
  armadico ros2 --world sc4                  by DDS, in domain $ROS_DOMAIN_ID or 0
  armadico ros2 'ros2://lab?domain=7'        its topics below /lab, in domain 7
  armadico ros2 ros2+zenoh://localhost:7447  by the router of rmw_zenoh
  armadico ros2 --beside                     of a robot that speaks ROS 2 itself
  armadico ros2 --namespace robot1 --namespace robot2
"""


def main(argv: Sequence[str]) -> int:
    args = parser().parse_args(argv)
    namespaces = options.namespaces(args)
    from armadico.bridge.ros2.addresses import read_address  # noqa: PLC0415 - not for --help

    try:
        address = read_address(args.address)
    except ValueError as error:
        raise UsageError(str(error)) from None
    meshes = options.join_each(args, namespaces)
    societies = _societies(args, namespaces, address.namespace)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    from armadico.gateways.gateway import serve  # noqa: PLC0415 - not for --help

    with ExitStack() as stack:
        try:
            gateways = [_gateway(args, address, m, societies[m.namespace], stack) for m in meshes]
        except OSError as error:
            raise FailedError(str(error)) from None
        who = ", ".join(options.shown(ns) for ns in namespaces)
        print(f"ros2: {who} in {address.where}", flush=True)
        try:
            serve(gateways)
        except OSError as error:
            raise FailedError(str(error)) from None
    return 0


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico ros2",
        "Publish a society as ROS 2 topics: tf, odometry, pose, sensors, maps, path, obstacles and"
        " who holds what. A goal_pose is a mission. No ROS is needed here.",
        EXAMPLES,
    )
    made.add_argument(
        "address",
        metavar="ADDRESS",
        nargs="?",
        default="ros2://",
        help="which ROS 2: ros2://[NAMESPACE][?domain=N][&interface=IF] by DDS,"
        " ros2+zenoh://[HOST[:PORT]][/NAMESPACE][?domain=N] by rmw_zenoh (default: ros2://)",
    )
    made.add_argument("--no-goals", action="store_true", help="take no goal_pose")
    made.add_argument(
        "--beside",
        action="store_true",
        help="the robot publishes its odometry, tf, scan and battery itself: leave them out",
    )
    made.add_argument("--world", metavar="MAP", help="publish the walls of this world as the map")
    options.add_mesh_options(made, several=True)
    return made


def _societies(
    args: argparse.Namespace, namespaces: Sequence[str], below: str
) -> dict[str, Society]:
    """A translator for each robot. Raises UsageError, ConfigError."""
    from armadico.gateways.ros2.society import Society, ros_namespace  # noqa: PLC0415

    world = options.world(args)
    own = {ns: "" if len(namespaces) == 1 else ns for ns in namespaces}
    places = {ns: "/".join(filter(None, (below, name))) for ns, name in own.items()}
    named: dict[str, str] = {}
    for ns, place in places.items():
        other = named.setdefault(ros_namespace(place), ns)
        if other != ns:
            raise UsageError(
                f"{other!r} and {ns!r} are both {ros_namespace(place)!r} in ROS 2, whose names have"
                " letters, digits and _ only"
            )
    return {ns: Society(place, world) for ns, place in places.items()}


def _gateway(
    args: argparse.Namespace, address: Address, mesh: ZenohMesh, society: Society, stack: ExitStack
) -> Gateway:
    """A robot's, in the mesh and in ROS 2. Raises OSError."""
    from armadico.bridge.ros2.addresses import join  # noqa: PLC0415 - not for --help
    from armadico.gateways.gateway import Gateway  # noqa: PLC0415
    from armadico.gateways.ros2.outside import NODE, SocietyNode  # noqa: PLC0415

    say = options.teller("armadico ros2")
    wire = join(replace(address, namespace=society.namespace), NODE)
    stack.callback(wire.close)
    goals = None if args.no_goals else society.goals
    outside = SocietyNode(wire, society.channels, goals, say, beside=args.beside)
    return Gateway(stack.enter_context(mesh), [society], outside, say)
