"""A society of real processes that is attacked, and what an attack did to it.

What the robot does is read off the line between the robot agent and the simulator, which no message
can forge. Processes are counted by the system.
"""

from __future__ import annotations

import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Self

import psutil

from armadico.config.endpoints import Endpoints, endpoints
from armadico.core.messages import Command, Description, Log, Message, RobotState, decode
from armadico.launch.client import Client
from armadico.launch.processes import command_line, kill_trees
from armadico.mesh import sockets
from armadico.mesh.door import VIEWER
from armadico.mesh.ports import free_port
from armadico.mobile.messages import Origin, Trajectory
from armadico.runtime.errors import MissionRefusedError
from armadico_tools.attacks.attempts import DRIVES, RESTS, STOPPED, Attempt, Known
from armadico_tools.attacks.peer import Peer
from armadico_tools.faults.serial_tap import Orders, Tap
from armadico_tools.testbed import sockets_in

FAR_M: Final = 2_000.0
REACH_M: Final = 10_000.0
AGENTS: Final = (
    *("robot", "encoder", "sonar", "goto", "avoid", "gothrough"),
    *("path-planning", "interface", "teleop", "monitor"),
)
ROAD: Final = """\
world = "empty"
sensors = "ideal"
start = [0.0, 0.0, 0.0]
goal = [9.0, 0.0, 0.0]
"""
SOON_S: Final = 40.0
AFTER_S: Final = 2.0
"""How long the robot is watched after an attack."""

PERIOD_S: Final = 0.1
STANDS: Final = 0.7
"""An order to stand for more than this share of an attack is an effect; alone it is 0."""

TAPE: Final = 3_000  # most messages that are replayed


class VictimError(RuntimeError):
    """The society did not come to the state in which it is attacked."""


class Drive:
    """The speeds that the robot agent orders on the line, with their times."""

    def __init__(self) -> None:
        self._orders = Orders()
        self._lock = threading.Lock()
        self._kept: deque[tuple[float, float, float]] = deque(maxlen=20_000)

    def write(self, data: bytes, at: float) -> None:
        with self._lock:
            self._kept += [(o.at, o.v, o.w) for o in self._orders.feed(data, at)]

    def between(self, begin: float, end: float) -> list[tuple[float, float]]:
        """The speeds (m/s, rad/s) in effect at each tenth of a second."""
        with self._lock:
            kept = list(self._kept)
        found, v, w, index = [], 0.0, 0.0, 0
        for step in range(round((end - begin) / PERIOD_S)):
            while index < len(kept) and kept[index][0] <= begin + step * PERIOD_S:
                _, v, w = kept[index]
                index += 1
            found.append((v, w))
        return found

    def now(self) -> tuple[float, float]:
        """The newest order."""
        with self._lock:
            return self._kept[-1][1:] if self._kept else (0.0, 0.0)


