"""Hazards of a Create 3 as bumpers and stall bits of a Pioneer; sans-IO.

Its bumper and cliff sensors are all in front (iroboteducation.github.io/create3_docs, hazards and
safety). It backs off by itself before a report arrives here.
"""

from __future__ import annotations

from armadico.bridge.ros2 import types

_AHEAD = {types.BUMP: 1, types.CLIFF: 2}  # one bit per kind, like bumpers
_BEHIND = {types.BACKUP_LIMIT: 1}
_TEXTS = {
    types.CLIFF: "a cliff",
    types.WHEEL_DROP: "a wheel that hangs in the air",
    types.BACKUP_LIMIT: "its limit of backing (it does not see what is behind): drive it ahead",
}


class Hazards:
    """The hazards detected in a cycle.

    Attributes:
        ahead: Contacts or missing floor in front, one bit per kind.
        behind: The same behind.
        stalled: Whether something blocks the wheels.
        lifted: Whether a wheel hangs in the air.
        texts: The hazards that are new in this cycle, for people.
    """

    def __init__(self) -> None:
        self._detected: dict[int, str] = {}  # since the last cycle: the frame, by kind
        self._before: dict[int, str] = {}
        self.ahead = self.behind = 0
        self.stalled = self.lifted = False
        self.texts: tuple[str, ...] = ()

    def on_hazards(self, message: types.HazardDetectionVector) -> None:
        for each in message.detections:
            self._detected[each.type] = each.header.frame_id

    def collect(self) -> None:
        """Set the attributes to what was detected since the last call, once per cycle."""
        detected, self._detected = self._detected, {}
        self.ahead = sum(bit for kind, bit in _AHEAD.items() if kind in detected)
        self.behind = sum(bit for kind, bit in _BEHIND.items() if kind in detected)
        self.stalled, self.lifted = types.STALL in detected, types.WHEEL_DROP in detected
        self.texts = tuple(
            f"it detects {text} ({detected[kind]})"
            for kind, text in _TEXTS.items()
            if kind in detected and kind not in self._before
        )
        self._before = detected
