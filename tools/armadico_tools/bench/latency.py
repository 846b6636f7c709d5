"""From a status packet's last byte to the motor command that it caused, and the same path bare.

This process plays the microcontroller: a simulated Pioneer between two long walls, in real time
behind a TCP port. Two baselines ("floors") have their turns later in each cycle, so that other load
affects all three alike: bare Zenoh processes that publish as much to as many subscribers as the
society, and bare processes with the critical path alone.
"""

from __future__ import annotations

import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from typing import Final, Self

from armadico.bridge.p2os.commands import Cmd, quantity
from armadico.bridge.p2os.packets import Decoder
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.pioneer import Pioneer
from armadico.bridge.simulator.plant import Site, seeded
from armadico.bridge.simulator.robots import Stage
from armadico.bridge.simulator.server import Line, Simulation, TcpLine
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.config.loading import find, load, load_entry
from armadico.config.profile import SensorProfile
from armadico.config.scenarios import Scenario
from armadico.core.messages import (
    Ack,
    Ballot,
    Claim,
    Command,
    Cycle,
    Message,
    Point,
    RobotState,
    encode,
)
from armadico.launch.local import Launcher
from armadico.launch.society import Options
from armadico.mobile.messages import Echo, Pose, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico_tools.bench.figures import Figure, figure
from armadico_tools.bench.processes import floor_socket, ready_floor
from armadico_tools.testbed import Place

AGENTS: Final = ("encoder", "sonar", "goto", "interface")
GOAL: Final = (190.0, 0.0, 0.0)  # m, m, degrees: farther than it drives
DRIVE: Final = Scenario(
    name="corridor",
    world="empty",
    start=(0.0, 0.0, 0.0),
    goal=GOAL,
    plan="direct",
    robot="pioneer-2dx",
    agents=AGENTS,
)
CORRIDOR: Final = ((-1.0, 1.0, 201.0, 1.0), (-1.0, -1.0, 201.0, -1.0))  # m
MOTOR: Final = frozenset({int(Cmd.VEL), int(Cmd.RVEL), int(Cmd.VEL2), int(Cmd.ROTATE)})
STATUS_BYTES: Final = 36
"""Bytes of a status packet with the echoes of a cycle."""

LOST_S: Final = 0.09
"""A later command belongs to another status packet, or is missing."""

READY_S: Final = 10.0
"""Time limit for the floor's links, and between motor commands."""

SETTLE_S: Final = 0.2
"""How long a floor waits for its first answer before it sends again, while links come up."""

WARM_UP: Final = 20
"""Status packets that are not counted, while the robot accelerates."""


class Floor:
    """A thread that makes a round some time after each `turn`, and measures its duration.

    It starts once the first round is answered; `await_all` waits for that.
    """

    def __init__(self, delay_s: float, lost_s: float, go_round: Callable[[float], bool]) -> None:
        """`go_round` sends, and returns whether the answer arrived within so many seconds."""
        self.latencies: list[float] = []  # s
        self._delay_s, self._lost_s, self._go_round = delay_s, lost_s, go_round
        self._turns: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="floor", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._turns.put(False)
        self._thread.join()

    def turn(self) -> None:
        """Start a round, after the society's turn."""
        self._turns.put(True)

    def _run(self) -> None:
        while not (self._over.is_set() or self._go_round(SETTLE_S)):
            pass
        while self._turns.get() and not self._over.wait(self._delay_s):
            sent_at = time.perf_counter()
            if self._go_round(self._lost_s):
                self.latencies.append(time.perf_counter() - sent_at)


class Stopwatch:
    """A robot's end of a line that measures the time from a cycle to the command that returns.

    The floors have their turns afterwards.
    """

    def __init__(self, line: Line, floors: Sequence[Floor] = ()) -> None:
        self.latencies: list[float] = []  # s
        self._line, self._floors, self._decoder = line, floors, Decoder()
        self._sent_at: float | None = None

    def hang_up(self) -> bool:
        """Disconnect the client."""
        return self._line.hang_up()

    def write(self, data: bytes) -> None:
        """Send a status packet, which starts the watch."""
        self._sent_at = time.perf_counter()
        self._line.write(data)
        for floor in self._floors:
            floor.turn()

    def read(self, timeout_s: float) -> bytes | None:
        """Receive; a command stops the watch."""
        data = self._line.read(timeout_s)
        now = time.perf_counter()
        payloads = [*self._decoder.feed(data or b"", now)]
        if any(payload[0] in MOTOR for payload in payloads) and self._sent_at is not None:
            if now - self._sent_at < LOST_S:
                self.latencies.append(now - self._sent_at)
            self._sent_at = None
        return data


def sip_to_command(quick: bool) -> list[Figure]:
    """Every agent in its own process."""
    return _measured("sip-to-command", (), quick)


def sip_to_command_together(quick: bool) -> list[Figure]:
    """The robot agent, and one process for all others."""
    return _measured("sip-to-command-together", (AGENTS,), quick)


