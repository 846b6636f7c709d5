"""The trace of a run in each cycle, and its smoothness.

Speeds are the robot's true ones, sampled with each status packet; commands are those that the robot
agent obeyed. The measures are finite differences at 10 Hz, so faster changes are not visible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby, pairwise
from math import hypot, sqrt

from msgspec import Struct

from armadico.core.cycles import PERIOD
from armadico.core.messages import Ack, Command, Message
from armadico.core.resources import WHEELS
from armadico.mobile.messages import Truth
from armadico.observe.measures import RunWatch, speeds

REST_M_S, REST_RAD_S = 0.01, 0.02
"""True speeds below which the wheels are at rest: the interface agent's own limits."""

SHORT_S = 0.5
"""A shorter tenure is one that the smooth exchange should avoid."""

STUCK_S, STUCK_M = 60.0, 1.0
"""A robot that has not left a circle of this radius for this time is stuck."""

AFTER = 3
"""Cycles after an exchange in which a step of the acceleration is attributed to it."""


class Tick(Struct, frozen=True):
    """One cycle: time (s), speed (m/s), turn rate (rad/s), and the last command obeyed."""

    t: float
    x: float
    y: float
    v: float
    w: float
    holder: str | None
    command_v: float
    command_w: float


class Smoothness(Struct, frozen=True):
    """Smoothness of the exchanges. None without an exchange.

    Tenures in s; jerk m/s^3 and rad/s^3, rms over the run; the worst step of the acceleration
    within 0.3 s after an exchange, m/s^2; the worst step of the obeyed command at one, m/s, rad/s.
    """

    reign_s: float | None = None
    short_reigns: int = 0
    jerk_v: float | None = None
    jerk_w: float | None = None
    accel_step: float | None = None
    command_step_v: float | None = None
    command_step_w: float | None = None


class Trace:
    """Collects the ticks of one run from every `Truth`, ack and command."""

    kinds: tuple[type[Message], ...] = (Command, Ack, Truth)

    def __init__(self, watch: RunWatch) -> None:
        """`watch` provides begin and end of the run, and the obeyed agent."""
        self.ticks: list[Tick] = []
        self.rests_since: float | None = None
        self._watch = watch
        self._commands: dict[tuple[str, int], tuple[float, float]] = {}
        self._obeyed = (0.0, 0.0)
        self._left: Tick | None = None  # begin of the last circle of STUCK_M

    def update(self, message: Message) -> None:
        """Process one message of the run."""
        if isinstance(message, Truth):
            self._tick(message)
        elif isinstance(message, Command) and message.resource == WHEELS.name:
            key = (message.ballot.instance, message.cycle.number)
            self._commands[key] = speeds(message)
        elif isinstance(message, Ack) and message.resource == WHEELS.name:
            self._acked(message)

    def _acked(self, ack: Ack) -> None:
        if ack.obeyed is not None and ack.obeyed_cycle is not None:
            key = (ack.obeyed.instance, ack.obeyed_cycle.number)
            self._obeyed = self._commands.get(key, self._obeyed)
            old = ack.cycle.number - 20
            self._commands = {at: c for at, c in self._commands.items() if at[1] >= old}

    def _tick(self, truth: Truth) -> None:
        if not self._watch.mission or self._watch.done:
            return
        at = (truth.t, truth.x, truth.y, truth.v, truth.w)
        tick = Tick(*at, self._watch.holder, *self._obeyed)
        self.ticks.append(tick)
        left = self._left
        if left is None or hypot(tick.x - left.x, tick.y - left.y) > STUCK_M:
            self._left = tick
        if abs(truth.v) > REST_M_S or abs(truth.w) > REST_RAD_S:
            self.rests_since = None
        elif self.rests_since is None:
            self.rests_since = truth.t

    @property
    def resting_s(self) -> float:
        """Time at rest, s."""
        if self.rests_since is None or not self.ticks:
            return 0.0
        return self.ticks[-1].t - self.rests_since

    @property
    def stuck(self) -> bool:
        """Whether the robot makes no more progress."""
        return self._left is not None and self.ticks[-1].t - self._left.t > STUCK_S


def smoothness(ticks: Sequence[Tick]) -> Smoothness:
    """The measures of a run."""
    tenures = [length for _, length in reigns_of(ticks)]
    changes = exchanges_of(ticks)
    accel = [(b.v - a.v) / PERIOD for a, b in pairwise(ticks)]  # accel[i] is up to tick i + 1
    near = {i + k for i in changes for k in range(AFTER)}
    return Smoothness(
        reign_s=_rounded(sum(tenures) / len(tenures)) if tenures else None,
        short_reigns=sum(length < SHORT_S for length in tenures),
        jerk_v=_jerk(ticks, lambda tick: tick.v),
        jerk_w=_jerk(ticks, lambda tick: tick.w),
        accel_step=_worst(abs(accel[i] - accel[i - 1]) for i in sorted(near) if 0 < i < len(accel)),
        command_step_v=_worst(abs(ticks[i].command_v - ticks[i - 1].command_v) for i in changes),
        command_step_w=_worst(abs(ticks[i].command_w - ticks[i - 1].command_w) for i in changes),
    )


def reigns_of(ticks: Sequence[Tick]) -> list[tuple[str, float]]:
    """The successive holders of the wheels, and their times, s."""
    held = [tick.holder for tick in ticks if tick.holder is not None]
    return [(name, PERIOD * len(list(tenure))) for name, tenure in groupby(held)]


def exchanges_of(ticks: Sequence[Tick]) -> list[int]:
    """The ticks in which another agent was obeyed than in the tick before."""
    return [
        i
        for i, (a, b) in enumerate(pairwise(ticks), start=1)
        if a.holder and b.holder and a.holder != b.holder
    ]


def _jerk(ticks: Sequence[Tick], speed: Callable[[Tick], float]) -> float | None:
    speeds = [speed(tick) for tick in ticks]
    jerks = [
        (speeds[i + 1] - 2.0 * speeds[i] + speeds[i - 1]) / PERIOD**2
        for i in range(1, len(speeds) - 1)
    ]
    return _rounded(sqrt(sum(j * j for j in jerks) / len(jerks))) if jerks else None


def _worst(steps: Iterable[float]) -> float | None:
    worst = max(steps, default=None)
    return None if worst is None else _rounded(worst)


def _rounded(value: float) -> float:
    return round(value, 4)
