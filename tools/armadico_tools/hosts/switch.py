"""An Ethernet switch that is not there: frames and the time in, frames and when they are due out.

Sans-IO. A link leads from one host to another and has faults of its own, so that what a host sends
and what it receives may suffer differently. All draws come from one seed, a stream for each link:
a fault on one leaves what happens on the others as it was. A seed fixes the draws, not when a real
host sends.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from hashlib import sha256

from armadico.mesh.link_faults import WHOLE, LinkFaults

Link = tuple[str, str]
"""From a host, to a host."""


@dataclass(slots=True)
class Count:
    """What became of the frames of one direction of a link."""

    sent: int = 0
    lost: int = 0


@dataclass(slots=True)
class _Wire:
    rng: random.Random
    faults: LinkFaults = WHOLE
    last_due: float = 0.0
    count: Count = field(default_factory=Count)


@dataclass(frozen=True, slots=True, order=True)
class _Due:
    at: float
    sequence: int
    host: str = field(compare=False)
    frame: bytes = field(compare=False)


class Switch:
    """Leads frames between hosts, learning nothing: the addresses are given."""

    def __init__(self, addresses: dict[bytes, str], seed: int = 0) -> None:
        """Begin with whole links between all hosts.

        Args:
            addresses: The Ethernet address (6 bytes) of each host's card, and the host.
            seed: Of all that the links draw.
        """
        self.hosts = tuple(addresses.values())
        self._addresses = dict(addresses)
        self._wires = {
            (a, b): _Wire(_stream(seed, a, b)) for a in self.hosts for b in self.hosts if a != b
        }
        self._off: set[str] = set()
        self._waiting: list[_Due] = []
        self._sequence = 0

    # Frames --------------------------------------------------------------------------------------

    def forward(self, host: str, frame: bytes, now: float) -> None:
        """Take a frame that a host sent; to one host if its address is known, else to all."""
        one = self._addresses.get(frame[:6])
        for target in (one,) if one is not None else self.hosts:
            if target != host:
                self._lead(host, target, frame, now)

    def due(self, now: float) -> Iterator[tuple[str, bytes]]:
        """The frames that arrive by now, in order, each with the host that is to have it."""
        while self._waiting and self._waiting[0].at <= now:
            item = heapq.heappop(self._waiting)
            if item.host not in self._off:
                yield item.host, item.frame

    @property
    def next_due(self) -> float | None:
        """When the next frame arrives, s; None if none is on its way."""
        return self._waiting[0].at if self._waiting else None

    def _lead(self, source: str, target: str, frame: bytes, now: float) -> None:
        wire = self._wires[source, target]
        faults, rng = wire.faults, wire.rng
        # Each frame draws the same numbers whatever the faults are: changing one of them leaves
        # what the others do as it was.
        lost, late = rng.random(), rng.uniform(-1.0, 1.0)
        if source in self._off or target in self._off or faults.cut or lost < faults.loss:
            wire.count.lost += 1
            return
        wire.count.sent += 1
        at = max(now + max(faults.delay + faults.jitter * late, 0.0), wire.last_due)
        wire.last_due = at
        self._sequence += 1
        heapq.heappush(self._waiting, _Due(at, self._sequence, target, frame))

    # Faults --------------------------------------------------------------------------------------

    def set(self, links: Iterable[Link], faults: LinkFaults) -> None:
        """Put faults on links in place of those that they had."""
        for link in links:
            self._wires[link].faults = faults

    def cut(self, links: Iterable[Link], cut: bool = True) -> None:
        """Cut links, or mend the cut; what else is wrong with them stays."""
        for link in links:
            wire = self._wires[link]
            wire.faults = replace(wire.faults, cut=cut)

    def partition(self, *groups: Collection[str]) -> None:
        """Let only hosts of one group reach each other; who is in no group is alone."""
        group = {host: number for number, hosts in enumerate(groups) for host in hosts}
        for (a, b), wire in self._wires.items():
            together = a in group and group.get(a) == group.get(b)
            wire.faults = replace(wire.faults, cut=not together)

    def heal(self) -> None:
        """Make all links whole, and plug every host in."""
        self._off.clear()
        self.set(self._wires, WHOLE)

    def plug(self, host: str, in_: bool) -> None:
        """Put a host's plug in, or pull it: what was on its way to it is lost."""
        (self._off.discard if in_ else self._off.add)(host)

    def links(self, *, of: str | None = None) -> list[Link]:
        """All links, or those from and to one host."""
        return [link for link in self._wires if of is None or of in link]

    def counts(self) -> dict[Link, Count]:
        """What became of the frames, for each link that had any."""
        return {link: wire.count for link, wire in self._wires.items() if wire.count != Count()}


def _stream(seed: int, source: str, target: str) -> random.Random:
    name = sha256(f"{seed} {source} {target}".encode()).digest()
    return random.Random(int.from_bytes(name[:8], "big"))
