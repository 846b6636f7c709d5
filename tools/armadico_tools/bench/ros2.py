"""From a ROS 2 robot's odometry to the command that it caused, and the same chain bare.

This process plays the robot: a simulated Jackal between two long walls, in real time, on DDS by the
loopback. Half a cycle after each of its odometry messages the floor has its turn: an odometry
message in a namespace of its own, which a process answers that knows of no society.
"""

from __future__ import annotations

import os
import queue
import sys
import threading
import time
from contextlib import ExitStack
from importlib.util import find_spec
from typing import Final

from msgspec.structs import replace

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.addresses import EXTRA, client_transport, robot_transport
from armadico.bridge.ros2.cdr import decode, encode
from armadico.bridge.ros2.frames import Decoder, Wanted, frame
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.bridge.ros2.session import wants
from armadico.bridge.simulator.plant import Site, seeded
from armadico.bridge.simulator.robots import Stage
from armadico.bridge.simulator.ros2_line import Ros2Line
from armadico.bridge.simulator.ros2_robot import Ros2SimulatedRobot
from armadico.config.loading import find, load, load_entry
from armadico.config.profile import SensorProfile
from armadico_tools.bench.figures import Figure, Tell, figure
from armadico_tools.bench.latency import CORRIDOR, LOST_S, WARM_UP, await_all, simulated, society
from armadico_tools.bench.processes import started

ROBOT: Final = "jackal"
AGENTS: Final = ("encoder", "laser", "goto", "interface")
DOMAIN: Final = 97
ADDRESS: Final = f"ros2://bench?domain={DOMAIN}&interface=lo"
FLOOR: Final = f"ros2://bench_floor?domain={DOMAIN}&interface=lo"
HALF_S: Final = 0.05
"""From the society's turn to the floor's."""

SETTLE_S: Final = 0.05
"""How often an odometry message is said until the floor's process answers for the first time."""


def profile() -> Ros2Robot:
    """The robot, with odometry at the society's pace: so each one of it makes a cycle."""
    jackal = load(find("robots", ROBOT), Ros2Robot)
    return replace(jackal, ros2=replace(jackal.ros2, odom_hz=1.0 / jackal.ros2.cycle_s))


class Stopwatch:
    """The robot's end of the line, with the time of what goes out and of what comes back."""

    def __init__(self, line: Ros2Line, robot: Ros2Robot, bare: BarePath) -> None:
        self.latencies: list[float] = []  # s
        self._line, self._bare = line, bare
        self._odom, self._command = robot.ros2.odom.name, robot.ros2.cmd_vel.name
        self._sent_at: float | None = None
        self._out, self._in = Decoder(), Decoder()

    def hang_up(self) -> bool:
        return self._line.hang_up()

    def write(self, data: bytes) -> None:
        """Odometry goes out: the watch starts."""
        odometry = any(topic == self._odom for topic, _ in self._out.feed(data))
        if odometry:
            self._sent_at = time.perf_counter()
        self._line.write(data)
        if odometry:
            self._bare.turn()

    def read(self, timeout_s: float) -> bytes:
        """A command comes in: it stops."""
        data = self._line.read(timeout_s)
        now = time.perf_counter()
        heard = any(topic == self._command for topic, _ in self._in.feed(data))
        if heard and self._sent_at is not None:
            if now - self._sent_at < LOST_S:
                self.latencies.append(now - self._sent_at)
            self._sent_at = None
        return data


class BarePath:
    """The floor: a thread that says odometry half a cycle after `turn`, and waits for a command."""

    def __init__(self, robot: Ros2Robot) -> None:
        self.latencies: list[float] = []  # s
        self._odom, self._command = robot.ros2.odom.name, robot.ros2.cmd_vel.name
        self._transport = robot_transport(FLOOR, "bench_floor")
        self._transport.open()
        self._transport.want([replace(each, writes=not each.writes) for each in _ends(robot)])
        self._said = frame(self._odom, encode(types.Odometry()))
        self._decoder = Decoder()
        self._turns: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="floor", daemon=True)

    def turn(self) -> None:
        """Start a round: odometry went out elsewhere."""
        self._turns.put(True)

    def start(self) -> None:
        """Begin, once the process at the other end answers; `await_all` bounds the wait."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread, and leave."""
        self._over.set()
        self._turns.put(False)
        self._thread.join()
        self._transport.close()

    def _run(self) -> None:
        while not (self._over.is_set() or self._round(SETTLE_S)):
            pass
        while self._turns.get() and not self._over.wait(HALF_S):
            sent_at = time.perf_counter()
            if self._round(LOST_S - HALF_S):
                self.latencies.append(time.perf_counter() - sent_at)

    def _round(self, patience_s: float) -> bool:
        self._transport.write(self._said)
        end = time.perf_counter() + patience_s
        while (left := end - time.perf_counter()) > 0.0:
            if any(t == self._command for t, _ in self._decoder.feed(self._transport.read(left))):
                return True
        return False


def odom_to_command(quick: bool, tell: Tell) -> list[Figure]:
    """The society and the floor in turns, ten times a second each."""
    if find_spec("cyclonedds") is None:
        sys.stderr.write(f"odom-to-command is left out: {EXTRA}\n")
        return []
    wanted = WARM_UP + (80 if quick else 500)
    with ExitStack() as stack:
        robot = profile()
        bare = BarePath(robot)
        stack.enter_context(started([sys.executable, "-P", "-m", __name__]))
        stack.callback(bare.stop)
        bare.start()
        line = Ros2Line(robot_transport(ADDRESS, "bench"), robot.ros2)
        stack.callback(line.close)
        watch = Stopwatch(line, robot, bare)
        stack.enter_context(simulated(_robot(robot), watch))
        stack.enter_context(society(ADDRESS, (), ROBOT, AGENTS))
        taken = [watch.latencies, bare.latencies]
        await_all(taken, wanted, tell)
        whole, bare_ms = [[1e3 * s for s in values[WARM_UP:wanted]] for values in taken]
    return [figure("odom-to-command", "ms", whole, bare_ms)]


def _robot(robot: Ros2Robot) -> Ros2SimulatedRobot:
    sensors = load_entry(find("robots", "sensors"), SensorProfile, "ideal")
    return Ros2SimulatedRobot(robot, Stage(sensors, Site(CORRIDOR), seeded(1), "/bench"))


def _ends(robot: Ros2Robot) -> list[Wanted]:
    """What is read and written at the client's end of the floor."""
    kept = (robot.ros2.odom.name, robot.ros2.cmd_vel.name)
    return [each for each in wants(robot.ros2).topics if each.topic in kept]


def main() -> None:
    """The floor's process: each odometry is read, and answered, until the input is closed."""
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
