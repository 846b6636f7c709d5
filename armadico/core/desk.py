"""What the parts of an agent's kernel share: the time, the messages, the outbox."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, TypeVar, cast

from armadico.core import messages as m
from armadico.core.cycles import CycleClock
from armadico.core.individual import Individual
from armadico.core.latched import STOP, Memory, What, what_of
from armadico.core.membership import agent_of
from armadico.core.messages import Message
from armadico.core.outgoing import INFO, Outgoing, Publish
from armadico.core.services import Gathering, Kind, expression, service_of

M = TypeVar("M", bound=Message)

BIDS_REMEMBERED: Final = 50


@dataclass(frozen=True, slots=True)
class Authored:
    """The author of a stored state, and the state as it signed it, if that was received."""

    instance: str  # empty: of protocol 2, and not known
    record: m.Repeat | None = None


class Desk:
    """The state that the kernel of an agent shares with its parts."""

    def __init__(self, agent: Individual) -> None:
        self.agent = agent  # the user's object
        self.now = 0.0  # the agent's time, s
        self.cycles = CycleClock()  # the robot's cycles
        self.outbox: list[Outgoing] = []  # what the driver is to send, in order
        self.memory = Memory(agent.rng, self._gives)  # the latched states
        self.memory.judges = m.RobotState in agent.provides
        # Who published them, by kind and topic: the keys, or "" of protocol 2.
        self.authors: dict[What, Authored] = {}
        self.living: set[str] = set()  # the live instances of other agents
        self.newest: dict[type[Message], Message] = {}  # the newest messages, by kind
        # What combines the messages of several publishers, by kind.
        self.gatherings: dict[type[Message], Gathering] = {}
        # The records of the last bids.
        self.bids: deque[m.BidRecord] = deque(maxlen=BIDS_REMEMBERED)
        self.protocol = agent.identity.protocol  # the version of the protocol that the agent uses
        # The key expressions of the needed messages.
        self.inputs = tuple(expression(self._key(kind)) for kind in agent.needs)

    def key_of(self, kind: type[Message], **names: str) -> str:
        """Return the key of a kind's service, filled with `names`, else the agent's names."""
        key = self._key(kind)
        if "{" not in key:
            return key
        agent = self.agent
        own = {"instance": agent.instance, "name": agent.name, **agent.key_names}
        return key.format(**{**own, **names})

    def publish(self, message: Message, **names: str) -> None:
        """Publish a message on its service's key; `names` fill the key's braces."""
        service = service_of(type(message))
        if service.kind is Kind.LATCHED:
            with suppress(m.MessageError):  # a message that cannot be sent is not stored either
                latched = m.checked(cast("m.Latched", message))
                self.memory.note(latched)
                self.authors[what_of(latched)] = Authored(self.agent.instance)
        self.outbox.append(Publish(self.key_of(type(message), **names), message))

    def _gives(self, what: What) -> bool:
        """Return whether this agent gives a latched state to others: its author is gone.

        It may be gone unseen, while the robot's router restarts: then its successor is there.
        """
        known = self.authors.get(what)
        if what == STOP or known is None or known.instance not in self.living:
            return True
        name = agent_of(known.instance)
        return sum(agent_of(each) == name for each in self.living) > 1

    def _key(self, kind: type[Message]) -> str:
        return service_of(kind).key_in(self.protocol)

    def log(self, text: str, level: int = INFO, event: str = "") -> None:
        """Publish a log line; `event` (`m.LogEvent`) is for programs."""
        self.publish(m.Log(level, m.line(text), event))

    def latest(self, kind: type[M]) -> M | None:
        """Return the newest message of a kind, fresh or not."""
        return cast("M | None", self.newest.get(kind))

    def fresh(self, kind: type[M]) -> M | None:
        """Return the newest message of a kind if it is fresh by the table of services."""
        message: Any = self.newest.get(kind)
        if message is None:
            return None
        within = service_of(type(message)).fresh_cycles
        return message if within is None or self.cycles.fresh(message.cycle, within) else None

    @property
    def stopped(self) -> m.Stop | None:
        """The robot's stop, while it is latched."""
        stop = self.memory.newest(m.Stop)
        return stop if stop is not None and stop.stopped else None

    def stale_need(self) -> str:
        """Return the key on which the first needed message is missing or stale; "" if none is."""
        stale = next((kind for kind in self.agent.needs if self.fresh(kind) is None), None)
        if stale is None:
            return ""
        service, gathering = service_of(stale), self.gatherings.get(stale)
        if gathering is None:
            return expression(self._key(stale))
        within = service.fresh_cycles
        return service.key.format(name=gathering.missing(lambda c: self.cycles.fresh(c, within)))

    def oldest_input(self) -> m.Cycle | None:
        """Return the oldest cycle of the needed messages; None if none has a cycle."""
        latest = (self.newest.get(kind) for kind in self.agent.needs)
        return min((c for each in latest if (c := getattr(each, "cycle", None))), default=None)
