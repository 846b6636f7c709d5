"""The states of a session with a controller, as a table; `session.Session` walks it.

The numbers of SYNC0, SYNC1 and SYNC2 are also those of PULSE, OPEN and CLOSE. So to a controller
that a dead client left open, SYNC0 is a PULSE: the watchdog resets and the wheels run up again to
the speeds last asked for, which the controller kept. Listening first does not help: one whose
status packets are lost on the way is as silent as one that is closed. So what is sent first must be
right for every controller, and is one packet, CLOSE, with SYNC0 behind it:

- one that was left open closes, motors off, wheels at rest, and SYNC0 is SYNC0 to it;
- a closed P2OS reads SYNC2 where SYNC0 is due, and waits for SYNC0, which follows;
- MobileSim and AMRISim take the first packet for the SYNC of its number, whatever that is: for
  SYNC2 they send their names and are in step, and SYNC0 is a PULSE to them. (After zero speeds, 11,
  they were in step as well, and answered nothing more.)

Three things follow, and the table has them:

- names are an answer to SYNC0, too; zero speeds follow before the motors are on;
- a status packet where an echo was due means that the controller is still open, or that CLOSE and
  the packet crossed: it is closed again, and the handshake starts again. A controller that goes on
  like that does not receive what we send, and that is reported;
- silence starts the handshake again, too: SYNC2's answer may be what was lost, and a controller
  that is in step already takes the next SYNC0 for a PULSE and does not answer.
"""

from __future__ import annotations

from enum import Enum, auto

ECHO_TIMEOUT_S = 1.0  # for the answer to a SYNC, as ARIA waits
DRAIN_S = 0.2  # after CLOSE, what was under way is let past, as ARIA does
LINK_TIMEOUT_S = 1.0  # without a status packet, ten of them: half of the controller's own watchdog
UNFIT_S = 5.0  # until a controller of another type is asked again: it may have been exchanged


class State(Enum):
    """Where a session stands: what it waits for."""

    CLOSED = "nothing"
    DRAIN = "what the controller still had to say"
    SYNC0 = "the echo of SYNC0"
    SYNC1 = "the echo of SYNC1"
    SYNC2 = "the robot's names"
    OPEN = "the next status packet"
    UNFIT = "a controller of the profile's type"


class Signal(Enum):
    """What makes a session go on."""

    START = auto()
    ECHO0 = auto()
    ECHO1 = auto()
    NAMES = auto()
    MISFIT = auto()  # names that are not the profile's
    STATUS = auto()
    RESET = auto()  # the controller reports that it restarted
    SILENCE = auto()  # the state's time-out
    PAUSE = auto()  # nothing follows the handshake, again and again
    CLOSE = auto()


class Action(Enum):
    """What a session does on its way."""

    FORGET = auto()  # what is queued
    ZERO = auto()  # zero speeds
    SEND_SYNC0 = auto()
    SEND_SYNC1 = auto()
    SEND_SYNC2 = auto()
    SEND_CLOSE = auto()
    SET_UP = auto()  # OPEN, motors and sonar on, limits; report the link as open
    LEAVE = auto()  # motors off, CLOSE
    LOSE = auto()  # report the link as lost
    UNANSWERED = auto()  # report that nothing answers
    UNHEARD = auto()  # report that it sends status packets and does not receive


TIMEOUTS_S = {
    State.DRAIN: DRAIN_S,
    State.SYNC0: ECHO_TIMEOUT_S,
    State.SYNC1: ECHO_TIMEOUT_S,
    State.SYNC2: ECHO_TIMEOUT_S,
    State.OPEN: LINK_TIMEOUT_S,
    State.UNFIT: UNFIT_S,
}

_BEGIN = (State.SYNC0, (Action.FORGET, Action.SEND_CLOSE, Action.SEND_SYNC0))
_CLOSE = (Action.FORGET, Action.ZERO, Action.SEND_CLOSE)
_DISLODGE = (State.DRAIN, (Action.UNHEARD, *_CLOSE))
_RETRY = (State.DRAIN, (Action.UNANSWERED, *_CLOSE))
_LOST = (State.DRAIN, (Action.LOSE, *_CLOSE))
_LEAVE = (State.CLOSED, (Action.FORGET, Action.ZERO, Action.LEAVE))
_REFUSE = (State.UNFIT, (Action.FORGET, Action.SEND_CLOSE))  # no motors, no speeds
_SYNCS = (State.SYNC0, State.SYNC1, State.SYNC2)
_LIVE = (State.DRAIN, *_SYNCS)

# A signal that has no row in a state is none of its business: a late echo, say.
TRANSITIONS: dict[tuple[State, Signal], tuple[State, tuple[Action, ...]]] = {
    (State.CLOSED, Signal.START): _BEGIN,
    (State.DRAIN, Signal.SILENCE): _BEGIN,
    (State.SYNC0, Signal.ECHO0): (State.SYNC1, (Action.SEND_SYNC1,)),
    (State.SYNC1, Signal.ECHO1): (State.SYNC2, (Action.SEND_SYNC2,)),
    (State.SYNC0, Signal.NAMES): (State.OPEN, (Action.SET_UP,)),
    (State.SYNC2, Signal.NAMES): (State.OPEN, (Action.SET_UP,)),
    (State.SYNC0, Signal.MISFIT): _REFUSE,
    (State.SYNC2, Signal.MISFIT): _REFUSE,
    (State.UNFIT, Signal.SILENCE): _BEGIN,
    (State.UNFIT, Signal.START): _BEGIN,
    (State.UNFIT, Signal.CLOSE): (State.CLOSED, (Action.FORGET, Action.SEND_CLOSE)),
    (State.SYNC0, Signal.PAUSE): (State.DRAIN, (Action.FORGET,)),
    **{(state, Signal.STATUS): _DISLODGE for state in _SYNCS},
    **{(state, Signal.SILENCE): _RETRY for state in _SYNCS},
    **{(state, Signal.START): _BEGIN for state in _LIVE},
    **{(state, Signal.CLOSE): _LEAVE for state in (*_LIVE, State.OPEN)},
    (State.OPEN, Signal.SILENCE): _LOST,
    (State.OPEN, Signal.RESET): _LOST,
    (State.OPEN, Signal.START): (State.SYNC0, (Action.LOSE, *_BEGIN[1])),
}
