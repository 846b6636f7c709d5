"""From a status packet's last byte to the motor command that it caused, and the same path bare.

This process plays the microcontroller: a simulated Pioneer between two long walls, in real time
behind a TCP port. Later in each cycle two floors have their turns, so that whatever else the
machine does happens to all three: bare Zenoh processes that publish as much to as many subscribers
as the society does, and bare processes with the critical path alone.
"""

from __future__ import annotations

import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from typing import Final

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
from armadico_tools.bench.figures import Figure, Tell, figure
from armadico_tools.bench.processes import floor_socket, ready_floor
from armadico_tools.testbed import Place

AGENTS: Final = ("encoder", "sonar", "goto", "interface")
GOAL: Final = (190.0, 0.0, 0.0)  # m, m, degrees: farther than it gets
CORRIDOR: Final = ((-1.0, 1.0, 201.0, 1.0), (-1.0, -1.0, 201.0, -1.0))  # m
MOTOR: Final = frozenset({int(Cmd.VEL), int(Cmd.RVEL), int(Cmd.VEL2), int(Cmd.ROTATE)})
STATUS_BYTES: Final = 36
"""Of a status packet with the echoes of a cycle."""

LOST_S: Final = 0.09
"""What has not come by then answers another status packet, or none."""

READY_S: Final = 10.0
"""Time limit for the floor's links, and from one motor command to the next."""

ATTEMPTS: Final = 50

WARM_UP: Final = 20
"""Status packets that are not counted, while the robot picks up speed."""


class Stopwatch:
    """The robot's end of a line, with the time of what goes out and of what comes back."""

    def __init__(self, line: TcpLine, sent: Sequence[Callable[[], None]]) -> None:
        self.latencies: list[float] = []  # s
        self._line = line
        self._sent = sent
        self._sent_at: float | None = None
        self._decoder = Decoder()

    def hang_up(self) -> bool:
        """The robot is done with its client."""
        return self._line.hang_up()

    def write(self, data: bytes) -> None:
        """Status packets go out: the watch starts."""
        self._sent_at = time.perf_counter()
        self._line.write(data)
        for tell in self._sent:
            tell()

    def read(self, timeout_s: float) -> bytes | None:
        """A motor command comes in: it stops."""
        data = self._line.read(timeout_s)
        now = time.perf_counter()
        for payload in self._decoder.feed(data or b"", now):
            if payload[0] in MOTOR and self._sent_at is not None:
                if now - self._sent_at < LOST_S:
                    self.latencies.append(now - self._sent_at)
                self._sent_at = None
        return data


class BarePath:
    """A floor: a thread that sends some time after `turn`, and waits for the answer."""

    def __init__(self, connection: socket.socket, delay_s: float) -> None:
        self.latencies: list[float] = []  # s
        self._connection = connection
        self._delay_s = delay_s
        self._turns: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="floor", daemon=True)

    def start(self) -> None:
        """Begin, once the bytes come round. Raises RuntimeError if they do not."""
        self._connection.settimeout(READY_S / ATTEMPTS)
        for _ in range(ATTEMPTS):  # links come up in the background
            if self._round():
                self._connection.settimeout(LOST_S)
                self._thread.start()
                return
        raise RuntimeError(f"nothing came round the floor within {READY_S:.0f} s")

    def turn(self) -> None:
        """Start a round: a status packet went out elsewhere."""
        self._turns.put(True)

    def stop(self) -> None:
        self._over.set()
        self._turns.put(False)
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while self._turns.get() and not self._over.wait(self._delay_s):
            sent_at = time.perf_counter()
            if self._round():
                self.latencies.append(time.perf_counter() - sent_at)

    def _round(self) -> bool:
        try:
            self._connection.sendall(bytes(STATUS_BYTES))
            return bool(self._connection.recv(4096))
        except TimeoutError:
            return False


def sip_to_command(quick: bool, tell: Tell) -> list[Figure]:
    """Every agent a process of its own."""
    return _measured("sip-to-command", (), quick, tell)


def sip_to_command_together(quick: bool, tell: Tell) -> list[Figure]:
    """The robot agent beside one process for all the others."""
    return _measured("sip-to-command-together", (AGENTS,), quick, tell)


def _measured(
    name: str, together: tuple[tuple[str, ...], ...], quick: bool, tell: Tell
) -> list[Figure]:
    """The society and the floors, one after the other, ten times a second each."""
    wanted = WARM_UP + (80 if quick else 500)
    with ExitStack() as stack:
        floors = [
            stack.enter_context(_floor(traffic(), 0.04)),
            stack.enter_context(_floor(path(), 0.07)),
        ]
        line = TcpLine("127.0.0.1", 0)
        stack.callback(line.close)
        watch = Stopwatch(line, [bare.turn for bare in floors])
        stack.enter_context(simulated(_pioneer(), watch))
        stack.enter_context(society(f"tcp://127.0.0.1:{line.port}", together))
        taken = [watch.latencies, *(bare.latencies for bare in floors)]
        await_all(taken, wanted, tell)
        whole, *bare_ms = [[1e3 * s for s in values[WARM_UP:wanted]] for values in taken]
    names = (name, f"{name}-path")
    return [figure(each, "ms", whole, bare) for each, bare in zip(names, bare_ms, strict=True)]


def await_all(taken: Sequence[Sequence[float]], wanted: int, tell: Tell) -> None:
    """Until all have so many. Raises TimeoutError if one of them gets no farther."""
    have, since = 0, time.monotonic()
    while have < wanted:
        now = min(map(len, taken))
        if now > have:
            have, since = now, time.monotonic()
            tell(min(have / wanted, 1.0))
        elif time.monotonic() - since > READY_S:
            raise TimeoutError(f"no motor command for {READY_S:.0f} s")
        time.sleep(0.2)


def _pioneer() -> Pioneer:
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
def society(
    port: str,
    together: tuple[tuple[str, ...], ...] = (),
    robot: str = "pioneer-2dx",
    agents: tuple[str, ...] = AGENTS,
) -> Iterator[None]:
    """Robot agent and agents, with a mission down a corridor; no guest listens in."""
    scenario = Scenario(
        name="corridor",
        world="empty",
        start=(0.0, 0.0, 0.0),
        goal=GOAL,
        plan="direct",
        robot=robot,
        agents=agents,
    )
    options = Options(robot=port, together=together)
    with (
        Place("bench") as place,
        closing(place.mesh()) as mesh,
        Launcher(scenario, options, mesh, place.namespace, tied=True) as launcher,
    ):
        launcher.start()
        launcher.begin()
        mesh.close()  # no guest listens in
        yield


@contextmanager
def _floor(rules: Sequence[Sequence[str]], delay_s: float) -> Iterator[BarePath]:
    """Processes that follow these rules; the first is the router, and has the TCP connection."""
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
        bare = BarePath(connection, delay_s)
        stack.callback(bare.stop)
        bare.start()
        yield bare


def path() -> list[tuple[str, ...]]:
    """The way alone: robot, encoder, goto."""
    size = _sizes()
    return [
        (f"tcp>state:{size['state']}", f"cmd>tcp:{size['motor']}"),
        (f"state>pose:{size['pose']}",),
        (f"pose>cmd:{size['cmd']}",),
    ]


def traffic() -> list[tuple[str, ...]]:
    """All that the society publishes in a cycle, to all that subscribe to it there."""
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
