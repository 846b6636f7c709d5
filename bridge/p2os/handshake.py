"""The states of a session with a controller, as a table; `session.Session` executes it.

The numbers of SYNC0, SYNC1 and SYNC2 are also those of PULSE, OPEN and CLOSE. To a controller that
a dead client left open, SYNC0 is a PULSE: it resets the watchdog, and the wheels accelerate again
to the last speeds, which the controller kept. Waiting for status packets first does not help: a
controller whose packets are lost on the way is as silent as a closed one. So the first packets must
be right for every controller. They are CLOSE, with SYNC0 behind it:

- one that was left open closes, motors off, wheels at rest, and takes SYNC0 as SYNC0;
- a closed P2OS receives SYNC2 instead of SYNC0, and waits for SYNC0, which follows;
- MobileSim and AMRISim take the first packet for the SYNC of its number, whichever that is: to
  SYNC2 they answer with their names and are in step, and SYNC0 is a PULSE to them. (After zero
  speeds, 11, they were in step as well, and answered nothing more.)

The table contains three consequences:

- names are an answer to SYNC0, too; zero speeds follow before the motors are on;
- a status packet instead of an echo means that the controller is still open, or that CLOSE and the
  packet crossed: it is closed again, and the handshake starts again. A controller that continues to
  send them does not receive, which is reported;
- a timeout also starts the handshake again: SYNC2's answer may be what was lost, and a controller
  that is in step already takes the next SYNC0 for a PULSE and does not answer.
"""

from __future__ import annotations

from enum import Enum, auto

ECHO_TIMEOUT_S = 1.0  # for the answer to a SYNC, as in ARIA
DRAIN_S = 0.2  # after CLOSE, time for packets that are under way, as in ARIA
LINK_TIMEOUT_S = 1.0  # without a status packet, ten of them: half of the controller's own watchdog
UNFIT_S = 5.0  # period of asking a controller of another type again: it may have been exchanged


class State(Enum):
    """What a session waits for."""

    CLOSED = "nothing"
    DRAIN = "the controller's last packets"
    SYNC0 = "the echo of SYNC0"
    SYNC1 = "the echo of SYNC1"
    SYNC2 = "the robot's names"
    OPEN = "the next status packet"
    UNFIT = "a controller of the profile's type"


class Signal(Enum):
    """What triggers a transition."""

    START = auto()
    ECHO0 = auto()
    ECHO1 = auto()
    NAMES = auto()
    MISFIT = auto()  # names that are not the profile's
    STATUS = auto()
    RESET = auto()  # the controller reports that it restarted
    SILENCE = auto()  # the state's timeout
    PAUSE = auto()  # repeated handshakes without status packets
    CLOSE = auto()


class Action(Enum):
    """What a session does in a transition."""

    FORGET = auto()  # drop what is queued
    ZERO = auto()  # zero speeds
    SEND_SYNC0 = auto()
    SEND_SYNC1 = auto()
    SEND_SYNC2 = auto()
    SEND_CLOSE = auto()
    SET_UP = auto()  # OPEN, motors and sonar on, limits; report the link as open
    LEAVE = auto()  # motors off, CLOSE
    LOSE = auto()  # report the link as lost
    UNANSWERED = auto()  # report that there is no answer
    NOT_RECEIVING = auto()  # report that it sends status packets and does not receive


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
_DISLODGE = (State.DRAIN, (Action.NOT_RECEIVING, *_CLOSE))
_RETRY = (State.DRAIN, (Action.UNANSWERED, *_CLOSE))
_LOST = (State.DRAIN, (Action.LOSE, *_CLOSE))
_LEAVE = (State.CLOSED, (Action.FORGET, Action.ZERO, Action.LEAVE))
_REFUSE = (State.UNFIT, (Action.FORGET, Action.SEND_CLOSE))  # no motors, no speeds
_SYNCS = (State.SYNC0, State.SYNC1, State.SYNC2)
_LIVE = (State.DRAIN, *_SYNCS)

# A signal without a row in a state is ignored there: a late echo, for example.
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
