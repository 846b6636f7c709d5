"""Where connections come from, and how many a source may open (sans-IO)."""

from __future__ import annotations

import ipaddress
from collections import OrderedDict
from dataclasses import dataclass, field


def source_of(address: str) -> str:
    """Return an address, or with IPv6 its network, which one machine has whole."""
    found = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(found, ipaddress.IPv6Address):
        mapped = found.ipv4_mapped
        return str(mapped or ipaddress.ip_network((int(found), 64), strict=False))
    return str(found)


@dataclass
class Ration:
    """How many times something may begin: `burst` at once, and then `rate_hz`."""

    rate_hz: float
    burst: float
    at: float = 0.0
    left: float = field(init=False)

    def __post_init__(self) -> None:
        self.left = self.burst

    def refill(self, now: float) -> None:
        self.left = min(self.left + max(now - self.at, 0.0) * self.rate_hz, self.burst)
        self.at = now

    def take(self, now: float) -> bool:
        """Take one at a time, s; return whether there was one."""
        self.refill(now)
        if self.left < 1.0:
            return False
        self.left -= 1.0
        return True

    def until_one(self) -> float:
        """How long it takes until one is left, s."""
        return max(1.0 - self.left, 0.0) / self.rate_hz


class Rations:
    """The rations of sources; those used last are remembered."""

    def __init__(self, rate_hz: float, burst: float, most: int = 1024) -> None:
        self._rate_hz, self._burst, self._most = rate_hz, burst, most
        self._of: OrderedDict[str, Ration] = OrderedDict()

    def take(self, source: str, now: float) -> bool:
        """Take one of a source's ration at a time, s; return whether there was one."""
        own = self._of.setdefault(source, Ration(self._rate_hz, self._burst, now))
        self._of.move_to_end(source)
        if len(self._of) > self._most:
            self._of.popitem(last=False)
        return own.take(now)
