"""The sonar half of the controller: the firing order, and the echoes since a report."""

from __future__ import annotations

from collections.abc import Callable

from armadico.bridge.simulator.broken import Readings
from armadico.config.profile import SonarRing

ARRAYS = 4  # of eight sonars each; one sonar of each array pings at a time
ARRAY_SIZE = 8
ALL = (1 << ARRAYS) - 1


class Firing:
    """Pings the sonars in order, one of each array per turn."""

    def __init__(
        self,
        ring: SonarRing,
        ping: Callable[[int], float | None],
        readings: Readings[float | None],
    ) -> None:
        self.arrays = 0  # bit 0 to 3: array 1 to 4 is on
        self._ring = ring
        self._ping = ping
        self._readings = readings
        self._echoes: dict[int, float] = {}
        self._turn = 0
        self._orders: list[tuple[int, ...]] = []
        self.restore_order()

    def restore_order(self) -> None:
        """Return to the profile's firing order."""
        self._set_order(self._ring.firing_order)

    def poll(self, order: bytes) -> None:
        """POLLING: sonar numbers, from 1; an empty order is off. Unknown sonars are omitted."""
        self._set_order(tuple(number - 1 for number in order))
        self.arrays = ALL if order else 0

    def switch(self, value: int) -> None:
        """SONAR: bit 0 is on or off; the bits above select one array, 0 all of them."""
        array = value >> 1
        which = 1 << array - 1 & ALL if array > 0 else ALL
        self.arrays = self.arrays | which if value & 1 else self.arrays & ~which
        if not self.arrays:
            self._echoes.clear()

    def fire(self) -> None:
        """Ping the next sonar of each array that is on."""
        for array, order in enumerate(self._orders):
            if order and self.arrays >> array & 1 and not self._readings.silent:
                index = order[self._turn % len(order)]
                echo = self._ping(index)
                self._echoes[index] = self._ring.max_m if echo is None else echo
        self._turn += 1

    def collect(self) -> tuple[tuple[int, float], ...]:
        """Return and clear the echoes: sonar index and range (m), none as the maximum."""
        echoes = tuple(self._echoes.items())
        self._echoes.clear()
        return echoes

    def _set_order(self, order: tuple[int, ...]) -> None:
        known = [index for index in order if 0 <= index < len(self._ring.sonars)]
        self._orders = [
            tuple(index for index in known if index // ARRAY_SIZE == array)
            for array in range(ARRAYS)
        ]
        self._turn = 0
