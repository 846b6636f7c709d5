"""The standard status packet (SIP, types 32 and 33): the robot's state, ten times per second.

`Status` has SI units and REP-103 frames; the controller's units are used only in this file. The
odometry is the controller's own, wrapped: `odometry.Odometry` makes it continuous.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from msgspec import Struct

from armadico.bridge.p2os.profile import P2osUnits

STOPPED, MOVING = 0x32, 0x33
STATUS_TYPES = (STOPPED, MOVING)

MOTORS_ENABLED = 0x0001
SONAR_ARRAYS = 0x001E  # one bit for each of the four arrays
STOP_BUTTON = 0x0020
CHARGING = 0x0400  # the charger's power is good

POSITION_COUNTS = 32768  # XPOS and YPOS have fifteen bits
TURN_UNITS = 4096  # THPOS and CONTROL, one turn

_HEAD = struct.Struct("<BHHhhhBBBhHBB")  # type to the number of sonar readings
_ECHO = struct.Struct("<BH")
_TAIL = struct.Struct("<BBBBB")  # gripper, analogue port, analogue, digital in, digital out
_LATER = struct.Struct("<Hbh")  # of ARCOS and AROS: battery, charge state, turn rate
CHARGES = (1, 2, 3, 4)  # bulk, over, float, balance; 0 no, -1 unknown
_TENTH_DEGREE = math.radians(0.1)
SHORTEST = _HEAD.size
_STALL = 0x01
_BUMPERS = 0x3E


class Status(Struct, frozen=True, kw_only=True):
    """One status packet. Lengths in m, angles in rad, speeds of the wheel rims in m/s."""

    x_m: float  # wraps: 0 to 32768 counts (27.5 m on a Pioneer 2DX)
    y_m: float
    theta_rad: float  # -pi to pi
    left_m_s: float
    right_m_s: float
    battery_v: float
    moving: bool = False
    left_stall: bool = False
    right_stall: bool = False
    motors_enabled: bool = False
    sonar_arrays: int = 0  # bits 0 to 3: array 1 to 4 is on
    stop_button: bool = False
    charging: bool = False
    flags: int = 0  # as sent, including the flags named here
    front_bumpers: int = 0  # one bit each
    rear_bumpers: int = 0
    control_rad: float = 0.0  # set point of the heading servo
    compass_rad: float = 0.0
    turning_rad_s: float = 0.0  # as the controller reports it; 0 in the short form
    echoes: tuple[tuple[int, float], ...] = ()  # sonar index, range in m; no echo is the maximum
    digital_in: int = 0
    digital_out: int = 0


def encode_status(status: Status, units: P2osUnits, *, short: bool = False) -> bytes:
    """Encode a payload: of ARCOS, up to the turn rate, or in the short form of P2OS.

    Clients of P2OS decode no more than the short form; those of ARCOS may need the rest.
    """
    count_m = units.distance_mm * 1e-3
    speed_m = units.velocity_mm * 1e-3
    head = _HEAD.pack(
        MOVING if status.moving else STOPPED,
        round(status.x_m / count_m) % POSITION_COUNTS,
        round(status.y_m / count_m) % POSITION_COUNTS,
        _angle_units(status.theta_rad, units),
        _limited(status.left_m_s / speed_m),
        _limited(status.right_m_s / speed_m),
        min(max(round(status.battery_v * 10), 0), 255),
        status.left_stall | status.rear_bumpers << 1 & _BUMPERS,
        status.right_stall | status.front_bumpers << 1 & _BUMPERS,
        _angle_units(status.control_rad, units),
        _flags(status),
        round(math.degrees(status.compass_rad) % 360 / 2) % 180,
        len(status.echoes),
    )
    tail = _TAIL.pack(0, 0, 0, status.digital_in, status.digital_out)
    payload = head + _encode_echoes(status.echoes, units.range_mm * 1e-3) + tail
    if short:
        return payload
    turning = _limited(status.turning_rad_s / _TENTH_DEGREE)
    decivolts = min(max(round(status.battery_v * 10), 0), 0xFFFF)
    return payload + _LATER.pack(decivolts, int(status.charging), turning)


def decode_status(payload: bytes, units: P2osUnits) -> Status:
    """Decode a payload. Raises ValueError if it is of another type or truncated.

    Everything behind the sonar readings is optional: later controllers append fields, some omit
    even the last ones of the short form.
    """
    if len(payload) < SHORTEST or payload[0] not in STATUS_TYPES:
        raise ValueError(f"not a status packet: {payload[:SHORTEST].hex(' ')}")
    kind, x, y, theta, left, right, battery, rear, front, control, flags, compass, count = (
        _HEAD.unpack_from(payload)
    )
    end = SHORTEST + _ECHO.size * count
    if len(payload) < end:
        raise ValueError(f"{count} sonar readings do not fit in {len(payload)} bytes")
    tail = payload[end : end + _TAIL.size].ljust(_TAIL.size, b"\0")
    later = payload[end + _TAIL.size :][: _LATER.size].ljust(_LATER.size, b"\0")
    decivolts, charge, turning = _LATER.unpack(later)
    count_m = units.distance_mm * 1e-3
    speed_m = units.velocity_mm * 1e-3
    return Status(
        x_m=x % POSITION_COUNTS * count_m,
        y_m=y % POSITION_COUNTS * count_m,
        theta_rad=_wrap_units(theta) * units.angle_rad,
        left_m_s=left * speed_m,
        right_m_s=right * speed_m,
        battery_v=(decivolts or battery) / 10,
        moving=kind == MOVING,
        left_stall=bool(rear & _STALL),
        right_stall=bool(front & _STALL),
        motors_enabled=bool(flags & MOTORS_ENABLED),
        sonar_arrays=(flags & SONAR_ARRAYS) >> 1,
        stop_button=bool(flags & STOP_BUTTON),
        charging=bool(flags & CHARGING) or charge in CHARGES,
        flags=flags,
        front_bumpers=(front & _BUMPERS) >> 1,
        rear_bumpers=(rear & _BUMPERS) >> 1,
        control_rad=_wrap_units(control) * units.angle_rad,
        compass_rad=math.radians(compass * 2),
        turning_rad_s=turning * _TENTH_DEGREE,
        echoes=_decode_echoes(payload[SHORTEST:end], units.range_mm * 1e-3),
        digital_in=tail[3],
        digital_out=tail[4],
    )


def _flags(status: Status) -> int:
    named = MOTORS_ENABLED | SONAR_ARRAYS | STOP_BUTTON | CHARGING
    return (
        status.flags & ~named & 0xFFFF
        | status.motors_enabled * MOTORS_ENABLED
        | status.sonar_arrays << 1 & SONAR_ARRAYS
        | status.stop_button * STOP_BUTTON
        | status.charging * CHARGING
    )


def _encode_echoes(echoes: Sequence[tuple[int, float]], unit_m: float) -> bytes:
    pack = _ECHO.pack
    return b"".join(
        [pack(index, min(max(round(range_m / unit_m), 0), 0xFFFF)) for index, range_m in echoes]
    )


def _decode_echoes(data: bytes, unit_m: float) -> tuple[tuple[int, float], ...]:
    return tuple((index, count * unit_m) for index, count in _ECHO.iter_unpack(data))


def _angle_units(angle_rad: float, units: P2osUnits) -> int:
    return _wrap_units(round(angle_rad / units.angle_rad))


def _wrap_units(count: int) -> int:
    """Wrap an angle to -2048 to 2047; some controllers count 0 to 4095."""
    return (count + TURN_UNITS // 2) % TURN_UNITS - TURN_UNITS // 2


def _limited(value: float) -> int:
    return min(max(round(value), -0x8000), 0x7FFF)
