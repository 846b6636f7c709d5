"""A simulated Ethernet switch: frames and the time in, frames and their due times out.

Sans-IO. A link leads from one host to another and has its own faults, so the two directions may
differ. All random numbers come from one seed, with a stream for each link, so a fault on one link
does not change the others. A seed fixes the random numbers, not when a real host sends.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from hashlib import sha256

from armadico.mesh.link_faults import WHOLE, LinkFaults

Link = tuple[str, str]
"""From a host to a host."""


@dataclass(slots=True)
class Count:
    """The number of frames sent and lost in one direction of a link."""

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
    """Forwards frames between hosts with given addresses; it learns none."""

    def __init__(self, addresses: dict[bytes, str], seed: int = 0) -> None:
        """Start with intact links between all hosts.

        Args:
            addresses: The host for each Ethernet address (6 bytes).
            seed: Of the random numbers of all links.
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
        """Queue a frame from a host: for one host if its address is known, else for all others."""
        one = self._addresses.get(frame[:6])
        for target in (one,) if one is not None else self.hosts:
            if target != host:
                self._lead(host, target, frame, now)

    def due(self, now: float) -> Iterator[tuple[str, bytes]]:
        """The frames due by now, in order, each with its destination."""
        while self._waiting and self._waiting[0].at <= now:
            item = heapq.heappop(self._waiting)
            if item.host not in self._off:
                yield item.host, item.frame

    @property
    def next_due(self) -> float | None:
        """When the next frame arrives, s; None without one."""
        return self._waiting[0].at if self._waiting else None

    def _lead(self, source: str, target: str, frame: bytes, now: float) -> None:
        wire = self._wires[source, target]
        faults, rng = wire.faults, wire.rng
        # Each frame draws the same numbers for any faults, so changing one fault does not change
        # the effects of the others.
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
        """Replace the faults of links."""
        for link in links:
            self._wires[link].faults = faults

    def partition(self, *groups: Collection[str]) -> None:
        """Connect only hosts of the same group; a host in no group is isolated."""
        group = {host: number for number, hosts in enumerate(groups) for host in hosts}
        for (a, b), wire in self._wires.items():
            together = a in group and group.get(a) == group.get(b)
            wire.faults = replace(wire.faults, cut=not together)

    def heal(self) -> None:
        """Remove all faults, and reconnect every host."""
        self._off.clear()
        self.set(self._wires, WHOLE)

    def plug(self, host: str, in_: bool) -> None:
        """Connect or disconnect a host; frames on their way to it are lost."""
        (self._off.discard if in_ else self._off.add)(host)

    def links(self) -> list[Link]:
        """All links."""
        return list(self._wires)

    def counts(self) -> dict[Link, Count]:
        """The counts of each link that had frames."""
        return {link: wire.count for link, wire in self._wires.items() if wire.count != Count()}


def _stream(seed: int, source: str, target: str) -> random.Random:
    name = sha256(f"{seed} {source} {target}".encode()).digest()
    return random.Random(int.from_bytes(name[:8], "big"))
