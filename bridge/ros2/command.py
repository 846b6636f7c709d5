"""Publish a society as ROS 2 topics, for RViz and other tools, and accept goals from them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, argument, flag, group, option
from armadico.mesh.door import ROS2

if TYPE_CHECKING:
    from armadico.bridge.ros2.gateway.gateway import Gateway
    from armadico.bridge.ros2.gateway.society import Society
    from armadico.bridge.ros2.samples import Address
    from armadico.mesh.zenoh import ZenohMesh

EXAMPLES: Final = """\
  armadico ros2 --world sc4                  by DDS, in domain $ROS_DOMAIN_ID or 0
  armadico ros2 'ros2://lab?domain=7'        topics below /lab, in domain 7
  armadico ros2 ros2+zenoh://localhost:7447  by the router of rmw_zenoh
  armadico ros2 --beside                     for a robot that uses ROS 2 itself
  armadico ros2 --namespace robot1 --namespace robot2
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    address: str = argument(
        "the ROS 2 network: ros2://[NAMESPACE][?domain=N][&interface=IF] by DDS,"
        " ros2+zenoh://[HOST[:PORT]][/NAMESPACE][?domain=N] by rmw_zenoh (default: ros2://)",
        default="ros2://",
        metavar="ADDRESS",
        nargs="?",
    )
    no_goals: bool = flag("ignore goal_pose")
    beside: bool = flag(
        "leave out odometry, tf, scan and battery, which the robot publishes itself"
    )
    world: str | None = option(
        "publish the walls of this world as the map (default: none)", metavar="MAP"
    )
    mesh: options.Meshes = group(options.Meshes, "the mesh")


def run(args: Options) -> int:
    from armadico.bridge.ros2.addresses import read_address

    try:
        address = read_address(args.address)
    except ValueError as error:
        raise UsageError(str(error)) from None
    meshes = args.mesh.join_each(ROS2)
    namespaces = [mesh.namespace for mesh in meshes]
    societies = _societies(args, namespaces, address.namespace)
    options.end_as_by_ctrl_c()
    from armadico.bridge.ros2.gateway.gateway import serve

    with ExitStack() as stack:
        try:
            gateways = [_gateway(args, address, m, societies[m.namespace], stack) for m in meshes]
        except OSError as error:
            raise FailedError(str(error)) from None
        robots = ", ".join(options.shown(ns) for ns in namespaces)
        print(f"ros2: {robots} in {address.where}", flush=True)
        try:
            serve(gateways)
        except OSError as error:
            raise FailedError(str(error)) from None
    return 0


def _societies(args: Options, namespaces: Sequence[str], below: str) -> dict[str, Society]:
    """A translator for each robot. Raises UsageError, ConfigError."""
    from armadico.bridge.ros2.gateway.society import Society, ros_namespace

    world = options.world_of(args.world)
    own = {ns: "" if len(namespaces) == 1 else ns for ns in namespaces}
    places = {ns: "/".join(filter(None, (below, name))) for ns, name in own.items()}
    named: dict[str, str] = {}
    for ns, place in places.items():
        other = named.setdefault(ros_namespace(place), ns)
        if other != ns:
            raise UsageError(
                f"--namespace {ns}: in ROS 2 it is {ros_namespace(place)!r}, as is {other!r};"
                " expected names that differ in letters, digits and _"
            )
    return {ns: Society(place, world) for ns, place in places.items()}


def _gateway(
    args: Options, address: Address, mesh: ZenohMesh, society: Society, stack: ExitStack
) -> Gateway:
    """The gateway of one robot. Raises OSError."""
    from armadico.bridge.ros2.addresses import join
    from armadico.bridge.ros2.gateway.gateway import Gateway
    from armadico.bridge.ros2.gateway.outside import NODE, SocietyNode

    report = options.reporter("armadico ros2")
    wire = join(replace(address, namespace=society.namespace), NODE)
    stack.callback(wire.close)
    goals = None if args.no_goals else society.goals
    outside = SocietyNode(wire, society.channels, goals, report, beside=args.beside)
    return Gateway(stack.enter_context(mesh), society, outside, report)


main: Final = Command(
    "armadico ros2",
    Options,
    run,
    "Publish a society as ROS 2 topics: tf, odometry, pose, sensors, maps, path, obstacles and"
    " holders. A goal_pose becomes a mission. ROS need not be installed.",
    EXAMPLES,
)
