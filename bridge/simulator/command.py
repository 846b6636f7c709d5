"""Simulate a Pioneer behind a TCP port or a pseudo-terminal."""

from __future__ import annotations

import argparse
import math
import signal
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final

from armadico.cli import options

if TYPE_CHECKING:
    from armadico.bridge.simulator.pioneer import Pioneer
    from armadico.bridge.simulator.server import Line
    from armadico.config.moving import Moving
    from armadico.config.scenarios import Scenario

PORT: Final = 8101
"""Where simulators of Pioneers listen."""

EXAMPLES: Final = """\
  armadico sim sc4                           at tcp://127.0.0.1:8101, as MobileSim is
  armadico sim floor --start 2 3 90 --sensors real --seed 7
  armadico sim my.map --pty /tmp/pioneer     clients open /tmp/pioneer as their serial port
"""


def main(argv: Sequence[str]) -> int:
    """Simulate until interrupted."""
    args = parser().parse_args(argv)
    mesh = options.join(args)
    robot = _robot(_scenario(args), args.seed)
    with ExitStack() as stack:
        line, where = _line(args, stack)
        stack.enter_context(mesh)
        robot.watch(lambda truth: mesh.publish("sim/truth", truth))
        print(f"a simulated Pioneer in {args.world} at {where}; Ctrl-C ends it", flush=True)
        _run(robot, line)
    return 0


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    made = options.parser(
        "armadico sim",
        "A simulated Pioneer in real time. It speaks P2OS, and tells watchers the truth on"
        " sim/truth.",
        EXAMPLES,
    )
    made.add_argument("world", metavar="WORLD", help="a shipped world, or a .map or .yaml file")
    line = made.add_mutually_exclusive_group()
    line.add_argument(
        "--port", type=int, default=PORT, help=f"TCP port (default {PORT}; 0: one that is free)"
    )
    line.add_argument(
        "--pty", metavar="LINK", nargs="?", const="", help="a pseudo-terminal instead"
    )
    made.add_argument(
        "--bind", metavar="ADDRESS", default="127.0.0.1", help="where to listen (default: loopback)"
    )
    made.add_argument(
        "--start",
        nargs=3,
        type=float,
        metavar=("X", "Y", "DEG"),
        help="where it stands, m, m, degrees (default: the world's own start, or 0 0 0)",
    )
    made.add_argument("--robot", default="pioneer-2dx", help="robot profile (default %(default)s)")
    made.add_argument(
        "--sensors", choices=("ideal", "real"), default="ideal", help="default %(default)s"
    )
    made.add_argument(
        "--moving",
        metavar="JSON",
        default="[]",
        help="a scenario's [[moving]], as a list",
    )
    made.add_argument("--seed", type=int, default=0, help="of all noise (default 0)")
    options.add_mesh_options(made)
    return made


def _scenario(args: argparse.Namespace) -> Scenario:
    """The scenario that the options describe."""
    from armadico.config.scenarios import Scenario  # noqa: PLC0415 - not for --help
    from armadico.config.worlds import load_world  # noqa: PLC0415 - not for --help

    world = load_world(args.world)
    start = (0.0, 0.0, 0.0)
    if args.start is not None:
        start = (args.start[0], args.start[1], args.start[2])
    elif world.start is not None:
        x, y, theta = world.start
        start = (x, y, math.degrees(theta))
    if not all(map(math.isfinite, start)):
        raise options.UsageError("--start: expected finite m, m and degrees")
    return Scenario(
        world=args.world,
        start=start,
        goal=start,
        robot=args.robot,
        sensors=args.sensors,
        moving=_moving(args.moving),
    )


def _moving(text: str) -> tuple[Moving, ...]:
    import msgspec  # noqa: PLC0415 - not for --help

    from armadico.config.moving import Moving  # noqa: PLC0415 - not for --help

    try:
        return msgspec.json.decode(text, type=tuple[Moving, ...])
    except msgspec.DecodeError as error:
        raise options.UsageError(f"--moving: {error}") from None


def _robot(scenario: Scenario, seed: int) -> Pioneer:
    """The robot; it does not start in a wall."""
    from armadico.bridge.simulator.pioneer import of_scenario  # noqa: PLC0415 - not for --help
    from armadico.bridge.simulator.plant import seeded  # noqa: PLC0415 - not for --help

    robot = of_scenario(scenario, seeded(seed))
    if robot.plant.clearance() <= 0.0:
        x, y, _ = scenario.start
        raise options.UsageError(
            f"the robot cannot start at {x:g}, {y:g}: it would stand in a wall;"
            " --start X Y DEG puts it elsewhere"
        )
    return robot


def _line(args: argparse.Namespace, stack: ExitStack) -> tuple[Line, str]:
    """The line that the options name, and how a robot agent calls it."""
    from armadico.bridge.p2os.transports import PtyTransport  # noqa: PLC0415 - not for --help
    from armadico.bridge.simulator.server import TcpLine  # noqa: PLC0415 - not for --help

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
    if not 0 <= args.port < 2**16:
        raise options.UsageError(f"--port {args.port}: from 0 to 65535")
    try:
        tcp = TcpLine(args.bind, args.port)
    except OSError as error:
        raise options.FailedError(
            f"cannot use {args.bind}:{args.port}: {error.strerror or error}; is another simulator"
            " running? --port 0 takes a port that is free"
        ) from None
    stack.callback(tcp.close)
    return tcp, f"tcp://{args.bind}:{tcp.port}"


def _run(robot: Pioneer, line: Line) -> None:
    from armadico.bridge.simulator.server import Simulation  # noqa: PLC0415 - not for --help

    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    Simulation(robot, line).run(ended.is_set)
