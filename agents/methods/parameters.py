"""The types of the parameters of SLAM, and what counts as a jump of the odometry."""

from __future__ import annotations

from typing import Annotated, Final

from msgspec import Meta

# A zero would divide, or end nothing.
Positive = Annotated[float, Meta(gt=0, lt=1e6)]
Count = Annotated[int, Meta(gt=0, lt=1_000_000)]

LEAP_M: Final = 3.0
"""Odometry has jumped if it moves farther than this between two readings, m,"""

LEAP_M_S: Final = 10.0
"""and faster than this, m/s."""
