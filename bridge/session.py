"""The interface of a session with a robot, for any protocol.

A session is sans-IO: bytes and time in, events and bytes out. Its owner passes the bytes it read to
`receive`, calls `tick` at `next_wakeup` at the latest, and writes what `outgoing` returns after
each call. The session opens the link, and opens it again whenever it was lost, until `close`. It
never keeps a robot moving by itself: if its owner hangs or dies, the robot's watchdog must stop it.

`armadico.bridge.p2os.session` and `armadico.bridge.ros2.session` are sessions; a kind of robot
(`armadico.bridge.kind`) may have its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.core.messages import Line
from armadico.mobile.geometry import STOOD, Pose2


class Pose(Struct, frozen=True):
    """A pose in the odometry frame: m, m and rad, theta not wrapped."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0


class Swept(Struct, frozen=True):
    """A laser's newest scan, as from its driver; `armadico.mobile.scans` converts it.

    Angles are about the laser's own axis, as it is mounted.
    """

    ranges: NDArray[np.float64]  # m, one per ray; NaN, 0: invalid; inf: nothing within reach
    first: float  # angle of the first ray, rad
    step: float  # angle to the next one, rad; negative: clockwise
    least: float  # m
    most: float
    number: int  # counts scans
    mount: Pose2  # of the laser on the body: m, m, rad
    upside_down: bool = False
    since: Pose2 = STOOD  # the body's pose at the scan, in its frame at the odometry with it


class Reported(Struct, frozen=True, kw_only=True):
    """A robot's report of one cycle; speeds are by its wheels."""

    pose: Pose  # by the odometry, continuous
    v: float  # m/s
    w: float  # rad/s
    battery_v: float = 0.0
    charging: bool = False
    motors: bool = True  # they are on
    stalled: bool = False  # its controller reports a held wheel
    stop_button: bool = False
    lifted: bool = False  # a wheel hangs in the air
    front_bumpers: int = 0  # one bit each
    rear_bumpers: int = 0
    echoes: tuple[tuple[int, float], ...] = ()  # sonar, range in m; no echo is the maximum
    sonars: tuple[Pose2, ...] = ()  # their mounts: m, m, rad; empty: as in the profile
    scan: Swept | None = None  # the newest, while it is fresh
    doubt: str = ""  # for people: what is wrong with these data, while it is so


class Connected(Struct, frozen=True):
    """The robot answers; with its controller's names."""

    name: str
    class_name: str
    subclass: str


class Unfit(Struct, frozen=True):
    """The robot answers, but the profile does not match it; it is not opened."""

    name: str
    class_name: str
    subclass: str


class LinkLost(Struct, frozen=True):
    """An open link ended; the session tries to open it again.

    `reset` means that the controller reported a reset, as when its button was pressed.
    """

    reason: str
    reset: bool = False


class Unanswered(Struct, frozen=True):
    """The robot did not answer; the session continues to try."""

    awaited: str
    attempts: int  # since it last answered
    streaming: bool = False  # it sends, so it is on but does not receive
    hint: str = ""  # what to check, if the session knows more


class Noted(Struct, frozen=True):
    """A notice for the operator; reported once."""

    text: str


class Differs(Struct, frozen=True):
    """The robot is driven although its reported properties differ from the profile's."""

    text: str


class Unread(Struct, frozen=True):
    """The robot does not read the commands as they are sent; empty: it does again."""

    text: str


Event = Connected | Unfit | Reported | LinkLost | Unanswered | Noted | Differs | Unread


class Session(Protocol):
    """One client's session with one robot.

    Attributes:
        held: Motors that are off stay off when the robot is opened again: a person switched them
            off. Set by the owner; a report of motors that are on clears it.
    """

    held: bool

    @property
    def is_open(self) -> bool:
        """Whether requested speeds reach the robot."""

    @property
    def motors_due(self) -> bool:
        """Whether motors that are off were switched off at the robot, or held off there."""

    @property
    def next_wakeup(self) -> float | None:
        """When `tick` is due at the latest; None once closed."""

    @property
    def line(self) -> Line:
        """Counts of invalid data on the line so far."""

    def receive(self, data: bytes, now: float) -> Sequence[object]:
        """Decode bytes into events: `Event`s, and others that the owner ignores."""

    def tick(self, now: float) -> Sequence[object]:
        """Let time pass: timeouts and repetitions."""

    def restart(self, now: float) -> Sequence[object]:
        """Begin again: the transport was opened again."""

    def outgoing(self) -> bytes:
        """The bytes to write, returned once."""

    def drive(self, v: float, w: float) -> None:
        """Request speeds, m/s and rad/s; only the latest before `outgoing` is sent."""

    def stop(self) -> None:
        """Request zero speeds, down the ramps."""

    def emergency_stop(self) -> None:
        """Request zero speeds at once, by the controller's emergency stop."""

    def pulse(self) -> None:
        """Feed the robot's watchdog, if it needs that and nothing else is sent."""

    def close(self) -> None:
        """Stop, and end the session; `restart` begins another."""


@runtime_checkable
class Brakes(Protocol):
    """A session whose robot a guard can brake without it (`armadico.runtime.guard`).

    A session without these methods works as well. Its robot is braked by its watchdog only.
    """

    def brakes(self) -> tuple[bytes, ...]:
        """What brakes the robot from the speeds last sent, down its ramps: one each `STEP_S`.

        The last one keeps it at rest. Empty while the robot does not obey.
        """

    def braked(self) -> None:
        """One of these was sent, by the guard: the next speeds begin there."""
