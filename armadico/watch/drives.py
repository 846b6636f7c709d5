"""Which agent drove when, on which host, and how long nothing was obeyed (sans-IO)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from msgspec import Struct

from armadico.core.membership import agent_of
from armadico.core.messages import Ack, Card, Cycle


class Drive(Struct):
    """A time in which the owner obeyed commands of one instance, without those of others."""

    begun: float  # when the first of these commands was acknowledged, s
    ended: float  # when the last one was, s
    instance: str
    host: str = ""  # the host in its card; empty: not known

    @property
    def driver(self) -> str:
        return agent_of(self.instance) + (f" on {self.host}" if self.host else "")


class Unobeyed(Struct, frozen=True):
    """The longest time without an obeyed command between the first and the last one, s."""

    at: float
    seconds: float


class Drives:
    """The drives of one resource, from its acks in order."""

    def __init__(self, resource: str) -> None:
        self._resource = resource
        self._cycle: Cycle | None = None  # of the command obeyed last
        self.drives: list[Drive] = []
        self.unobeyed: Unobeyed | None = None

    def update(self, ack: Ack, cards: Mapping[str, Card], t: float, lead: str | None) -> None:
        """Process an ack; one that acknowledges no new command changes nothing.

        `lead` is the instance whose bid is obeyed, if that is another one: an arbiter's award.
        """
        if ack.resource != self._resource or ack.obeyed is None or ack.obeyed_cycle is None:
            return
        if ack.obeyed_cycle == self._cycle:
            return
        self._cycle = ack.obeyed_cycle
        last, instance = self.drives[-1] if self.drives else None, lead or ack.obeyed.instance
        if last is not None and (self.unobeyed is None or t - last.ended > self.unobeyed.seconds):
            self.unobeyed = Unobeyed(last.ended, t - last.ended)
        if last is None or last.instance != instance:
            last = Drive(t, t, instance)
            self.drives.append(last)
        last.ended = t
        if not last.host and instance in cards:  # it may have been alive before its card came
            last.host = cards[instance].host

    def sentences(self, most: int) -> Iterator[str]:
        """A line for each of the first `most` drives, and one for the longest time unobeyed."""
        for each in self.drives[:most]:
            yield f"{each.begun:8.2f} to {each.ended:.2f} s  {each.driver} drives"
        if len(self.drives) > most:
            yield f"            and {len(self.drives) - most} more"
        if self.unobeyed is not None:
            yield (
                f"Longest time without an obeyed command: {self.unobeyed.seconds:.2f} s, from"
                f" {self.unobeyed.at:.2f} s on."
            )
