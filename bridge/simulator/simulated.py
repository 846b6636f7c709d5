"""A simulated robot: the plant and its controller behind one port.

Bytes and the time in, bytes out, and the true state for watchers. The same object is used behind a
TCP port or pty in real time (`server`) and behind a port of the virtual mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite
from typing import Final

from armadico.bridge.simulator.arena import Arena
from armadico.bridge.simulator.plant import Plant
from armadico.mobile.messages import Truth

UNNAMED: Final = "simulator"
"""The id of a simulated robot without one: a truth without an id is nobody's."""


class Controller:
    """The robot's protocol and control; each kind of robot has a subclass.

    Nothing happens between two steps of the plant; replies, too, wait for `advance`.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._now = 0  # in steps of the plant
        self._out = bytearray()  # for the client

    @property
    def is_open(self) -> bool:
        """Whether a client has requested data."""
        raise NotImplementedError

    @property
    def hangs_up(self) -> bool:
        """Whether to disconnect the client, where possible."""
        return False

    @property
    def time_s(self) -> float:
        """Simulation time reached, s."""
        return self._now * self._plant.step_s

    @property
    def next_status_s(self) -> float:
        """Simulation time of the next periodic message, s; infinite: none."""
        return self._next_report() * self._plant.step_s if self.is_open else inf

    def receive(self, data: bytes) -> None:
        """Process the client's bytes, at the time reached."""
        raise NotImplementedError

    def advance(self, now_s: float) -> bytes:
        """Advance to a simulation time. Returns the bytes for the client."""
        until = int(now_s / self._plant.step_s + 1e-6)
        while self._now < until:
            stop = self._next_event(until)
            self._move(stop - self._now)
            self._now = stop
            self._report()
        data = bytes(self._out)
        self._out.clear()
        return data

    def go_on(self, v: float, w: float) -> None:
        """Obey from now on, as if these speeds had been commanded (m/s, rad/s).

        By default nothing: a controller without it brakes at once.
        """

    def disconnect(self) -> None:
        """Forget the client, which is gone or a new one."""
        raise NotImplementedError

    def _next_report(self) -> int:
        """The step of the next periodic message, while it is open."""
        raise NotImplementedError

    def _next_event(self, until: int) -> int:
        """The step until which there is only motion, at most `until`."""
        return min(until, self._next_report()) if self.is_open else until

    def _move(self, steps: int) -> None:
        """Move the plant by some steps."""
        raise NotImplementedError

    def _report(self) -> None:
        """Send what is due at the time reached."""
        raise NotImplementedError


class SimulatedRobot:
    """The robot behind its port."""

    def __init__(self, plant: Plant, controller: Controller, name: str, cycle_s: float) -> None:
        """`name` is the controller's.

        It is the id in the published truth, too, unless `simulator` is set: a run sets it to an id
        that no driver chooses.
        """
        self.plant = plant
        self.controller = controller
        self._watchers: list[Callable[[Truth], None]] = []
        self.name, self._cycle = name, cycle_s
        self.simulator = name or UNNAMED
        self._answering = False
        self._truth_at = 0.0
        self._outgoing = bytearray()  # for the client
        self.bring_forward: Callable[[float], None] = self.live
        """Advances time: of this robot alone, or of all robots of its world."""

    def watch(self, watcher: Callable[[Truth], None]) -> None:
        """Call `watcher` with the truth at every cycle."""
        self._watchers.append(watcher)

    def receive(self, data: bytes, now: float) -> None:
        """Process the client's bytes at a time, s of simulation."""
        self._answering = True
        if now > self.controller.time_s:
            self.bring_forward(now)
        self.controller.receive(data)

    def live(self, now: float) -> None:
        """Advance this robot alone to a time, s of simulation."""
        self._outgoing += self.controller.advance(now)

    def advance(self, now: float) -> bytes:
        """Advance to a time, s of simulation. Returns the bytes for the client."""
        self.bring_forward(now)
        data = bytes(self._outgoing)
        self._outgoing.clear()
        self._answering = False
        if now + 1e-9 >= self._truth_at:
            self._truth_at += self._cycle
            self._publish_truth()
        return data

    @property
    def due(self) -> float:
        """Time of its next message, s of simulation."""
        if self._answering:
            return self.controller.time_s + self.plant.step_s
        if not self.controller.is_open:
            return self._truth_at
        return self.controller.next_status_s

    def set_speeds(self, v: float, w: float) -> None:
        """Let it move so fast, as by a command, until another one comes: m/s, rad/s."""
        self.plant.set_speeds(v, w)
        self.controller.go_on(v, w)

    def meet(self, *others: SimulatedRobot) -> None:
        """Join others in one world. Raises ValueError if one overlaps an obstacle."""
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
            simulator=self.simulator,
            bumped=plant.touches.bumps,
            charge=plant.battery.charge,
            used=plant.battery.used_j,
        )

    def _publish_truth(self) -> None:
        if self._watchers:
            truth = self.truth()
            for watcher in self._watchers:
                watcher(truth)
