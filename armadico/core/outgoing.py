"""What an agent gives to its driver to be sent, and the query that it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from msgspec import Struct

from armadico.core.messages import Message

DEBUG, INFO, WARNING, ERROR = 10, 20, 30, 40  # levels of log lines


EXPIRY_S: Final = 0.25  # a command to a guarded device holds so long, unless it is renewed, s
STEP_S: Final = 0.04  # time from one step of braking to the next, s


class Publish(Struct, frozen=True):  # made for each publication: a dataclass costs more
    key: str
    message: Message


@dataclass(frozen=True, slots=True)
class Question:
    """A received query. An agent that does not reply at once keeps it for `Agent.answer`."""

    id: int
    asker: str = ""
    """The identity that asks, by the key that it asks on: the robot's router admits no other one
    there. Empty without keys, and of queries whose key does not name it."""


@dataclass(frozen=True, slots=True)
class SendQuery:
    """Send a query. The reply arrives at `Kernel.on_reply` with this id."""

    id: int
    key: str
    request: Message
    reply: type[Message]
    timeout: float


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a `Question`."""

    id: int
    message: Message


@dataclass(frozen=True, slots=True)
class Write:
    """Write bytes to the agent's device.

    A guarded device is braked without the agent if no other write follows within `holds_s`.
    """

    data: bytes
    brakes: tuple[bytes, ...] = ()
    """What brakes the device from there, written one after another, each `STEP_S`; the last is
    repeated. Empty: the device rests."""
    moves: bool = False  # the bytes may move the device: they are dropped after a stop at the guard
    holds_s: float = EXPIRY_S


@dataclass(frozen=True, slots=True)
class Refused:
    """A rejected message. The driver counts these by reason and reports them at intervals."""

    key: str
    why: str  # the sender, the fault and the consequence; few different texts


Outgoing = Publish | SendQuery | Answer | Write | Refused
