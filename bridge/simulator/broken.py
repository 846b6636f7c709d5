"""Deliberate faults of a simulated range sensor: what it reports in place of what it measures."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import Final, Generic, TypeVar

T = TypeVar("T")

LOOP: Final = 5
"""Readings that a repeating sensor repeats: more than one, so that they differ as fresh ones do."""


class Broken(Enum):
    """A fault of a range sensor."""

    SILENT = "it reports nothing"
    FROZEN = "it repeats its last reading"
    REPEATING = "it repeats its last few readings in turn"
    BIASED = "all its ranges are too long or too short"


class Readings(Generic[T]):
    """The readings of a sensor of one or more parts, broken or not."""

    def __init__(self, shifted: Callable[[T, float], T]) -> None:
        """`shifted` adds a bias, m, to a reading."""
        self.broken: Broken | None = None  # its fault; None: it works
        self._shifted = shifted
        self._bias_m = 0.0
        self._last: dict[int, deque[T]] = {}

    @property
    def silent(self) -> bool:
        """Whether it reports nothing."""
        return self.broken is Broken.SILENT

    def fail(self, how: Broken | None, bias_m: float = 0.0) -> None:
        """Fail from now on; None: work again."""
        self.broken, self._bias_m = how, bias_m

    def reading(self, part: int, measure: Callable[[], T]) -> T:
        """What a part reports now."""
        last = self._last.setdefault(part, deque(maxlen=LOOP))
        if last and self.broken is Broken.FROZEN:
            return last[-1]
        if last and self.broken is Broken.REPEATING:
            last.rotate(-1)
            return last[-1]
        value = measure()
        last.append(value)
        return self._shifted(value, self._bias_m) if self.broken is Broken.BIASED else value
