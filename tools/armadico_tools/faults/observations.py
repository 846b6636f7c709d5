"""What can be observed of a society from outside its processes, at a time of the observer, s."""

from __future__ import annotations

from math import inf

from msgspec import Struct

from armadico.core.messages import Ballot, BidRecord, Cycle, Message
from armadico.core.resources import WHEELS
from armadico.mobile.messages import Waypoint


class Observation(Struct, frozen=True):
    """One observation, and its time."""

    at: float


class Published(Observation, frozen=True):
    """A message of an agent, a person or the simulator."""

    message: Message


def of_the_wheels(message: Message) -> bool:
    """Whether a message is of the wheels, or of no resource."""
    return getattr(message, "resource", WHEELS.name) == WHEELS.name


class Ordered(Observation, frozen=True):
    """Speeds that the robot agent wrote to the controller, m/s and rad/s."""

    v: float
    w: float


class Arrived(Observation, frozen=True):
    """The controller has received an order. Where this is not observed, none does."""


class Faulted(Observation, frozen=True):
    """A fault begins or ends; `kind` is one of `fault_types.KINDS`, `targets` names agents.

    `to` names the receivers, for faults of the network; `amount` is the kind's own number
    (`plan.DRAWS`). An unknown amount counts as the worst.
    """

    kind: str
    targets: tuple[str, ...]
    began: bool
    to: tuple[str, ...] = ()
    amount: float = inf


class Passed(Observation, frozen=True):
    """Time has passed without another observation."""


class Obeyed(Observation, frozen=True):
    """The robot agent obeys a command. If this is not observed, the `Ack` is used."""

    ballot: Ballot
    cycle: Cycle


class Refused(Observation, frozen=True):
    """The robot agent refuses a command; `why` is the verdict's name."""

    ballot: Ballot
    why: str


class Missed(Observation, frozen=True):
    """An agent considers a live one gone, because a lease expired."""

    instance: str


class Denied(Observation, frozen=True):
    """An instance may not join, or stay; `why` is for people."""

    instance: str
    why: str


class Asked(Observation, frozen=True):
    """A mission was accepted for a goal."""

    mission: int
    goal: Waypoint


class Astray(Observation, frozen=True):
    """An agent takes another robot for this one, and publishes its poses."""


class Bids(Observation, frozen=True):
    """The last bid of an instance, or the reason for none; `age` is the time since, s."""

    instance: str
    record: BidRecord
    age: float = 0.0


class Came(Observation, frozen=True):
    """The liveliness token of an instance appeared."""

    instance: str


class Left(Observation, frozen=True):
    """An instance is gone, and so are its bids."""

    instance: str
