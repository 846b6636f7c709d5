"""What happens in the demo, as one can tell it from what an observer hears (sans-IO)."""

from __future__ import annotations

from collections.abc import Mapping

from armadico.core.messages import Card, Command, MissionStatus
from armadico.observe.watching import Heard, Presence, agent_of, read_or_none
from armadico_tools.faults.event_log import Account
from armadico_tools.faults.observations import Said

FRESH_S = 1.0
"""A bid that was told longer ago says nothing of now."""


class Story(Account):
    """What an onlooker sees of any society, and where its instances are; times are s."""

    def __init__(self) -> None:
        super().__init__()
        self.homes: dict[str, str] = {}  # the host of an instance
        self._way = self._to_go = 0.0  # the longest that was to go, and what is, m

    def hear(self, item: Heard | Presence) -> None:
        """Take one thing, in the order in which they came."""
        at = item.at / 1e9
        if isinstance(item, Presence):
            self.token(at, item.instance, item.there)
            return
        message = read_or_none(item)
        if isinstance(message, Card):
            self.homes[message.instance] = message.host
        elif message is not None:
            self.take(Said(at, message))
        if isinstance(message, MissionStatus):
            self._to_go, self._way = message.to_go, max(self._way, message.to_go)

    @property
    def driver(self) -> str:
        """The instance that is obeyed now; empty if nobody is."""
        return self.holder if self.obeyed_lately() else ""

    @property
    def speed(self) -> float:
        """The robot's, m/s."""
        return float(self.ack.measured[0]) if self.ack and self.ack.measured else 0.0

    def name(self, instance: str) -> str:
        """An instance for people: `avoid on lab1`."""
        return f"{agent_of(instance)} on {self.homes.get(instance, 'an unknown host')}"

    def on(self, host: str) -> dict[str, float]:
        """The agents whose tokens are there from a host, by name, and since when."""
        return {agent_of(who): at for who, at in self.there.items() if self.homes.get(who) == host}

    def lacks(self, wanted: Mapping[str, tuple[str, ...]]) -> list[str]:
        """What is not there of what should be on each host, for people."""
        return [
            f"{name} on {host}"
            for host, names in wanted.items()
            for name in names
            if name not in self.on(host)
        ]

    def standing_by(self, host: str) -> dict[str, float]:
        """Those on other hosts who would drive at this moment, and their utilities."""
        return {
            who: history.bids[-1].utility or 0.0
            for who, (_, history) in self.bids.items()
            if self.homes.get(who) != host and self.bids_now(who, FRESH_S)
        }

    def done(self) -> float:
        """The share of the way that is behind the robot, 0 to 1."""
        return 1.0 - self._to_go / self._way if self._way > 0.0 else 0.0

    def last_command(self, host: str) -> tuple[float, Command] | None:
        """When anybody on a host commanded last, and what."""
        heard = (at_what for at_what in reversed(self.commands))
        return next((x for x in heard if self.homes.get(x[1].ballot.instance) == host), None)
