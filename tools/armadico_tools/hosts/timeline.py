"""What happens in the demo, as one can tell it from what a remote observer hears (sans-IO)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from armadico.core.messages import Ack, BidRecord, Command
from armadico.core.resources import WHEELS
from armadico.observe.view import View, agent_of, driver
from armadico.observe.watching import Heard, Presence, read_or_none, show

FRESH_S = 1.0
"""A bid that was told longer ago says nothing of now."""


@dataclass(frozen=True)
class Commanded:
    """Somebody commanded the wheels, at a time (s), for a cycle."""

    at: float
    instance: str
    number: int


@dataclass(frozen=True)
class Takeover:
    """Who was obeyed next, and how long after the last command of who drove before."""

    instance: str
    seconds: float
    cycles: int


class Story:
    """Takes what was heard, in that order."""

    def __init__(self) -> None:
        self.view = View()
        self.now = 0.0
        self._way = 0.0  # the longest that was to go
        self._commands: dict[tuple[str, int], Commanded] = {}
        self._acks: list[tuple[float, Ack]] = []

    def take(self, item: Heard | Presence) -> None:
        """Take one thing."""
        self.now = max(self.now, item.at / 1e9)
        show(self.view, item)
        message = None if isinstance(item, Presence) else read_or_none(item)
        if isinstance(message, Ack):
            self._acks.append((item.at / 1e9, message))
        elif isinstance(message, Command):
            said = Commanded(item.at / 1e9, message.ballot.instance, message.cycle.number)
            self._commands[said.instance, said.number] = said
        elif self.view.mission is not None:
            self._way = max(self._way, self.view.mission.to_go)

    @property
    def driver(self) -> str:
        """The instance that drives; empty: nobody."""
        return self.view.driver(WHEELS.name, self.now) or ""

    @property
    def speed(self) -> float:
        """As the robot agent measures it, m/s."""
        ack = self.view.acks.get(WHEELS.name)
        return float(ack.measured[0]) if ack is not None and ack.measured else 0.0

    def host(self, instance: str) -> str | None:
        """Where an instance runs, by its card; None: not known."""
        card = self.view.cards.get(instance)
        return None if card is None else card.host

    def name(self, instance: str) -> str:
        """An instance for people: `avoid on lab1`."""
        return f"{agent_of(instance)} on {self.host(instance) or 'an unknown host'}"

    def on(self, host: str) -> dict[str, float]:
        """The agents whose tokens are there from a host, by name, and since when."""
        alive = self.view.alive.items()
        return {agent_of(who): at for who, at in alive if self.host(who) == host}

    def lacks(self, wanted: Mapping[str, tuple[str, ...]]) -> list[str]:
        """What is not there of what should be on each host, for people."""
        return [
            f"{name} on {host}"
            for host, names in wanted.items()
            for name in names
            if name not in self.on(host)
        ]

    def standing_by(self, host: str) -> list[tuple[str, BidRecord]]:
        """Those on other hosts who would drive at this moment, and what they bid."""
        return [
            (who, bid)
            for who, (bid, at) in self.view.bids.items()
            if bid.utility and self.host(who) != host and self.now - at <= FRESH_S
        ]

    def done(self) -> float:
        """The share of the way that is behind the robot, 0 to 1."""
        mission = self.view.mission
        return 0.0 if mission is None or not self._way else 1.0 - mission.to_go / self._way

    def last_command(self, host: str) -> Commanded | None:
        """The last that anybody on a host commanded."""
        heard = [each for each in self._commands.values() if self.host(each.instance) == host]
        return max(heard, key=lambda each: each.at, default=None)

    def takeover(self, since: Commanded) -> Takeover | None:
        """Who was obeyed next after somebody's last command; None if nobody is yet."""
        for at, ack in self._acks:
            who, answered = driver(ack), ack.obeyed_cycle
            if at <= since.at or who is None or who == since.instance or answered is None:
                continue
            said = self._commands.get((who, answered.number))
            if said is not None and said.at > since.at:
                return Takeover(said.instance, said.at - since.at, said.number - since.number)
        return None
