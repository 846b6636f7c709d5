"""The states of a session with a controller, as a table; `session.Session` walks it.

The numbers of SYNC0, SYNC1 and SYNC2 are also those of PULSE, OPEN and CLOSE. So to a controller
that a dead client left open, SYNC0 is a PULSE: the watchdog resets and the wheels run up again to
the speeds last asked for, which the controller kept. Two things follow, and the table has both:

- every beginning sends zero speeds before SYNC0;
- a status packet where an echo was due means that the controller is still open: it is closed, and
  the handshake starts again. So does silence, since SYNC2's answer may be what was lost, and
  a controller that is in step already takes the next SYNC0 for a PULSE and does not answer.
"""

from __future__ import annotations

from enum import Enum, auto

ECHO_TIMEOUT_S = 1.0  # for the answer to a SYNC, as ARIA waits
DRAIN_S = 0.2  # after CLOSE, what was under way is let past, as ARIA does
LINK_TIMEOUT_S = 1.0  # without a status packet, ten of them: half of the controller's own watchdog


class State(Enum):
    """Where a session stands: what it waits for."""

    CLOSED = "nothing"
    DRAIN = "what the controller still had to say"
    SYNC0 = "the echo of SYNC0"
    SYNC1 = "the echo of SYNC1"
    SYNC2 = "the robot's names"
    OPEN = "the next status packet"


class Signal(Enum):
    """What makes a session go on."""

    START = auto()
    ECHO0 = auto()
    ECHO1 = auto()
    NAMES = auto()
    STATUS = auto()
    RESET = auto()  # the controller reports that it restarted
    SILENCE = auto()  # the state's time-out
    CLOSE = auto()


class Action(Enum):
    """What a session does on its way."""

    ZERO = auto()  # forget what is queued; zero speeds
    SEND_SYNC0 = auto()
    SEND_SYNC1 = auto()
    SEND_SYNC2 = auto()
    SEND_CLOSE = auto()
    SET_UP = auto()  # OPEN, motors and sonar on, limits; report the link as open
    LEAVE = auto()  # motors off, CLOSE
    LOSE = auto()  # report the link as lost
    UNANSWERED = auto()  # report that nothing answers


TIMEOUTS_S = {
    State.DRAIN: DRAIN_S,
    State.SYNC0: ECHO_TIMEOUT_S,
    State.SYNC1: ECHO_TIMEOUT_S,
    State.SYNC2: ECHO_TIMEOUT_S,
    State.OPEN: LINK_TIMEOUT_S,
}

_BEGIN = (State.SYNC0, (Action.ZERO, Action.SEND_SYNC0))
_DISLODGE = (State.DRAIN, (Action.ZERO, Action.SEND_CLOSE))
_RETRY = (State.DRAIN, (Action.UNANSWERED, *_DISLODGE[1]))
_LOST = (State.DRAIN, (Action.LOSE, Action.ZERO, Action.SEND_CLOSE))
_SYNCS = (State.SYNC0, State.SYNC1, State.SYNC2)
_LIVE = (State.DRAIN, *_SYNCS)

# A signal that has no row in a state is none of its business: a late echo, say.
TRANSITIONS: dict[tuple[State, Signal], tuple[State, tuple[Action, ...]]] = {
    (State.CLOSED, Signal.START): _BEGIN,
    (State.DRAIN, Signal.SILENCE): _BEGIN,
    (State.SYNC0, Signal.ECHO0): (State.SYNC1, (Action.SEND_SYNC1,)),
    (State.SYNC1, Signal.ECHO1): (State.SYNC2, (Action.SEND_SYNC2,)),
    (State.SYNC2, Signal.NAMES): (State.OPEN, (Action.SET_UP,)),
    **{(state, Signal.STATUS): _DISLODGE for state in _SYNCS},
    **{(state, Signal.SILENCE): _RETRY for state in _SYNCS},
    **{(state, Signal.START): _BEGIN for state in _LIVE},
    **{(state, Signal.CLOSE): (State.CLOSED, (Action.ZERO, Action.LEAVE)) for state in _LIVE},
    (State.OPEN, Signal.SILENCE): _LOST,
    (State.OPEN, Signal.RESET): _LOST,
    (State.OPEN, Signal.START): (State.SYNC0, (Action.LOSE, *_BEGIN[1])),
    (State.OPEN, Signal.CLOSE): (State.CLOSED, (Action.ZERO, Action.LEAVE)),
}
