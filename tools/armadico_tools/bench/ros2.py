"""From a ROS 2 robot's odometry to the command that it caused, and the same chain bare.

This process plays the robot: a simulated Jackal between two long walls, in real time, on DDS by the
loopback. Half a cycle after each odometry message the baseline ("floor") has its turn: an odometry
message in another namespace, answered by a process outside the society.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from contextlib import ExitStack
from functools import partial
from importlib.util import find_spec
from typing import Final

from msgspec.structs import replace

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.addresses import EXTRA, client_transport, robot_transport
from armadico.bridge.ros2.cdr import decode, encode
from armadico.bridge.ros2.frames import Decoder, Wanted, frame
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.bridge.ros2.session import wants
from armadico.bridge.ros2.simulated import Ros2SimulatedRobot
from armadico.bridge.ros2.simulated_line import Ros2Line
from armadico.bridge.simulator.plant import Site, seeded
from armadico.bridge.simulator.robots import Stage
from armadico.config.loading import find, load, load_entry
from armadico.config.profile import SensorProfile
from armadico_tools.bench.figures import Figure, figure
from armadico_tools.bench.latency import (
    CORRIDOR,
    LOST_S,
    WARM_UP,
    Floor,
    Stopwatch,
    await_all,
    simulated,
    society,
)
from armadico_tools.bench.processes import started

ROBOT: Final = "jackal"
AGENTS: Final = ("encoder", "laser", "goto", "interface")
DOMAIN: Final = 97
ADDRESS: Final = f"ros2://bench?domain={DOMAIN}&interface=lo"
FLOOR: Final = f"ros2://bench_floor?domain={DOMAIN}&interface=lo"
HALF_S: Final = 0.05
"""Delay from the society's turn to the floor's."""


def profile() -> Ros2Robot:
    """The robot, with odometry at the rate of cycles, so that each message makes a cycle."""
    jackal = load(find("robots", ROBOT), Ros2Robot)
    return replace(jackal, ros2=replace(jackal.ros2, odom_hz=1.0 / jackal.ros2.cycle_s))


class OdometryFloor:
    """The robot's end of the floor: it sends odometry, which a process answers."""

    def __init__(self, robot: Ros2Robot) -> None:
        self._command = robot.ros2.cmd_vel.name
        self._transport = robot_transport(FLOOR, "bench_floor")
        self._transport.open()
        self._transport.want([replace(each, writes=not each.writes) for each in _ends(robot)])
        self._odometry = frame(robot.ros2.odom.name, encode(types.Odometry()))
        self._decoder = Decoder()
        self.close = self._transport.close

    def go_round(self, patience_s: float) -> bool:
        """Send odometry. Returns whether the command arrived in time."""
        self._transport.write(self._odometry)
        end = time.perf_counter() + patience_s
        while (left := end - time.perf_counter()) > 0.0:
            if _has(self._decoder, self._command, self._transport.read(left)):
                return True
        return False


def _has(decoder: Decoder, topic: str, data: bytes) -> bool:
    return topic in [each for each, _ in decoder.feed(data)]


def odom_to_command(quick: bool) -> list[Figure]:
    """The society and the floor in turns, ten times a second each."""
    if find_spec("cyclonedds") is None:
        sys.stderr.write(f"odom-to-command is left out: {EXTRA}\n")
        return []
    with ExitStack() as stack:
        robot = profile()
        bare = OdometryFloor(robot)
        stack.callback(bare.close)
        stack.enter_context(started([sys.executable, "-P", "-m", __name__]))
        floor = stack.enter_context(Floor(HALF_S, LOST_S - HALF_S, bare.go_round))
        line = Ros2Line(robot_transport(ADDRESS, "bench"), robot.ros2)
        stack.callback(line.close)
        watch = Stopwatch(
            line,
            partial(_has, Decoder(), robot.ros2.odom.name),
            partial(_has, Decoder(), robot.ros2.cmd_vel.name),
            [floor],
        )
        stack.enter_context(simulated(_robot(robot), watch))
        stack.enter_context(society(ADDRESS, (), ROBOT, AGENTS))
        wanted = WARM_UP + (80 if quick else 500)
        whole, bare_ms = await_all([watch.latencies, floor.latencies], wanted)
    return [figure("odom-to-command", "ms", whole, bare_ms)]


def _robot(robot: Ros2Robot) -> Ros2SimulatedRobot:
    sensors = load_entry(find("robots", "sensors"), SensorProfile, "ideal")
    return Ros2SimulatedRobot(robot, Stage(sensors, Site(CORRIDOR), seeded(1), "/bench"))


def _ends(robot: Ros2Robot) -> list[Wanted]:
    """The topics at the client's end of the floor."""
    kept = (robot.ros2.odom.name, robot.ros2.cmd_vel.name)
    return [each for each in wants(robot.ros2).topics if each.topic in kept]


def main() -> None:
    """The floor's process: answer each odometry until the input is closed."""
    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
    robot = profile()
    transport = client_transport(FLOOR)
    transport.open()
    transport.want(_ends(robot))
    decoder = Decoder()
    while True:
        for topic, payload in decoder.feed(transport.read(1.0)):
            if topic == robot.ros2.odom.name:
                here = decode(types.Odometry, payload)
                command = types.TwistStamped(header=here.header)
                transport.write(frame(robot.ros2.cmd_vel.name, encode(command)))


if __name__ == "__main__":
    main()
