"""The units of a controller like a Pioneer's."""

from __future__ import annotations

import math

from armadico.bridge.p2os.profile import P2osUnits

UNITS = P2osUnits(
    distance_mm=0.84,
    angle_rad=math.tau / 4096,
    velocity_mm=1.0,
    range_mm=0.268,
    vel2_mm=20.0,
    diff_conv=0.0056,
    name="Test",
    class_name="Pioneer",
    subclass="p2dx",
    cycle_s=0.1,
    watchdog_s=2.0,
)
