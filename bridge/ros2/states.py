"""The states of a session with a ROS 2 robot, as a table for `session.Session`."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, auto
from typing import Final


class State(Enum):
    """What a session waits for."""

    CLOSED = "nothing"
    WAITING = "odometry"
    LOST = "odometry that goes on for a whole cycle"
    DRIVING = "the next cycle"


class Signal(Enum):
    """What changes the state of a session."""

    START = auto()  # the transport was opened
    FIRST = auto()  # the first odometry since the session began to wait
    CYCLE = auto()  # a later odometry that makes a cycle
    SILENCE = auto()  # no cycle until the deadline
    BROKEN = auto()  # the odometry is that of several robots, or jumps repeatedly
    CLOSE = auto()


class Step(Enum):
    """What a session does on a change of state."""

    BEGIN = auto()  # publish `Wants` and zero speeds; discard what was received
    CONNECT = auto()  # report the link as open
    LOSE = auto()  # report the link as lost
    ASK = auto()  # publish `Wants` again, and report that nothing answers
    STOP = auto()  # zero speeds, without ramps


_BEGIN: Final = (State.WAITING, (Step.BEGIN,))
_OPEN: Final = (State.DRIVING, (Step.CONNECT,))
_LOSE: Final = (State.LOST, (Step.BEGIN, Step.LOSE))
_CLOSE: Final = (State.CLOSED, (Step.STOP,))

TRANSITIONS: Final[Mapping[tuple[State, Signal], tuple[State, tuple[Step, ...]]]] = {
    (State.CLOSED, Signal.START): _BEGIN,
    (State.WAITING, Signal.START): _BEGIN,
    (State.WAITING, Signal.FIRST): _OPEN,
    (State.WAITING, Signal.CYCLE): _OPEN,
    (State.WAITING, Signal.SILENCE): (State.WAITING, (Step.ASK,)),
    (State.WAITING, Signal.CLOSE): _CLOSE,
    # After a loss the first odometry does not open the link. Otherwise a robot whose odometry
    # stands still, or runs backwards in time, would cause a cycle and a command each time.
    (State.LOST, Signal.START): (State.LOST, (Step.BEGIN,)),
    (State.LOST, Signal.CYCLE): _OPEN,
    (State.LOST, Signal.SILENCE): (State.LOST, (Step.ASK,)),
    (State.LOST, Signal.CLOSE): _CLOSE,
    (State.DRIVING, Signal.START): (State.WAITING, (Step.LOSE, Step.BEGIN)),
    (State.DRIVING, Signal.SILENCE): _LOSE,
    (State.DRIVING, Signal.BROKEN): _LOSE,
    (State.DRIVING, Signal.CLOSE): _CLOSE,
}
"""Every change of state. A signal without an entry for a state changes nothing."""
