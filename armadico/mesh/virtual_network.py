"""What lies between the nodes of the virtual mesh, and what each of them takes for the time.

A link is one direction between two processes; it delays, loses, doubles and reorders, and on the
way to a device it spoils bytes. A clock is one process's own: processes never compare theirs.
"""

from __future__ import annotations

import random
from math import exp
from statistics import NormalDist
from typing import Final

DELAY_MEDIAN = 0.0006
DELAY_SPREAD = 0.45
"""Log-normal: median in s and sigma, as measured between processes on one machine at 10 Hz."""

DELAYS: Final = tuple(
    DELAY_MEDIAN * exp(DELAY_SPREAD * NormalDist().inv_cdf((n + 0.5) / 1024)) for n in range(1024)
)
"""Quantiles of that, s: one is drawn for each delivery, which is most of what a delivery costs."""


class Link:
    """One direction between two processes.

    What one says to another arrives in order, unless `reorder` says otherwise. `loss`, `duplicate`
    and `reorder` are shares of the messages; who is reordered is late by up to `behind`, s;
    `garble` is the share of the pieces of bytes that arrive spoilt.
    """

    __slots__ = (
        *("behind", "delay", "duplicate", "garble", "jitter", "last", "loss", "reorder"),
        *("rng", "up"),
    )

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.last = 0.0
        self.up = True
        self.mend()

    def mend(self) -> None:
        """As good as new; whether it is cut is another matter."""
        self.loss = self.duplicate = self.reorder = self.garble = 0.0
        self.delay = 0.0  # s, on top of the usual,
        self.jitter = 0.0  # and up to so much more, drawn for each message
        self.behind = 0.0

    def arrival(self, now: float) -> float | None:
        """When something sent now arrives, s; None if it is lost."""
        if not self.up or (self.loss and self.rng.random() < self.loss):
            return None
        at = now + self.delay + DELAYS[int(self.rng.random() * 1024)]
        if self.jitter:
            at += self.rng.uniform(0.0, self.jitter)
        if self.reorder and self.rng.random() < self.reorder:
            return at + self.rng.uniform(0.0, self.behind)  # and what follows overtakes it
        self.last = max(at, self.last)
        return self.last

    def again(self, arrival: float) -> float | None:
        """When a second copy of something arrives, s; None if there is none."""
        if not self.duplicate or self.rng.random() >= self.duplicate:
            return None
        return arrival + self.rng.uniform(0.0, max(self.behind, DELAY_MEDIAN))

    def spoil(self, data: bytes) -> bytes:
        """Bytes as they come out: some changed, left out or put in, if it is their turn."""
        rng = self.rng
        if not self.garble or rng.random() >= self.garble:
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
    """A process's own clock: it starts anywhere, may run fast or slow, and may jump ahead.

    It never goes back: `time.monotonic` does not.
    """

    def __init__(self, shows: float = 0.0, rate: float = 1.0) -> None:
        self._at = 0.0
        self._shows = shows
        self._rate = rate

    def read(self, now: float) -> float:
        """What it shows at a time of the mesh, s."""
        return self._shows + (now - self._at) * self._rate

    def when(self, shows: float) -> float:
        """The time of the mesh at which it shows this, s."""
        return self._at + (shows - self._shows) / self._rate

    def drift(self, now: float, rate: float) -> None:
        """From now on it runs so many times as fast as it should. Raises ValueError below 0."""
        if rate <= 0.0:
            raise ValueError(f"a clock's rate is above 0, not {rate}")
        self._at, self._shows, self._rate = now, self.read(now), rate

    def jump(self, ahead: float) -> None:
        """It shows so much more at once, s. Raises ValueError if that is back."""
        if ahead < 0.0:
            raise ValueError(f"a monotonic clock does not go back, by {-ahead} s")
        self._shows += ahead
