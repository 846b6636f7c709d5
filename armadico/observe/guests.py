"""What the programs beside a society do: a person's commands, observers, the simulator."""

from __future__ import annotations

from typing import ClassVar

from armadico.core.guest import Guest
from armadico.core.messages import Message
from armadico.mobile.messages import Truth


class Person(Guest):
    """A named user's commands: they observe, order, tune, drive, stop and release."""

    reads = True
    commands = True


class Viewer(Guest):
    """Programs that observe only: recorders, dashboards."""

    reads = True


class Simulator(Guest):
    """A simulator publishes the robot's true state, and notices others."""

    provides: ClassVar[tuple[type[Message], ...]] = (Truth,)
    receives: ClassVar[tuple[type[Message], ...]] = (Truth,)
