"""Simulate a robot behind a TCP port or a pseudo-terminal."""

from __future__ import annotations

import math
import os
import secrets
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from armadico.bridge.simulator.traps import KIND, UNKIND, Trap
from armadico.cli import options
from armadico.cli.parsing import PORT as LISTEN
from armadico.cli.parsing import Command, Must, argument, group, option, several
from armadico.mesh.door import SIMULATOR

if TYPE_CHECKING:
    from armadico.bridge.kind import Network
    from armadico.bridge.simulator.server import Line
    from armadico.bridge.simulator.simulated import SimulatedRobot
    from armadico.config.moving import Moving
    from armadico.config.profile import RobotProfile
    from armadico.config.scenarios import Battery, Scenario
    from armadico.mesh.zenoh import ZenohMesh
    from armadico.mobile.geometry import Pose2

PRINTED: Final = Must(
    lambda name: 0 < len(name) <= 128 and name.isprintable(), "expected 1 to 128 printed characters"
)

PORT: Final = 8101
"""TCP port of simulated Pioneers."""

LOOPBACK: Final = "ros2://?interface=lo"
"""Default address of a simulated ROS 2 robot: it does not use the network."""

DEFAULT_ROBOT: Final = "pioneer-2dx"

KEY: Final = "sim/truth"