def _measured(name: str, together: tuple[tuple[str, ...], ...], quick: bool) -> list[Figure]:
    """The society and the floors in turns, ten times a second each."""
    wanted = WARM_UP + (80 if quick else 500)
    with ExitStack() as stack:
        floors = [
            stack.enter_context(_floor(traffic(), 0.04)),
            stack.enter_context(_floor(path(), 0.07)),
        ]
        line = TcpLine("127.0.0.1", 0)
        stack.callback(line.close)
        watch = Stopwatch(line, floors)
        stack.enter_context(simulated(pioneer(), watch))
        stack.enter_context(society(f"tcp://127.0.0.1:{line.port}", together))
        taken = [watch.latencies, *(bare.latencies for bare in floors)]
        whole, *bare_ms = await_all(taken, wanted)
    names = (name, f"{name}-path")
    return [figure(each, "ms", whole, bare) for each, bare in zip(names, bare_ms, strict=True)]


def await_all(taken: Sequence[Sequence[float]], wanted: int) -> list[list[float]]:
    """`wanted` latencies of each, ms, without the first ones. Raises TimeoutError on a stall."""
    have, since = 0, time.monotonic()
    while have < wanted:
        now = min(map(len, taken))
        if now > have:
            have, since = now, time.monotonic()
        elif time.monotonic() - since > READY_S:
            raise TimeoutError(f"no motor command for {READY_S:.0f} s")
        time.sleep(0.2)
    return [[1e3 * s for s in values[WARM_UP:wanted]] for values in taken]


def pioneer() -> Pioneer:
    sensors = load_entry(find("robots", "sensors"), SensorProfile, "ideal")
    stage = Stage(sensors, Site(CORRIDOR), seeded(1))
    return Pioneer(load(find("robots", "pioneer-2dx"), P2osRobot), stage)


@contextmanager
def simulated(robot: SimulatedRobot, line: Line) -> Iterator[None]:
    """A robot behind a line, in real time, on a thread."""
    simulation, over = Simulation(robot, line), threading.Event()
    thread = threading.Thread(target=simulation.run, args=(over.is_set,), name="robot", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def society(port: str, together: tuple[tuple[str, ...], ...]) -> Iterator[None]:
    """Robot agent and agents, with a mission down a corridor; without a guest on the mesh."""
    options = Options(robot=port, together=together)
    with (
        Place("bench") as place,
        closing(place.mesh()) as mesh,
        Launcher(DRIVE, options, mesh, place.namespace, tied=True) as launcher,
    ):
        launcher.start()
        launcher.begin()
        mesh.close()  # so that no guest receives
        yield


@contextmanager
def _floor(rules: Sequence[Sequence[str]], delay_s: float) -> Iterator[Floor]:
    """Processes with these rules; the first is the router, and has the TCP connection."""
    with ExitStack() as stack:
        router = stack.enter_context(floor_socket())
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        port = str(listener.getsockname()[1])
        for index, own in enumerate(rules):
            words = ("relay", "-", router) if index else ("ends", router, "-", port)
            stack.enter_context(ready_floor(*words, *own))
        connection, _ = listener.accept()
        stack.enter_context(connection)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def go_round(patience_s: float) -> bool:
            connection.settimeout(patience_s)
            try:
                connection.sendall(bytes(STATUS_BYTES))
                return bool(connection.recv(4096))
            except TimeoutError:
                return False

        yield stack.enter_context(Floor(delay_s, LOST_S, go_round))


def path() -> list[tuple[str, ...]]:
    """The critical path alone: robot, encoder, goto."""
    size = _sizes()
    return [
        (f"tcp>state:{size['state']}", f"cmd>tcp:{size['motor']}"),
        (f"state>pose:{size['pose']}",),
        (f"pose>cmd:{size['cmd']}",),
    ]


def traffic() -> list[tuple[str, ...]]:
    """All that the society publishes in a cycle, to all its subscribers."""
    size = _sizes()
    return [
        (
            f"tcp>state:{size['state']},ack:{size['ack']},sonar:{size['sonar']}",
            f"cmd>tcp:{size['motor']}",
            "claim",
        ),
        (f"state>pose:{size['pose']}",),
        ("state", f"sonar>obstacles:{size['obstacles']}"),
        ("state", "ack", "obstacles", f"pose>cmd:{size['cmd']},claim:{size['claim']}"),
        ("state", "pose"),
    ]


def _sizes() -> dict[str, int]:
    """Payload sizes of the society's messages, bytes."""
    number = 0.12345678901234
    cycle, ballot = Cycle(2**62, 1000), Ballot(3, 0.9, False, "goto-0123456789abcdef")
    point, echo = Point(number, number), Echo(number, number, number, number)
    messages: dict[str, Message] = {
        "state": RobotState(cycle, number, number, number, number, number, number, True, False),
        "ack": Ack("wheels", cycle, ballot, ballot, cycle, 0.9, False, (number,) * 2),
        "sonar": Sonar(cycle, 5.0, (echo, echo)),
        "pose": Pose(cycle, number, number, number),
        "obstacles": Obstacles(cycle, point, None, point, point, (point,) * 12),
        "cmd": Command("wheels", cycle, ballot, (number,) * 2),
        "claim": Claim("wheels", ballot, cycle, 1.0, False, (number,) * 2, (number,) * 2),
    }
    motor = quantity(Cmd.VEL, 0.3) + quantity(Cmd.RVEL, 0.1)
    return {key: len(encode(message)) for key, message in messages.items()} | {"motor": len(motor)}
