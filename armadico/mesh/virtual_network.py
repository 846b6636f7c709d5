"""Links and process clocks of the virtual mesh.

A link is one direction between two processes. It delays, loses, duplicates and reorders messages,
and corrupts bytes on the way to a device. Each process has its own clock; they are never compared.
"""

from __future__ import annotations

import random
from dataclasses import replace
from math import exp
from statistics import NormalDist
from typing import Final

from armadico.mesh.link_faults import WHOLE

# Delays are log-normal: median in s and sigma, measured between processes on one machine at 10 Hz.
DELAY_MEDIAN = 0.0006
DELAY_SPREAD = 0.45

# Quantiles of that distribution, s. Drawing one is the largest part of a delivery's cost.
DELAYS: Final = tuple(
    DELAY_MEDIAN * exp(DELAY_SPREAD * NormalDist().inv_cdf((n + 0.5) / 1024)) for n in range(1024)
)

Way = tuple[str, str]  # from one agent's address to another's


class Link:
    """One direction between two processes, with its faults."""

    __slots__ = ("faults", "last", "rng")

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.last = 0.0
        self.faults = WHOLE

    @property
    def up(self) -> bool:
        """Whether it is not cut; other faults stay as they are."""
        return not self.faults.cut

    @up.setter
    def up(self, up: bool) -> None:
        faults = replace(self.faults, cut=not up)
        self.faults = WHOLE if faults == WHOLE else faults

    def arrival(self, now: float, *, reliable: bool = False) -> float | None:
        """Return when a message sent now arrives, s; None if it is lost.

        What is sent reliably arrives at each link that is not cut, as Zenoh's declarations do.
        """
        faults = self.faults
        if faults.cut or (faults.loss and not reliable and self.rng.random() < faults.loss):
            return None
        at = now + faults.delay + DELAYS[int(self.rng.random() * 1024)]
        if faults is not WHOLE:
            if faults.jitter:
                at += self.rng.uniform(0.0, faults.jitter)
            if faults.reorder and self.rng.random() < faults.reorder:
                return at + self.rng.uniform(0.0, faults.behind)  # later messages overtake it
        self.last = max(at, self.last)
        return self.last

    def again(self, arrival: float) -> float | None:
        """Return when a duplicate arrives, s; None if there is none."""
        faults = self.faults
        if not faults.duplicate or self.rng.random() >= faults.duplicate:
            return None
        return arrival + self.rng.uniform(0.0, max(faults.behind, DELAY_MEDIAN))

    def spoil(self, data: bytes) -> bytes:
        """Return bytes as they arrive: some changed, removed or inserted, at random."""
        rng = self.rng
        if not self.faults.garble or rng.random() >= self.faults.garble:
            return data
        spoilt = bytearray(data)
        for _ in range(rng.randint(1, 4)):
            where = rng.randrange(len(spoilt) + 1)
            what = rng.randrange(3)
            if what == 0:
                spoilt[where:where] = rng.randbytes(rng.randint(1, 8))
            elif what == 1:
                del spoilt[where : where + rng.randint(1, 8)]
            else:
                spoilt[where : where + 1] = rng.randbytes(1)
        return bytes(spoilt)


class Clock:
    """A process's monotonic clock: it starts anywhere, may run fast or slow, and may jump ahead."""

    def __init__(self, shows: float = 0.0, rate: float = 1.0) -> None:
        self._at = 0.0
        self._shows = shows
        self._rate = rate

    def read(self, now: float) -> float:
        """Return the clock's time at a time of the mesh, s."""
        return self._shows + (now - self._at) * self._rate

    def when(self, shows: float) -> float:
        """Return the mesh's time at a time of the clock, s."""
        return self._at + (shows - self._shows) / self._rate

    def drift(self, now: float, rate: float) -> None:
        """Set the rate from now on; 1 is exact. Raises ValueError if it is not above 0."""
        if rate <= 0.0:
            raise ValueError(f"a clock's rate is above 0, not {rate}")
        self._at, self._shows, self._rate = now, self.read(now), rate

    def jump(self, ahead: float) -> None:
        """Advance the clock at once, s. Raises ValueError if that is backwards."""
        if ahead < 0.0:
            raise ValueError(f"a monotonic clock does not go back, by {-ahead} s")
        self._shows += ahead
