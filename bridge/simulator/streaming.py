"""A base for simulated controllers that stream frames and obey speeds: `bridge.streaming`'s robot.

A subclass has the protocol alone: `obey` takes the commands out of the bytes that have arrived, and
`frame` makes the bytes that are sent each period. Such a robot stops by its watchdog, or drives on
without one.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf

from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.robots import Stage
from armadico.bridge.simulator.simulated import Controller, SimulatedRobot
from armadico.config.profile import IdentifiedRobot, ModelledRobot

BUMPED_S = 0.1
"""How long the bumper stays pressed."""


class StreamingController(Controller):
    """The controller behind the line."""

    def __init__(self, plant: Plant, frame_s: float, watchdog_s: float | None) -> None:
        """Send a frame each `frame_s`; stop `watchdog_s` after the last command; None: never."""
        super().__init__(plant)
        self.plant = plant  # the simulated base
        self.streams = False  # whether it sends frames now
        self._frame = round(frame_s / plant.step_s)  # this and all times in steps of the plant
        self._next = 0
        self._patience = inf if watchdog_s is None else round(watchdog_s / plant.step_s)
        self._trips: float = inf
        self._speeds = (0.0, 0.0)
        self._in = bytearray()

    # What a subclass has --------------------------------------------------------------------------

    def obey(self, received: bytearray) -> bool:
        """Take the next command from the front and obey it; False: it is not complete yet."""
        raise NotImplementedError

    def frame(self) -> bytes:
        """Return the frame that is due."""
        raise NotImplementedError

    # What a subclass uses -------------------------------------------------------------------------

    def drive(self, v: float, w: float) -> None:
        """Set the speeds, m/s and rad/s, and feed the watchdog."""
        self._speeds, self._trips = (v, w), self._now + self._patience

    def stream(self, wanted: bool) -> None:
        """Begin or end sending frames."""
        if wanted and not self.streams:
            self._next = self._now + self._frame
        self.streams = wanted

    @property
    def bumped(self) -> bool:
        """Whether something in front presses the bumper."""
        return self.time_s - self.plant.touches.pressed_s <= BUMPED_S

    # The controller -------------------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        return self.streams

    def receive(self, data: bytes) -> None:
        self._in += data
        while self._in and self.obey(self._in):
            pass

    def go_on(self, v: float, w: float) -> None:
        self.drive(v, w)

    def disconnect(self) -> None:
        """Forget what has arrived; a serial line does not tell that a client has left."""
        self._in.clear()

    def _next_report(self) -> int:
        return self._next

    def _next_event(self, until: int) -> int:
        until = super()._next_event(until)
        return int(self._trips) if self._now < self._trips < until else until

    def _move(self, steps: int) -> None:
        if self._trips <= self._now:
            self._speeds, self._trips = (0.0, 0.0), inf
        speeds = self._speeds
        self.plant.run(steps, lambda _v, _w: speeds)

    def _report(self) -> None:
        if self.streams and self._now >= self._next:
            self._next += self._frame
            self._out += self.frame()


def simulated_robot(
    profile: IdentifiedRobot | ModelledRobot,
    stage: Stage,
    controller: Callable[[Plant], Controller],
    plant: type[Plant] = Plant,
) -> SimulatedRobot:
    """The robot on a stage: a plant, and the controller made for it."""
    made = plant(profile, stage.sensors, stage.site, stage.streams)
    return SimulatedRobot(made, controller(made), stage.name or profile.name, profile.cycle_s)
