"""CONFIGpac (type 20) and ENCODERpac (type 90): a controller's answers to queries.

A CONFIGpac is requested but never required, since some real robots send it with a bad checksum, and
its contents are not used: the simulated controller sends one for other clients.
"""

from __future__ import annotations

import math
import struct
from typing import Any

from msgspec import Struct

CONFIG, ENCODER = 0x20, 0x90

_MILLI = 1e-3
_DECI = 0.1
_DEGREE = math.pi / 180

# Fields in their order on the wire: attribute ("" if unused), format (s: text that ends in NUL), SI
# value of one unit. Fields that newer controllers add behind the version are ignored.
FIELDS: tuple[tuple[str, str, float], ...] = (
    ("class_name", "s", 1),
    ("subclass", "s", 1),
    ("serial_number", "s", 1),
    ("", "B", 1),  # four motors
    ("w_top", "H", _DEGREE),
    ("v_top", "H", _MILLI),
    ("w_accel_top", "H", _DEGREE),
    ("v_accel_top", "H", _MILLI),
    ("pwm_max", "H", 1),
    ("name", "s", 1),
    ("cycle_s", "B", _MILLI),
    ("host_baud", "B", 1),
    ("", "B", 1),  # auxiliary port's baud rate
    ("", "H", 1),  # gripper
    ("front_sonar", "H", 1),
    ("rear_sonar", "B", 1),
    ("low_battery_v", "H", _DECI),
    ("", "H", 1),  # encoder counts a revolution
    ("watchdog_s", "H", _MILLI),
    ("", "B", 1),  # alternative status packet
    ("stall_pwm", "H", 1),
    ("stall_s", "H", _MILLI),
    ("", "H", 1),  # joystick, linear
    ("", "H", 1),  # joystick, angular
    ("w_max", "H", _DEGREE),
    ("v_max", "H", _MILLI),
    ("w_accel", "H", _DEGREE),
    ("w_decel", "H", _DEGREE),
    ("", "H", 1),  # gains of the rotation loop: proportional, derivative, integral
    ("", "H", 1),
    ("", "H", 1),
    ("v_accel", "H", _MILLI),
    ("v_decel", "H", _MILLI),
    ("", "H", 1),  # gains of the translation loop
    ("", "H", 1),
    ("", "H", 1),
    ("front_bumpers", "B", 1),
    ("rear_bumpers", "B", 1),
    ("", "B", 1),  # charger
    ("sonar_period_s", "B", _MILLI),
    ("auto_baud", "B", 1),  # 2: the client may request a faster line
    ("", "B", 1),  # gyroscope
    ("", "h", 1),  # drift factor
    ("", "B", 1),  # auxiliary ports' baud rates
    ("", "B", 1),
    ("", "H", 1),  # ticks a millimetre
    ("", "H", 1),  # shutdown voltage
    ("version", "s", 1),
)
TEXT_LIMIT = 19  # clients copy each name into twenty bytes, the NUL included


class Configuration(Struct, frozen=True, kw_only=True):
    """A controller's report of itself. SI units; 0 where it reports nothing.

    `top` is its greatest possible value, `max` the limit in force.
    """

    class_name: str = ""
    subclass: str = ""
    serial_number: str = ""
    name: str = ""
    version: str = ""
    v_top: float = 0  # m/s
    w_top: float = 0  # rad/s
    v_accel_top: float = 0  # m/s^2
    w_accel_top: float = 0  # rad/s^2
    v_max: float = 0  # m/s
    w_max: float = 0  # rad/s
    v_accel: float = 0  # m/s^2
    v_decel: float = 0  # m/s^2
    w_accel: float = 0  # rad/s^2
    w_decel: float = 0  # rad/s^2
    pwm_max: int = 0
    stall_pwm: int = 0  # of pwm_max: held wheels above this are stalled
    stall_s: float = 0  # time for which their motors are off then
    cycle_s: float = 0
    watchdog_s: float = 0
    low_battery_v: float = 0
    front_sonar: int = 0  # whether the ring exists
    rear_sonar: int = 0
    front_bumpers: int = 0
    rear_bumpers: int = 0
    sonar_period_s: float = 0
    host_baud: int = 0
    auto_baud: int = 0


class Encoders(Struct, frozen=True):
    """Raw counts of the wheel encoders, 32 bits each."""

    left: int
    right: int


def encode_configuration(configuration: Configuration) -> bytes:
    """Encode a CONFIGpac's payload, up to the firmware's version."""
    parts = [bytes([CONFIG])]
    for attribute, form, unit in FIELDS:
        value: Any = getattr(configuration, attribute) if attribute else 0
        parts.append(encode_text(value) if form == "s" else _pack(form, value / unit))
    return b"".join(parts)


def encode_encoders(encoders: Encoders) -> bytes:
    """Encode an ENCODERpac's payload; counts wrap at 32 bits."""
    left, right = encoders.left & 0xFFFFFFFF, encoders.right & 0xFFFFFFFF
    return struct.pack("<BII", ENCODER, left, right)


def encode_text(text: str) -> bytes:
    """Text that ends in NUL, cut to the clients' limit."""
    return text.encode("ascii", "replace")[:TEXT_LIMIT] + b"\0"


def decode_texts(data: bytes, count: int) -> tuple[str, ...]:
    """Decode up to `count` texts that end in NUL; missing ones are empty."""
    texts = data.split(b"\0")[:count]
    return tuple(text.decode("ascii", "replace") for text in texts) + ("",) * (count - len(texts))


def _pack(form: str, value: float) -> bytes:
    """Pack an unsigned field, clipped to its range."""
    highest = 2 ** (8 * struct.calcsize(form)) - 1
    return struct.pack(f"<{form}", min(max(round(value), 0), highest))