EXAMPLES: Final = """\
  armadico sim sc4                           at tcp://127.0.0.1:8101, as MobileSim
  armadico sim floor --start 2 3 90 --sensors real --seed 7
  armadico sim my.map --pty /tmp/pioneer     clients open /tmp/pioneer as their serial port
  armadico sim sc1 --unkind                  with peculiarities of real controllers
  armadico sim sc1 --unkind short            with P2OS's short status packets, not ARCOS's
  armadico sim jackal sc4                    a ROS 2 robot, in frames over TCP
  armadico sim jackal sc4 --ros2             a ROS 2 robot on this machine, by DDS
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    world: str = ""  # set by `_named`
    named: tuple[str, ...] = argument(
        "a shipped world, or a .map or .yaml file; before it a robot's profile (default:"
        f" {DEFAULT_ROBOT}); a shipped robot alone is in the empty world",
        nargs="+",
        metavar="NAME",
    )
    port: int = option(
        f"listen on this TCP port; 0: a free port (default: {PORT})",
        default=PORT,
        must=LISTEN,
        either="line",
    )
    pty: str | None = option(
        "use a pseudo-terminal instead, with this link to it",
        either="line",
        metavar="LINK",
        nargs="?",
        const="",
    )
    ros2: str | None = option(
        "be a ROS 2 robot that any ROS 2 program can drive: ros2://NAMESPACE?domain=0 for DDS,"
        " ros2+zenoh://HOST:PORT/NAMESPACE as the router of rmw_zenoh's nodes (default:"
        f" {LOOPBACK}, DDS within this machine)",
        either="line",
        metavar="ADDRESS",
        nargs="?",
        const=LOOPBACK,
    )
    bind: str = option(
        "listen on this address (default: 127.0.0.1)", default="127.0.0.1", metavar="ADDRESS"
    )
    start: tuple[float, float, float] | None = option(
        "start at this pose, m, m, degrees (default: the world's start, or 0 0 0)",
        metavar=("X", "Y", "DEG"),
    )
    also: tuple[tuple[str, str, str, str], ...] = several(
        "add a robot to the world: its namespace and pose; it listens on a free port; may be"
        " repeated",
        metavar=("NS", "X", "Y", "DEG"),
    )
    robot: str = option(
        f"the robot's profile, if it is not before the world (default: {DEFAULT_ROBOT})",
        default="",
        metavar="PROFILE",
    )
    sensors: str = option(
        "errors of the sensors (default: %(default)s)",
        default="ideal",
        choices=("glass", "ideal", "real"),
    )
    moving: str = option(
        "a scenario's [[moving]], as a list (default: [])", default="[]", metavar="JSON"
    )
    charge: float = option("charge of the battery (default: 1, full)", default=1.0, metavar="SHARE")
    capacity: float | None = option(
        "capacity of the battery, Ah (default: the profile's)", metavar="AH"
    )
    unkind: tuple[str, ...] | None = option(
        "imitate peculiarities of real controllers: those given, or all of"
        f" {', '.join(trap.value for trap in Trap)}",
        nargs="*",
        choices=[trap.value for trap in Trap],
        metavar="TRAP",
    )
    seed: int = option("seed of the noise (default: 0)", default=0)
    id: str | None = option(
        "publish the true state under this id, for armadico run --simulator ID (default: a new"
        " id, which shipped controllers report as their name)",
        metavar="ID",
        must=PRINTED,
    )
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    args = _named(args)
    mesh = args.mesh.join(SIMULATOR, passing=False, starts=True)
    scenario = _scenario(args)
    robots = [_robot(scenario, args, k) for k in range(1 + len(scenario.others))]
    try:
        robots[0].meet(*robots[1:])
    except ValueError as error:  # two robots overlap
        raise options.UsageError(f"--also: {error}") from None
    with ExitStack() as stack:
        ended = _ended()  # from here on there is something to leave behind
        line, where = _line(args, robots[0].name, stack)
        served, places = [(robots[0], line)], [where]
        _show(robots[0], mesh, stack)
        for other, (namespace, *_) in zip(robots[1:], args.also, strict=True):
            ros2 = None if args.ros2 is None else _network(args).beside(args.ros2, namespace)
            line, where = _line(replace(args, port=0, ros2=ros2), other.name, stack)
            served.append((other, line))
            places.append(where)
            _show(other, args.mesh.of(namespace).join(SIMULATOR, starts=True), stack)
        what = f"a simulated {args.robot}"
        if args.also:
            what = f"{len(robots)} simulated robots ({args.robot})"
        at = ", at ".join(places)
        ids = ", ".join(dict.fromkeys(robot.simulator for robot in robots))
        print(f"{what} in {args.world} at {at}; id {ids}; Ctrl-C ends it", flush=True)
        if args.ros2 is not None:
            drive = f"armadico run SCENARIO --robot '{places[0]}' --profile {args.robot}"
            print(f"drive it with: {drive}", flush=True)
        _run(served, ended)
    return 0


def _named(args: Options) -> Options:
    """The options with `robot` and `world` set from the names. Raises UsageError."""
    from armadico.bridge.kind import kind_of
    from armadico.config.loading import names
    from armadico.config.profile import load_profile

    *robots, world = args.named
    if not robots and world in names("robots"):
        robots, world = [world], "empty"
    if len(robots) > 1:
        named = " ".join(args.named)
        raise options.UsageError(f"{named}: expected one world, and at most one robot before it")
    if robots and args.robot:
        raise options.UsageError(f"--robot {args.robot}: {robots[0]} is given already")
    robot = args.robot or "".join(robots) or DEFAULT_ROBOT
    if args.unkind is not None and not kind_of(load_profile(robot)).unkind:
        raise options.UsageError(f"--unkind is for P2OS robots; {robot} is not one")
    return replace(args, world=world, robot=robot)


def _show(robot: SimulatedRobot, mesh: ZenohMesh, stack: ExitStack) -> None:
    """Publish the true state of a robot in its namespace."""
    stack.enter_context(mesh)
    robot.watch(lambda truth: mesh.publish(KEY, truth))
    _remark(mesh)


def _remark(mesh: ZenohMesh) -> None:
    """Print a warning about each other simulator in the namespace."""
    from armadico.mobile.messages import Truth

    known: set[str] = set()

    def on_truth(key: str, data: bytes) -> None:
        truth = mesh.read(Truth, key, data)
        if truth is not None and truth.simulator not in known:
            known.add(truth.simulator)
            print(
                f"armadico sim: another simulator publishes in the namespace {mesh.namespace!r}:"
                f" {truth.simulator}; end one, or use --namespace NAME",
                file=sys.stderr,
                flush=True,
            )

    mesh.subscribe(KEY, on_truth)


def _scenario(args: Options) -> Scenario:
    """The scenario of the options. Raises UsageError or ConfigError."""
    from armadico.config.profile import load_profile
    from armadico.config.scenarios import Scenario
    from armadico.config.worlds import doubts, load_world

    world = load_world(args.world)
    for doubt in doubts(args.world):
        options.report(doubt)
    start = world.start or (0.0, 0.0, 0.0)
    if args.start is not None:
        words = "--start {:g} {:g} {:g}".format(*args.start)
        start = _pose(args.start, words, "and -360 to 360 degrees")
    moving = _moving(args.moving)
    radius = load_profile(args.robot).body.circle_m
    for each in moving:
        for _, fault in each.faults(world, start[:2], radius):
            raise options.UsageError(f"--moving: {fault}")
    return Scenario(
        world=args.world,
        start=start,
        goal=start,
        others=_others(args),
        robot=args.robot,
        sensors=args.sensors,
        moving=moving,
        battery=_battery(args.charge, args.capacity),
    )


def _pose(numbers: Sequence[str | float], given: str, expected: str) -> Pose2:
    """A start pose, given as m, m, degrees. Raises UsageError."""
    from armadico.bridge.simulator.microcontroller import WORLD_M

    try:
        x, y, heading = map(float, numbers)
    except ValueError:
        x = math.inf
    if not (abs(x) <= WORLD_M and abs(y) <= WORLD_M and abs(heading) <= 360.0):  # NaN is not
        expected = f"expected m and m within {WORLD_M:g} m, {expected}"
        raise options.UsageError(f"{given}: {expected}")
    return x, y, math.radians(heading)


def _others(args: Options) -> tuple[Pose2, ...]:
    """The start poses of the other robots. Raises UsageError."""
    found = [_pose(also[1:], f"--also {' '.join(also)}", "and degrees") for also in args.also]
    names = [args.mesh.namespace, *(also[0] for also in args.also)]
    if len(set(names)) < len(names):
        raise options.UsageError(f"--also: two robots in one namespace: {', '.join(names)}")
    if found and args.moving != "[]":
        raise options.UsageError("--moving is for one robot, without --also")
    return tuple(found)


def _battery(charge: float, capacity: float | None) -> Battery:
    import msgspec

    from armadico.config.scenarios import Battery

    given = {"charge": charge, "capacity_ah": capacity}
    try:
        return msgspec.convert(given, Battery)
    except msgspec.ValidationError as error:
        raise options.UsageError(f"--charge {charge:g}, --capacity {capacity}: {error}") from None


def _moving(text: str) -> tuple[Moving, ...]:
    import msgspec

    from armadico.config.moving import Moving

    try:
        return msgspec.json.decode(text, type=tuple[Moving, ...])
    except msgspec.MsgspecError as error:
        raise options.UsageError(f"--moving: {error}") from None


def _robot(scenario: Scenario, args: Options, index: int = 0) -> SimulatedRobot:
    """The robot, or one of the others. Raises UsageError if it would start in a wall."""
    from msgspec.structs import replace as with_

    from armadico.bridge.kind import simulated
    from armadico.bridge.simulator.plant import seeded

    # Without an id from a run, the robot agent recognizes its robot's truth by the name.
    name = args.id or f"sim-{os.getpid()}-{secrets.token_hex(3)}"
    if args.ros2 is not None:
        name = _node(args, args.also[index - 1][0] if index else None)
    streams = seeded(args.seed)
    if index:
        scenario = with_(scenario, start=scenario.others[index - 1])
        first, streams = streams, lambda name: first(f"{index}/{name}")
    traps = KIND if args.unkind is None else frozenset(map(Trap, args.unkind)) or UNKIND
    robot = simulated(scenario, streams, name, traps=traps, clock_s=time.time())
    robot.simulator = args.id or name
    if robot.plant.clearance() <= 0.0:
        x, y, _ = scenario.start
        raise options.UsageError(
            f"the robot cannot start at {x:g}, {y:g}, in a wall; choose another --start X Y DEG"
        )
    return robot


def _line(args: Options, name: str, stack: ExitStack) -> tuple[Line, str]:
    """The line of the options, and its address for a robot agent."""
    if args.ros2 is not None:
        return _in_network(args, name, stack), args.ros2
    from armadico.bridge.serial_lines import PtyTransport
    from armadico.bridge.simulator.server import TcpLine
    from armadico.cli.doctor import listener

    if args.pty is not None:
        pty = PtyTransport(args.pty)
        try:
            pty.open()
        except OSError as error:
            raise options.FailedError(
                f"cannot use the pseudo-terminal: {error.strerror or error}"
            ) from None
        stack.callback(pty.close)
        return pty, f"serial://{pty.path}"
    try:
        # A simulator with a client does not listen, so its port could be bound a second time.
        if args.port and (owner := listener(args.port)):
            raise OSError(0, f"it is taken by {owner}")
        tcp = TcpLine(args.bind, args.port)
    except OSError as error:
        raise options.FailedError(
            f"cannot use {args.bind}:{args.port}: {error.strerror or error}; is another simulator"
            " running? --port 0 uses a free port"
        ) from None
    stack.callback(tcp.close)
    return tcp, f"tcp://{args.bind}:{tcp.port}"


def _network(args: Options) -> Network[RobotProfile]:
    """The network of robots of this kind. Raises UsageError if it has none."""
    from armadico.bridge.kind import kind_of
    from armadico.config.profile import load_profile

    network = kind_of(load_profile(args.robot)).network
    if network is None:
        raise options.UsageError(
            f"--ros2: {args.robot} is not a ROS 2 robot; try armadico sim jackal --ros2"
        )
    return network()


def _node(args: Options, namespace: str | None) -> str:
    """The name of a robot in the network. Raises UsageError."""
    try:
        return _network(args).node(str(args.ros2), args.robot, namespace)
    except ValueError as error:
        raise options.UsageError(f"--ros2: {error}") from None


def _in_network(args: Options, name: str, stack: ExitStack) -> Line:
    """The line of a robot in the network. Raises UsageError or FailedError."""
    from armadico.config.profile import load_profile

    try:
        return _network(args).line(str(args.ros2), load_profile(args.robot), name, stack)
    except ValueError as error:
        raise options.UsageError(f"--ros2: {error}") from None
    except OSError as error:
        raise options.FailedError(f"--ros2: {error}") from None


def _ended() -> threading.Event:
    """An event that a signal sets; the process ends soon after it, whatever hangs."""
    from armadico.runtime.signals import arm_deadline, await_signals, ending

    ended = threading.Event()

    def leave() -> None:
        arm_deadline()  # a mesh whose router has just been killed may hang
        ended.set()

    await_signals(dict.fromkeys(ending(), leave))
    return ended


def _run(served: Sequence[tuple[SimulatedRobot, Line]], ended: threading.Event) -> None:
    """Serve until interrupted: the first robot in this thread, the others in threads."""
    from armadico.bridge.simulator.server import Pace, Simulation

    pace, turn = Pace(), threading.Lock() if len(served) > 1 else None
    first, *others = (Simulation(robot, line, pace=pace, turn=turn) for robot, line in served)
    threads = [threading.Thread(target=other.run, args=(ended.is_set,)) for other in others]
    for thread in threads:
        thread.start()
    try:
        first.run(ended.is_set)
    finally:
        ended.set()
        for thread in threads:
            thread.join()


main: Final = Command(
    "armadico sim",
    Options,
    run,
    "Simulate a robot in real time. It uses P2OS as a Pioneer, or ROS 2, and publishes its true"
    " state on sim/truth.",
    EXAMPLES,
)
