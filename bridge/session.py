"""What the robot agent knows of a session with a robot, whichever protocol that speaks.

A session is sans-IO: bytes and time in, events and bytes out. Its owner hands in what it read
(`receive`), calls `tick` at `next_wakeup` at the latest, and writes what `outgoing` returns after
each call. It opens itself, and again whenever the link was lost, until `close`. It never keeps a
robot going by itself: an owner that hangs or dies must leave the robot to its watchdog.

`armadico.bridge.p2os.session` is one, `armadico.bridge.ros2.session` another; a kind of robot
(`armadico.bridge.kind`) brings its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.core.messages import Line
from armadico.mobile.geometry import Pose2


class Pose(Struct, frozen=True):
    """Where the robot is in its odometry frame: m, m and rad, theta not wrapped."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0


class Swept(Struct, frozen=True):
    """A laser's newest scan, as its driver gives it; `armadico.mobile.scans` reads it.

    Angles are about the laser's own axis, as it is mounted.
    """

    ranges: NDArray[np.float64]  # m, one a ray; NaN, 0: none; inf: nothing within reach
    first: float  # of the first ray, rad
    step: float  # to the next one, rad; below 0: clockwise
    least: float  # m
    most: float
    number: int  # counts scans
    mount: Pose2  # where the laser sits on the body, and looks: m, m, rad
    upside_down: bool = False
    age_s: float = 0.0  # from the scan to the odometry that it comes with, by the robot's clock


class Reported(Struct, frozen=True, kw_only=True):
    """What a robot says once a cycle; speeds are by its wheels."""

    pose: Pose  # by the odometry, continuous
    v: float  # m/s
    w: float  # rad/s
    battery_v: float = 0.0
    charging: bool = False
    motors: bool = True  # they are on
    stalled: bool = False  # its controller says that something holds a wheel
    stop_button: bool = False
    lifted: bool = False  # a wheel hangs in the air
    front_bumpers: int = 0  # a bit each
    rear_bumpers: int = 0
    echoes: tuple[tuple[int, float], ...] = ()  # sonar, range in m; no echo is the maximum
    sonars: tuple[Pose2, ...] = ()  # where they sit and look: m, m, rad; none: as in the profile
    scan: Swept | None = None  # the newest, for as long as it is new enough


class Connected(Struct, frozen=True):
    """The robot answers; by its controller's names."""

    name: str
    class_name: str
    subclass: str


class Unfit(Struct, frozen=True):
    """The robot answers, and is not of the profile's type; it is not opened."""

    name: str
    class_name: str
    subclass: str


class LinkLost(Struct, frozen=True):
    """An open link ended; the session tries to open it again.

    `reset` says that the controller was: it told so, as when somebody presses its button.
    """

    reason: str
    reset: bool = False


class Unanswered(Struct, frozen=True):
    """The robot did not answer; the session goes on trying."""

    awaited: str
    attempts: int  # since it last answered
    streaming: bool = False  # it sends, so it is not off: it does not hear us
    hint: str = ""  # what to look for, where the session knows more than that


class Noted(Struct, frozen=True):
    """Something that people should know of; said once."""

    text: str


class Differs(Struct, frozen=True):
    """The robot is driven, and what it publishes of itself is not what its profile has."""

    text: str


Event = Connected | Unfit | Reported | LinkLost | Unanswered | Noted | Differs


class Session(Protocol):
    """One client's dealings with one robot.

    Attributes:
        held: Motors that are off stay off when the robot is opened again: a person switched them
            off. Set by the owner; a report of motors that are on clears it.
    """

    held: bool

    @property
    def is_open(self) -> bool:
        """Whether speeds that are asked for reach the robot."""

    @property
    def motors_due(self) -> bool:
        """Whether motors that are off were switched off at the robot, or held off there."""

    @property
    def next_wakeup(self) -> float | None:
        """When `tick` is due at the latest; None once closed."""

    @property
    def line(self) -> Line:
        """What was wrong on the line so far."""

    def receive(self, data: bytes, now: float) -> Sequence[object]:
        """Take in what was read, and return what it means: `Event`s, and others to pass over."""

    def tick(self, now: float) -> Sequence[object]:
        """Let time pass: time-outs and repetitions."""

    def restart(self, now: float) -> Sequence[object]:
        """Begin again: the transport was opened again."""

    def outgoing(self) -> bytes:
        """Hand over, once, what is to be written."""

    def drive(self, v: float, w: float) -> None:
        """Ask for speeds, m/s and rad/s; only the latest before `outgoing` is sent."""

    def stop(self) -> None:
        """Ask for zero speeds, down the ramps."""

    def emergency_stop(self) -> None:
        """Ask for zero speeds at once, by what the controller has for an emergency."""

    def pulse(self) -> None:
        """Feed the robot's watchdog, if it has one that wants that and nothing else does."""

    def close(self) -> None:
        """Stop, and end the session; `restart` begins another."""
