"""What the checker of promises is shown, in the order of time.

All of it can be seen from outside the processes: what is said on the mesh, what the robot agent
writes to the controller, and what whoever makes the faults knows. Two kinds are optional, since
only the virtual mesh shows them in every cycle: `Obeyed` and `Bids`. `at` is always in seconds, by
one clock of whoever watches.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from armadico.core.messages import Ballot, BidRecord, Cycle, Message


@dataclass(frozen=True, slots=True)
class Said:
    """A message: what the robot agent, contenders, people and the simulator say."""

    at: float
    message: Message


@dataclass(frozen=True, slots=True)
class Ordered:
    """Speeds that the robot agent wrote to the controller, m/s and rad/s."""

    at: float
    v: float
    w: float


@dataclass(frozen=True, slots=True)
class Faulted:
    """A fault begins or ends; `kind` is one of `kinds.KINDS`, `whom` names agents.

    `to` is whom messages go to, for faults of the network; `amount` is the kind's own number
    (`plan.DRAWS`): unknown it is the worst.
    """

    at: float
    kind: str
    whom: tuple[str, ...]
    began: bool
    to: tuple[str, ...] = ()
    amount: float = inf


@dataclass(frozen=True, slots=True)
class Passed:
    """Nothing but time: say so at the end, and wherever nothing is seen for long."""

    at: float


@dataclass(frozen=True, slots=True)
class Obeyed:
    """Optional: the robot agent obeys a command. Without it the `Ack` has to do."""

    at: float
    ballot: Ballot
    cycle: Cycle


@dataclass(frozen=True, slots=True)
class Refused:
    """Optional: the robot agent refuses a command; `why` is the verdict's name."""

    at: float
    ballot: Ballot
    why: str


@dataclass(frozen=True, slots=True)
class Missed:
    """Optional: an agent takes somebody for gone who lives, by a lease that ran out."""

    at: float
    instance: str


@dataclass(frozen=True, slots=True)
class Denied:
    """Optional: an instance may not join, or stay; `why` is for people."""

    at: float
    instance: str
    why: str


@dataclass(frozen=True, slots=True)
class Astray:
    """Optional: somebody takes another robot for this one, and says poses of that."""

    at: float


@dataclass(frozen=True, slots=True)
class Bids:
    """Optional: what an instance last thought of bidding, and how long ago it did (s)."""

    at: float
    instance: str
    record: BidRecord
    age: float = 0.0


@dataclass(frozen=True, slots=True)
class Left:
    """Optional: an instance has gone, and with it its bids."""

    at: float
    instance: str


Observation = (
    Said | Ordered | Faulted | Passed | Obeyed | Refused | Missed | Denied | Astray | Bids | Left
)