class Victim:
    """A society on this computer, with a port, with or without keys; as a context manager."""

    namespace = "robot1"

    def __init__(self, *, keys: bool) -> None:
        self.known = Known()
        self.drive = Drive()
        self._keys = keys
        self._stack = ExitStack()
        self._lines: deque[str] = deque(maxlen=1000)
        self._programs: list[subprocess.Popen[bytes]] = []
        self._up: psutil.Process | None = None
        self._tape: list[tuple[float, str, bytes]] = []
        self._goal = FAR_M

    def __enter__(self) -> Self:
        temporary = TemporaryDirectory(prefix="armadico-", dir="/tmp")
        self.folder = Path(self._stack.enter_context(temporary))
        self._stack.enter_context(sockets_in(self.folder / "run"))
        self._stack.callback(lambda: kill_trees(*self._programs))
        self.port = free_port()
        address = f"127.0.0.1:{self.port}"
        self.endpoint = f"{'tls' if self._keys else 'tcp'}/{address}"
        self.socket = sockets.endpoint(sockets.socket_of(self.namespace))
        self.table = self.folder / "hosts.toml"
        names = ", ".join(f'"{name}"' for name in AGENTS if name != "monitor")
        keys = 'keys = "keys"\n' if self._keys else ""
        text = f'{keys}[here]\nrouter = "{self.endpoint}"\nagents = [{names}]\n'
        self.table.write_text(text, encoding="utf-8")
        (self.folder / "road.toml").write_text(ROAD, encoding="utf-8")
        if self._keys:
            self.call("keys", "init", "--host", "here", "--person", "anna", "--person", "me")
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()
        self._stack.close()

    @property
    def where(self) -> Endpoints:
        return endpoints(self.namespace, hosts=self.table, host="here")

    def call(self, *words: str) -> str:
        """Run a command to its end. Raises VictimError if it fails."""
        command = command_line([*words, "--hosts", str(self.table)], tied=False)
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=SOON_S)
        if done.returncode:
            raise VictimError(f"armadico {' '.join(words)}: {done.stdout}{done.stderr}")
        return done.stdout

    def _popen(self, *words: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{words[0]}.log").open("ab") as log:
            command = command_line(
                [*words, "--hosts", str(self.table), "--host", "here"], tied=True
            )
            made = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
        self._programs.append(made)
        return made

    # The society ---------------------------------------------------------------------------------

    def start(self) -> None:
        """Start simulator, society and observers."""
        simulator = free_port()
        self._popen("sim", "empty", "--port", str(simulator))
        self._until(lambda: sockets.answers(f"tcp/127.0.0.1:{simulator}", 1.0), "the simulator")
        self._tap = Tap(f"tcp://127.0.0.1:{simulator}", self.drive.write)
        road = str(self.folder / "road.toml")
        far = ("--set", f"interface.reach_m={REACH_M:g}")
        words = ("up", road, "--robot", self._tap.url, *far, "--with", "teleop", "--restarts", "50")
        self._up = psutil.Process(self._popen(*words).pid)
        self._mesh = self.where.mesh(VIEWER, starts=True)
        self._mesh.open()
        self.viewer = Client(self._mesh)
        self._mesh.subscribe("**", self._keep)
        self._controls = self.where.mesh("person-me" if self._keys else "", starts=True)
        self._controls.open()
        self.person = Client(self._controls)
        self._until(lambda: {n for n, _ in self.viewer.alive} >= {*AGENTS} - {"monitor"}, "agents")
        self.known.alive = dict(self.viewer.alive)

    def stop(self) -> None:
        for mesh in (self._mesh, self._controls):
            mesh.close()
        kill_trees(*self._programs)
        self._programs.clear()
        self._tap.close()

    def restart(self) -> None:
        """Start all anew: an attack has left something behind."""
        self.stop()
        self.drive = Drive()
        self.known = Known(tape=self.known.tape, person=self.known.person, me=self.known.me)
        self.start()

    def keep_tape(self) -> None:
        """Keep what was published so far as the recording of an earlier day."""
        self.known.tape = self._tape[-TAPE:]

    def bring(self, state: str) -> None:
        """Bring the robot into a state. Raises VictimError."""
        latest = self.viewer.latest(RobotState, 5.0)
        if latest is None:
            raise VictimError("the robot agent publishes no state")
        if latest.stop.stopped:
            self.person.resume(by="person")
        if state == RESTS:
            if self.drive.now() != (0.0, 0.0) or self.known.mission[1]:
                self.restart()
        else:
            self._send()
            if state == STOPPED:
                self.person.stop(by="person")
                self._until(lambda: self.drive.now() == (0.0, 0.0), "the robot stands")
        self.settle()

    def _send(self) -> None:
        """Send the robot on its way, if it does not drive."""

        def on_its_way() -> bool:
            if self.drive.now()[0] < 0.2:
                with suppress(MissionRefusedError, TimeoutError):
                    self._goal = FAR_M + (self._goal + 1.0) % 100.0
                    self.person.goto(self._goal, 0.0, 0.0, direct=True)
                self.viewer.settle(1.5)
            return self.drive.now()[0] > 0.2

        self._until(on_its_way, "the robot drives")

    def settle(self) -> None:
        """Let the observers catch up."""
        self.viewer.wait_for(lambda: False, 0.3)

    def pids(self) -> dict[int, float]:
        """The processes of the society, and when each began."""
        assert self._up is not None, "it is started"
        found = {}
        with suppress(psutil.Error):
            for process in self._up.children(recursive=True):
                with suppress(psutil.Error):
                    found[process.pid] = process.create_time()
        return found

    # Attacks -------------------------------------------------------------------------------------

    def attacked(self, what: Attempt, peer: Peer, seconds: float) -> list[str]:
        """Make an attempt, and return its effects, in words; none is good."""
        self.bring(what.state)
        before, alive = self.pids(), {i for _, i in self.viewer.alive}
        phantoms: set[str] = set()
        lines = len(self._lines)
        thread = threading.Thread(target=what.make, args=(peer, self.known, seconds), daemon=True)
        began = time.monotonic()
        thread.start()
        while thread.is_alive():
            self.viewer.wait_for(lambda: False, 0.1)
            phantoms |= {i for _, i in self.viewer.alive} - alive
        end = time.monotonic()
        self.viewer.wait_for(lambda: False, AFTER_S)
        effects = [*self._on_the_line(what.state, began, end)]
        stop = self.viewer.latest(RobotState)
        if stop is not None and stop.stop.stopped != (what.state == STOPPED):
            effects.append("stop released" if what.state == STOPPED else "robot stopped")
        gone = [pid for pid in before if pid not in self.pids()]
        if gone:
            effects.append(f"{len(gone)} processes ended")
        if phantoms:
            effects.append(f"{len(phantoms)} false agents shown")
        if peer.arrived:
            effects.append(f"{peer.arrived} messages read")
        if any("FORGED" in line for line in list(self._lines)[lines:]):
            effects.append("forged log lines shown")
        return effects

    def _on_the_line(self, state: str, began: float, end: float) -> list[str]:
        during, after = self.drive.between(began, end), self.drive.between(end, end + AFTER_S)
        found = []
        if state == DRIVES:
            stood = sum(v < 0.05 for v, _ in during) / max(len(during), 1)
            if stood > 1 - STANDS:
                found.append(f"stood {stood:.0%} of the time")
            if all(v < 0.05 for v, _ in after[-5:]):
                found.append("stands afterwards")
            slow = sum(0.05 <= v < 0.2 for v, _ in during) / max(len(during), 1)
            if slow > 1 - STANDS:
                found.append(f"slow {slow:.0%} of the time")
            if max(abs(w) for _, w in during) > 0.25:
                found.append(f"steered ({sum(abs(w) for _, w in during) * PERIOD_S:.1f} rad)")
        else:
            moved = sum(abs(v) for v, _ in during + after) * PERIOD_S
            turned = sum(abs(w) for _, w in during + after) * PERIOD_S
            if moved > 0.02 or turned > 0.02:
                found.append(f"moved {moved:.2f} m, {turned:.1f} rad")
        return found

    # Observing -----------------------------------------------------------------------------------

    def _keep(self, key: str, data: bytes) -> None:
        """Keep what the attacker may know; on Zenoh's thread."""
        k, message = self.known, _decoded(key, data)
        if len(self._tape) < 20 * TAPE:
            self._tape.append((time.monotonic(), key, data))
        match message:
            case RobotState():
                k.cycle = [message.cycle.epoch, message.cycle.number]
                k.counter, k.press = message.stop.counter, message.stop.press
                k.state = _plain(data)
            case Description():
                k.description = _plain(data)
            case Command() if message.action is not None:
                b = message.ballot
                k.ballot = [b.term, b.utility, b.critical, b.instance]
            case Trajectory():
                k.mission = message.counter, message.mission
            case Origin():
                k.origin = _plain(data)
            case Log():
                self._lines.append(message.text)

    def _until(self, condition: Callable[[], object], what: str) -> None:
        end = time.monotonic() + SOON_S
        while not condition():
            if time.monotonic() > end:
                logs = [p.read_text(errors="replace")[-1500:] for p in self.folder.glob("*.log")]
                raise VictimError(f"not within {SOON_S:.0f} s: {what}\n" + "\n".join(logs))
            viewer = getattr(self, "viewer", None)
            if viewer is None:
                time.sleep(0.1)
            else:
                viewer.wait_for(lambda: False, 0.1)


_KINDS: Final[Mapping[str, type[Message]]] = {
    "robot/state": RobotState,
    "robot/description": Description,
}


def _decoded(key: str, data: bytes) -> Message | None:
    first = key.split("/")
    kind = _KINDS.get(key)
    if first[:2] == ["robot", "cmd"]:
        kind = Command
    elif first[0] in ("trajectory", "log"):
        kind = Trajectory if first[0] == "trajectory" else Log
    elif first[:2] == ["encoder", "origin"]:
        kind = Origin
    if kind is None:
        return None
    with suppress(ValueError):
        return decode(data, kind)
    return None


def _plain(data: bytes) -> list[object]:
    import cbor2

    return list(cbor2.loads(data))
