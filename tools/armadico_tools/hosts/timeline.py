"""What happens in the demo, as one can tell it from a watcher's news (sans-IO)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from armadico.observe.view import agent_of
from armadico_tools.hosts import events

FRESH_S = 1.0
"""A bid that was told longer ago says nothing of now."""


@dataclass(frozen=True)
class Takeover:
    """Who was obeyed next, and how long after the last command of who drove before."""

    instance: str
    seconds: float
    cycles: int


@dataclass
class Story:
    """Takes news in the order in which they come."""

    now: float = 0.0
    holder: str = ""
    number: int = 0  # of the newest cycle
    speed: float = 0.0
    there: dict[str, float] = field(default_factory=dict)  # instances, and since when
    homes: dict[str, str] = field(default_factory=dict)  # the host of an instance
    to_go: float | None = None
    way: float = 0.0  # the longest that was to go
    reached: bool = False
    _bids: dict[str, events.Bidding] = field(default_factory=dict)
    _commands: dict[str, events.Commanded] = field(default_factory=dict)
    _first: dict[tuple[str, int], events.Commanded] = field(default_factory=dict)
    _cycles: list[events.Cycle] = field(default_factory=list)

    def take(self, each: events.News) -> None:
        """Take one thing."""
        if isinstance(each, events.Home):
            self.homes[each.instance] = each.host
            return
        self.now = max(self.now, each.at)
        if isinstance(each, events.Cycle):
            self.holder, self.number, self.speed = each.holder, each.number, each.v
            self._cycles.append(each)
        elif isinstance(each, events.Commanded):
            self._commands[each.instance] = each
            self._first[each.instance, each.number] = each
        elif isinstance(each, events.Token):
            if each.there:
                self.there.setdefault(each.instance, each.at)
            else:
                self.there.pop(each.instance, None)
        elif isinstance(each, events.Bidding):
            self._bids[each.instance] = each
        elif isinstance(each, events.Mission):
            self.to_go, self.reached = each.to_go, each.state == "reached"
            self.way = max(self.way, each.to_go)

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

    def standing_by(self, host: str) -> list[events.Bidding]:
        """Those on other hosts who would drive at this moment."""
        return [
            bid
            for who, bid in self._bids.items()
            if bid.utility and self.homes.get(who) != host and self.now - bid.at <= FRESH_S
        ]

    def done(self) -> float:
        """The share of the way that is behind the robot, 0 to 1."""
        if self.to_go is None or self.way <= 0.0:
            return 0.0
        return 1.0 - self.to_go / self.way

    def last_command(self, host: str) -> events.Commanded | None:
        """The last that anybody on a host commanded."""
        heard = [c for who, c in self._commands.items() if self.homes.get(who) == host]
        return max(heard, key=lambda each: each.at, default=None)

    def takeover(self, since: events.Commanded) -> Takeover | None:
        """Who was obeyed next after somebody's last command; None if nobody is yet."""
        for cycle in self._cycles:
            if cycle.at <= since.at or cycle.holder in ("", since.instance):
                continue
            said = self._first.get((cycle.holder, cycle.obeyed))
            if said is not None and said.at > since.at:
                return Takeover(said.instance, said.at - since.at, said.number - since.number)
        return None
