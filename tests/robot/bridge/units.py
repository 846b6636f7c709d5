"""The units of a controller like a Pioneer's, and what it reports of itself."""

from __future__ import annotations

import math
import struct
from typing import Any

from armadico.bridge.p2os.configuration import CONFIG, FIELDS, Configuration
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


def decode_configuration(payload: bytes) -> Configuration:
    """Decode a CONFIGpac's payload, as other clients do."""
    assert payload[0] == CONFIG
    found: dict[str, Any] = {}
    data = payload[1:]
    for attribute, form, unit in FIELDS:
        if form == "s":
            text, _, data = data.partition(b"\0")
            found[attribute] = text.decode("ascii")
        else:
            size = struct.calcsize(form)
            found[attribute] = int.from_bytes(data[:size], "little") * unit
            data = data[size:]
    found.pop("")
    return Configuration(**found)
