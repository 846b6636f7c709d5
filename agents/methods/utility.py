"""The utility function of all behaviours (thesis 3.10.1, equations 3.4 and 3.5)."""

from __future__ import annotations

from typing import Final

MISSION: Final = (0.1, 0.8)
"""Utility of a mission of priority 0 and of priority 1."""

OPERATOR_ERRAND: Final = MISSION[0]
"""Value of operators' errands, which do not bid: the least that may interrupt a mission."""

CHARGE_REQUESTED: Final = 0.85
"""Utility of a charge that was requested: above every mission's."""

CHARGE_SOON: Final = 0.9
"""Utility of a charge for which the remaining energy just suffices."""

CHARGE_NOW: Final = 0.95
"""Utility of a charge without which the robot stops where it is."""


def of_mission(priority: float) -> float:
    """The utility of a mission of a priority (0 to 1) while it has a task."""
    lowest, highest = MISSION
    return lowest + (highest - lowest) * priority


def ramp_down(x: float, low: float, high: float, p_max: float = 1.0, p_min: float = 0.0) -> float:
    """`p_max` below `low`, `p_min` above `high`, linear between."""
    if x <= low:
        return p_max
    if x >= high:
        return p_min
    return p_max - (p_max - p_min) * (x - low) / (high - low)
