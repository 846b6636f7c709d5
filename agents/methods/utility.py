"""The utility function all behaviours share (thesis 3.10.1, equations 3.4 and 3.5)."""

from __future__ import annotations

from typing import Final

MISSION: Final = (0.1, 0.8)
"""Utility of a mission of priority 0, and of 1: what it bids, and what others count it as worth."""


PEOPLES: Final = MISSION[0]
"""What people's own errands count as, who bid nothing: the least that may interrupt anybody."""

CHARGE_ASKED: Final = 0.85
"""Of a charge that somebody has asked for: above every mission's."""

CHARGE_SOON: Final = 0.9
"""Of one that what is left only just suffices for."""

CHARGE_NOW: Final = 0.95
"""Of one without which the robot stops where it is."""


def of_mission(priority: float) -> float:
    """What a mission of a priority (0 to 1) is worth, while it has something to do."""
    lowest, highest = MISSION
    return lowest + (highest - lowest) * priority


def ramp_down(x: float, low: float, high: float, p_max: float = 1.0, p_min: float = 0.0) -> float:
    """p_max below `low`, p_min above `high`, a straight line between."""
    if x <= low:
        return p_max
    if x >= high:
        return p_min
    return p_max - (p_max - p_min) * (x - low) / (high - low)
