"""What the checker of promises is shown, in the order of time.

All of it can be seen from outside the processes: what is published on the mesh, what the robot
agent writes to the controller, and what whoever makes the faults knows. Those after `Passed` are
optional, since only the virtual mesh shows all of them in every cycle. `at` is always in seconds,
by one clock of whoever watches.
"""

from __future__ import annotations

from math import inf

from msgspec import Struct

from armadico.core.messages import Ballot, BidRecord, Cycle, Message
from armadico.core.resources import WHEELS


class Observation(Struct, frozen=True):
    """One thing, and when it was seen."""

    at: float


class Said(Observation, frozen=True):
    """A message of the robot agent, a contender, a person or the simulator."""

    message: Message


def of_the_wheels(message: Message) -> bool:
    """Whether a message is not about another resource: what is promised is promised of these."""
    return getattr(message, "resource", WHEELS.name) == WHEELS.name


class Ordered(Observation, frozen=True):
    """Speeds that the robot agent wrote to the controller, m/s and rad/s."""

    v: float
    w: float


class Faulted(Observation, frozen=True):
    """A fault begins or ends; `kind` is one of `kinds.KINDS`, `whom` names agents.

    `to` is whom messages go to, for faults of the network; `amount` is the kind's own number
    (`plan.DRAWS`): unknown it is the worst.
    """

    kind: str
    whom: tuple[str, ...]
    began: bool
    to: tuple[str, ...] = ()
    amount: float = inf


class Passed(Observation, frozen=True):
    """Nothing but time: to be shown at the end, and wherever nothing is seen for long."""


class Obeyed(Observation, frozen=True):
    """The robot agent obeys a command. Without it the `Ack` has to do."""

    ballot: Ballot
    cycle: Cycle


class Refused(Observation, frozen=True):
    """The robot agent refuses a command; `why` is the verdict's name."""

    ballot: Ballot
    why: str


class Missed(Observation, frozen=True):
    """An agent takes a live one for gone, by a lease that ran out."""

    instance: str


class Denied(Observation, frozen=True):
    """An instance may not join, or stay; `why` is for people."""

    instance: str
    why: str


class Astray(Observation, frozen=True):
    """An agent takes another robot for this one, and publishes poses of that."""


class Bids(Observation, frozen=True):
    """What an instance last thought of bidding, and how long ago it did (s)."""

    instance: str
    record: BidRecord
    age: float = 0.0


class Left(Observation, frozen=True):
    """An instance has gone, and with it its bids."""

    instance: str
