"""What a Create 3 feels, as a Pioneer's bumpers and stall bits would say it; sans-IO.

Its bumper and its cliff sensors are all in front (iroboteducation.github.io/create3_docs, hazards
and safety). What it backs off by itself it does before anybody here knows.
"""

from __future__ import annotations

from armadico.bridge.ros2 import types

_AHEAD = {types.BUMP: 1, types.CLIFF: 2}  # a bit each, as bumpers have
_BEHIND = {types.BACKUP_LIMIT: 1}
_TOLD = {
    types.CLIFF: "a cliff",
    types.WHEEL_DROP: "a wheel that hangs in the air",
    types.BACKUP_LIMIT: "its limit of backing, for it does not see what is behind: drive it ahead",
}


class Hazards:
    """All that was felt since a cycle.

    Attributes:
        ahead: What was touched in front, or is no floor there; a bit each.
        behind: The same behind.
        stalled: Whether something holds its wheels.
        lifted: Whether a wheel hangs in the air.
        told: What is new of it, for people.
    """

    def __init__(self) -> None:
        self._felt: dict[int, str] = {}  # since the cycle before: by kind, where
        self._before: dict[int, str] = {}
        self.ahead = self.behind = 0
        self.stalled = self.lifted = False
        self.told: tuple[str, ...] = ()

    def feel(self, said: types.HazardDetectionVector) -> None:
        """Take what it feels now."""
        for each in said.detections:
            self._felt[each.type] = each.header.frame_id

    def collect(self) -> None:
        """A cycle has come: what was felt since the last one is what it reports."""
        felt, self._felt = self._felt, {}
        self.ahead = sum(bit for kind, bit in _AHEAD.items() if kind in felt)
        self.behind = sum(bit for kind, bit in _BEHIND.items() if kind in felt)
        self.stalled, self.lifted = types.STALL in felt, types.WHEEL_DROP in felt
        self.told = tuple(
            f"it feels {text} ({felt[kind]})"
            for kind, text in _TOLD.items()
            if kind in felt and kind not in self._before
        )
        self._before = felt
