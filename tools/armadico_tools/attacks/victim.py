"""A society of real processes that is attacked, and what an attack did to it.

What the robot does is read off the line between the robot agent and the simulator, which no message
can forge. Processes are counted by the system.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import ExitStack, suppress
from functools import partial
from typing import Final, Self

import cbor2
import psutil

from armadico.core.messages import (
    Command,
    Description,
    Log,
    MessageError,
    RobotState,
    decode,
)
from armadico.launch.client import Client
from armadico.mesh import sockets
from armadico.mesh.door import VIEWER, person
from armadico.mesh.ports import free_port
from armadico.mobile.messages import Origin, Trajectory
from armadico.observe.watching import kind_at
from armadico.runtime.errors import MissionRefusedError
from armadico_tools.attacks.attempts import DRIVES, RESTS, STOPPED, Attempt, Known
from armadico_tools.attacks.peer import Peer
from armadico_tools.faults.serial_tap import Orders, Tap
from armadico_tools.testbed import Place, PlaceError

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
AFTER_S: Final = 2.0
"""How long the robot is watched after an attack."""

PERIOD_S: Final = 0.1
STANDS: Final = 0.7
"""An order to stand for more than this share of an attack is an effect; alone it is 0."""

TAPE: Final = 3_000  # most messages that are replayed


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


class Victim(Place):
    """A society on this computer, with a port, with or without keys; as a context manager."""

    def __init__(self, *, keys: bool) -> None:
        super().__init__("attacks")
        self.known = Known()
        self.drive = Drive()
        self._keys = keys
        self._running = ExitStack()
        self._lines: deque[str] = deque(maxlen=1000)
        self._tape: list[tuple[float, str, bytes]] = []
        self._goal = FAR_M

    def __enter__(self) -> Self:
        super().__enter__()
        names = [name for name in AGENTS if name != "monitor"]
        self.where = self.table("r", "tls" if self._keys else "tcp", names, ("anna", "me"))
        self.namespace = self.where.namespace
        (self.endpoint,) = self.where.known
        self.socket = sockets.endpoint(sockets.socket_of(self.namespace))
        self._road = self._folder / "road.toml"
        self._road.write_text(ROAD, encoding="utf-8")
        self.up()
        return self

    def __exit__(self, *error: object) -> None:
        self._running.close()
        super().__exit__(*error)

    def joining(self, host: str) -> tuple[str, ...]:  # noqa: ARG002 - there is one
        return ("--namespace", self.namespace, *self.where.words)

    # The society ---------------------------------------------------------------------------------

    def up(self) -> None:
        """Start simulator, society and observers."""
        port = free_port()
        tap = Tap(f"tcp://127.0.0.1:{port}", self.drive.write)
        self._running.callback(tap.close)
        self._running.callback(self.kill)
        self.viewer, self.person = (
            Client(self._running.enter_context(self.where.mesh(name, starts=True)))
            for name in (VIEWER, person("me"))
        )
        self.viewer.mesh.subscribe("**", self._keep)
        self.start("", "simulator", ["sim", "empty", f"--port={port}", *self.joining("")])
        answers = partial(sockets.answers, f"tcp/127.0.0.1:{port}", 1.0)
        self.until(self.viewer, answers, "the simulator")
        words = ["up", str(self._road), "--robot", tap.url, "--with", "teleop", "--restarts", "50"]
        words += ["--set", f"interface.reach_m={REACH_M:g}", *self.joining("")]
        self._up = psutil.Process(self.start("", "society", words).pid)
        agents = {*AGENTS} - {"monitor"}
        self.until(self.viewer, lambda: {n for n, _ in self.viewer.alive} >= agents, "agents")
        self.known.alive = dict(self.viewer.alive)

    def restart(self) -> None:
        """Start all anew: an attack has left something behind."""
        self._running.close()
        self.drive = Drive()
        self.known = Known(tape=self.known.tape, me=self.known.me)
        self.up()

    def keep_tape(self) -> None:
        """Keep what was published so far as the recording of an earlier day."""
        self.known.tape = self._tape[-TAPE:]

    def bring(self, state: str) -> None:
        """Bring the robot into a state. Raises PlaceError."""
        latest = self.viewer.latest(RobotState, 5.0)
        if latest is None:
            raise PlaceError("the robot agent publishes no state")
        if latest.stop.stopped:
            self.person.resume(by="person")
        if state == RESTS:
            if self.drive.now() != (0.0, 0.0) or self.known.mission[1]:
                self.restart()
        else:
            self._send()
            if state == STOPPED:
                self.person.stop(by="person")
                self.until(self.viewer, lambda: self.drive.now() == (0.0, 0.0), "the robot stands")
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

        self.until(self.viewer, on_its_way, "the robot drives")

    def settle(self) -> None:
        """Let the observers catch up."""
        self._watch(0.3)

    def _watch(self, seconds: float) -> None:
        self.viewer.wait_for(lambda: False, seconds)

    def _pids(self) -> set[int]:
        """The processes of the society."""
        with suppress(psutil.Error):
            return {process.pid for process in self._up.children(recursive=True)}
        return set()

    # Attacks -------------------------------------------------------------------------------------

    def attacked(self, what: Attempt, peer: Peer, seconds: float) -> list[str]:
        """Make an attempt, and return its effects, in words; none is good."""
        self.bring(what.state)
        before, alive = self._pids(), {i for _, i in self.viewer.alive}
        phantoms: set[str] = set()
        lines = len(self._lines)
        thread = threading.Thread(target=what.make, args=(peer, self.known, seconds), daemon=True)
        began = time.monotonic()
        thread.start()
        while thread.is_alive():
            self._watch(0.1)
            phantoms |= {i for _, i in self.viewer.alive} - alive
        end = time.monotonic()
        self._watch(AFTER_S)
        effects = [*self._on_the_line(what.state, began, end)]
        stop = self.viewer.latest(RobotState)
        if stop is not None and stop.stop.stopped != (what.state == STOPPED):
            effects.append("stop released" if what.state == STOPPED else "robot stopped")
        if gone := before - self._pids():
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
        if len(self._tape) < 20 * TAPE:
            self._tape.append((time.monotonic(), key, data))
        k, kind = self.known, kind_at(key)
        if kind not in (RobotState, Description, Command, Trajectory, Origin, Log):
            return
        try:
            message = decode(data, kind)
        except MessageError:  # the attacker's
            return
        match message:
            case RobotState():
                k.cycle = [message.cycle.epoch, message.cycle.number]
                k.counter, k.press = message.stop.counter, message.stop.press
                k.state = cbor2.loads(data)
            case Description():
                k.description = cbor2.loads(data)
            case Command() if message.action is not None:
                b = message.ballot
                k.ballot = [b.term, b.utility, b.critical, b.instance]
            case Trajectory():
                k.mission = message.counter, message.mission
            case Origin():
                k.origin = cbor2.loads(data)
            case Log():
                self._lines.append(message.text)
