"""What happens in the demo, from what a remote observer received (sans-IO)."""

from __future__ import annotations

from collections.abc import Mapping

from armadico.core.messages import Command
from armadico.core.resources import WHEELS
from armadico.observe.view import agent_of
from armadico.observe.watching import Heard, Presence, read_or_none
from armadico_tools.faults.event_log import Account
from armadico_tools.faults.observations import Said

FRESH_S = 1.0
"""A bid received longer ago does not count."""


class Story(Account):
    """What an onlooker sees of any society, and where its instances are; times are s."""

    def __init__(self) -> None:
        super().__init__()
        self._way = 0.0  # the longest that was to go, m

    def hear(self, item: Heard | Presence) -> None:
        """Take one thing, in the order in which they came."""
        at = item.at / 1e9
        if isinstance(item, Presence):
            self.token(at, item.instance, item.there)
        elif (message := read_or_none(item)) is not None:
            self.take(Said(at, message))
        if self.view.mission is not None:
            self._way = max(self._way, self.view.mission.to_go)

    @property
    def speed(self) -> float:
        """As the robot agent measures it, m/s."""
        ack = self.view.acks.get(WHEELS.name)
        return float(ack.measured[0]) if ack is not None and ack.measured else 0.0

    def host(self, instance: str | None) -> str | None:
        """Where an instance runs, by its card; None: not known."""
        card = self.view.cards.get(instance or "")
        return None if card is None else card.host

    def name(self, instance: str | None) -> str:
        """An instance for people: `avoid on lab1`; of None: `no agent`."""
        if instance is None:
            return "no agent"
        return f"{agent_of(instance)} on {self.host(instance) or 'an unknown host'}"

    def on(self, host: str) -> dict[str, float]:
        """The agents alive on a host, by name, and since when."""
        alive = self.view.alive.items()
        return {agent_of(who): at for who, at in alive if self.host(who) == host}

    def lacks(self, wanted: Mapping[str, tuple[str, ...]]) -> list[str]:
        """The agents that should be alive on each host and are not, for people."""
        return [
            f"{name} on {host}"
            for host, names in wanted.items()
            for name in names
            if name not in self.on(host)
        ]

    def standing_by(self, host: str) -> dict[str, float]:
        """Those on other hosts who would drive at this moment, and their utilities."""
        return {
            who: bid.utility
            for who in self.view.bids
            if (bid := self.view.bid(who))
            and bid.utility
            and self.host(who) != host
            and self.bids_now(who, FRESH_S)
        }

    def done(self) -> float:
        """The share of the way that is behind the robot, 0 to 1."""
        mission = self.view.mission
        return 0.0 if mission is None or not self._way else 1.0 - mission.to_go / self._way

    def last_command(self, host: str) -> tuple[float, Command] | None:
        """When an agent on a host commanded last, and what."""
        newest = reversed(self.commands)
        return next((x for x in newest if self.host(x[1].ballot.instance) == host), None)
