"""A simulated robot, whole: the plant and its controller behind one port.

Bytes and the time in, bytes out, and the truth for those who watch: the same object stands behind a
TCP port or pty in real time (`server`) and behind a port of the virtual mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite

from armadico.bridge.simulator.arena import Arena
from armadico.bridge.simulator.plant import Plant
from armadico.mobile.messages import Truth


class Controller:
    """What speaks for the robot, in its protocol, and drives it; a kind of robot derives its own.

    Nothing happens between two steps of the plant; answers, too, wait for `advance`.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._now = 0  # in steps of the plant
        self._out = bytearray()  # for the client

    @property
    def is_open(self) -> bool:
        """Whether a client has it send."""
        raise NotImplementedError

    @property
    def hangs_up(self) -> bool:
        """Whether a connection that can be ended is to be."""
        return False

    @property
    def time_s(self) -> float:
        """Simulation time reached, s."""
        return self._now * self._plant.step_s

    @property
    def next_status_s(self) -> float:
        """Simulation time at which it next sends of its own accord, s; infinite: it does not."""
        return self._next_report() * self._plant.step_s if self.is_open else inf

    def receive(self, data: bytes) -> None:
        """Take in what the client wrote, at the time reached."""
        raise NotImplementedError

    def advance(self, now_s: float) -> bytes:
        """Let the simulation run on to a time, and return what is to be sent to the client."""
        until = int(now_s / self._plant.step_s + 1e-6)
        while self._now < until:
            stop = self._next_event(until)
            self._move(stop - self._now)
            self._now = stop
            self._report()
        data = bytes(self._out)
        self._out.clear()
        return data

    def disconnect(self) -> None:
        """The client is gone, or is a new one."""
        raise NotImplementedError

    def _next_report(self) -> int:
        """The step in which it next sends of its own accord, while it is open."""
        raise NotImplementedError

    def _next_event(self, until: int) -> int:
        """The step up to which nothing but motion happens, `until` at the latest."""
        return min(until, self._next_report()) if self.is_open else until

    def _move(self, steps: int) -> None:
        """Have the plant move for so many steps."""
        raise NotImplementedError

    def _report(self) -> None:
        """Send what is due at the time reached."""
        raise NotImplementedError


class SimulatedRobot:
    """The robot as its port shows it."""

    def __init__(self, plant: Plant, controller: Controller, name: str, cycle_s: float) -> None:
        """`name` is what its controller calls itself, and who watches knows it by."""
        self.plant = plant
        self.controller = controller
        self._watchers: list[Callable[[Truth], None]] = []
        self._name, self._cycle = name, cycle_s
        self._answering = False
        self._truth_at = 0.0
        self._said = bytearray()  # for the client
        self.bring_forward: Callable[[float], None] = self.live
        """What lets time pass: for this robot alone, or for all that are in one world with it."""

    def watch(self, watcher: Callable[[Truth], None]) -> None:
        """Call `watcher` with the truth at every cycle."""
        self._watchers.append(watcher)

    def receive(self, data: bytes, now: float) -> None:
        """Take the client's bytes at a time, s of simulation."""
        self._answering = True
        if now > self.controller.time_s:
            self.bring_forward(now)
        self.controller.receive(data)

    def live(self, now: float) -> None:
        """Live up to a time, s of simulation, whoever else is in its world."""
        self._said += self.controller.advance(now)

    def advance(self, now: float) -> bytes:
        """Live up to a time, s of simulation; the bytes for the client."""
        self.bring_forward(now)
        data = bytes(self._said)
        self._said.clear()
        self._answering = False
        if now + 1e-9 >= self._truth_at:
            self._truth_at += self._cycle
            self._tell()
        return data

    @property
    def due(self) -> float:
        """When it next has something to send, s of simulation."""
        if self._answering:
            return self.controller.time_s + self.plant.step_s
        if not self.controller.is_open:
            return self._truth_at
        return self.controller.next_status_s

    def meet(self, *others: SimulatedRobot) -> None:
        """Live in one world with others. Raises ValueError if one stands in something."""
        Arena((self, *others))

    def truth(self) -> Truth:
        """True pose, speeds and clearance, which no agent can measure."""
        plant = self.plant
        x, y, theta = plant.pose
        v, w = plant.speeds
        clearance = plant.clearance()
        return Truth(
            t=round(self.controller.time_s, 6),
            x=x,
            y=y,
            theta=theta,
            v=v,
            w=w,
            collisions=plant.touches.collisions + plant.touches.bumps,
            clearance=clearance if isfinite(clearance) else None,
            simulator=self._name,
            bumped=plant.touches.bumps,
            charge=plant.battery.charge,
            used=plant.battery.used_j,
        )

    def _tell(self) -> None:
        if self._watchers:
            truth = self.truth()
            for watcher in self._watchers:
                watcher(truth)
