"""P2OS commands, from the client to the robot: one table, and the coding of their arguments.

A command's payload is its number and, if it has an argument, the argument's type and value, low
byte first. A negative integer is sent as type 1B with its absolute value, not in two's complement.
"""

from __future__ import annotations

import math
from enum import Enum, IntEnum

from msgspec import Struct

from armadico.bridge.p2os.packets import encode

POSITIVE, NEGATIVE, STRING = 0x3B, 0x1B, 0x2B  # types of argument

MM = 1e-3
DEGREE = math.pi / 180
DECIVOLT = 0.1


class Arg(Enum):
    NONE = "none"  # clients may send a dummy integer
    INT = "int"  # signed
    BITS = "bits"  # sixteen raw bits, often two independent bytes
    TEXT = "text"  # counted bytes
    POSE = "pose"  # three 32-bit integers


class Cmd(IntEnum):
    """The commands: number, kind of argument, SI value of one unit, meaning."""

    argument: Arg
    si: float
    meaning: str

    def __new__(cls, number: int, argument: Arg, si: float, meaning: str) -> Cmd:
        """Make a member whose value is the number alone."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.argument, member.si, member.meaning = argument, si, meaning
        return member

    PULSE = 0, Arg.NONE, 1, "feed the watchdog, no more; also SYNC0"
    OPEN = 1, Arg.NONE, 1, "start the status packets; also SYNC1"
    CLOSE = 2, Arg.NONE, 1, "stop, motors and sonar off, end the session; also SYNC2"
    POLLING = 3, Arg.TEXT, 1, "sonar firing order: sonar numbers plus one; empty is off"
    ENABLE = 4, Arg.INT, 1, "motors on (1) or off (0)"
    SETA = 5, Arg.INT, MM, "linear acceleration, or if negative deceleration, mm/s^2"
    SETV = 6, Arg.INT, MM, "top linear speed, mm/s"
    SETO = 7, Arg.NONE, 1, "odometry to 0, 0, 0"
    MOVE = 8, Arg.INT, MM, "drive a distance, mm"
    ROTATE = 9, Arg.INT, DEGREE, "as RVEL"
    SETRV = 10, Arg.INT, DEGREE, "top angular speed, degrees/s"
    VEL = 11, Arg.INT, MM, "linear speed, forward positive, mm/s"
    HEAD = 12, Arg.INT, DEGREE, "turn to an absolute heading of the odometry, degrees"
    DHEAD = 13, Arg.INT, DEGREE, "turn relative to the heading, degrees"
    SAY = 15, Arg.TEXT, 1, "beep: pairs of duration (20 ms) and tone"
    CONFIG = 18, Arg.INT, 1, "send one CONFIGpac"
    ENCODER = 19, Arg.INT, 1, "ENCODERpacs: none (0), one (1), one each status packet (2)"
    RVEL = 21, Arg.INT, DEGREE, "angular speed, counter-clockwise positive, degrees/s"
    DCHEAD = 22, Arg.INT, DEGREE, "turn relative to the last heading requested, degrees"
    SETRA = 23, Arg.INT, DEGREE, "angular acceleration, or if negative deceleration, degrees/s^2"
    SONAR = 28, Arg.INT, 1, "bit 0 on or off; the bits above name one array, 0 all"
    STOP = 29, Arg.NONE, 1, "stop, motors stay on"
    DIGOUT = 30, Arg.BITS, 1, "digital outputs: high byte which, low byte values"
    VEL2 = 32, Arg.BITS, 1, "wheel speeds: high byte left, low byte right, signed, in 20 mm/s"
    HOSTBAUD = 50, Arg.INT, 1, "baud rate of the client's port: 0 9600, 2 38400, 4 115200"
    E_STOP = 55, Arg.NONE, 1, "stop without a ramp"
    SIM_SET_POSE = 224, Arg.POSE, 1, "simulators: true pose, mm, mm, degrees; odometry stays"
    BATTEST = 250, Arg.INT, DECIVOLT, "pretend a battery voltage, 0.1 V; 0 the real one"


COMMANDS = {int(cmd): cmd for cmd in Cmd}

SYNC0, SYNC1, SYNC2 = (encode(bytes([number])) for number in range(3))


class Command(Struct, frozen=True):
    """A received command, unknown numbers included; arguments in the table's units."""

    number: int
    value: int = 0
    data: bytes = b""  # TEXT and POSE

    @property
    def si(self) -> float:
        """The value in SI units (m, rad, s, V); only for commands of the table."""
        return self.value * COMMANDS[self.number].si

    @property
    def wheels(self) -> tuple[int, int]:
        """VEL2's bytes as (left, right), signed."""
        return _signed(self.value >> 8, 8), _signed(self.value & 0xFF, 8)

    @property
    def pose(self) -> tuple[float, float, float] | None:
        """SIM_SET_POSE's argument as x (m), y (m), theta (rad); None if it is truncated."""
        if len(self.data) < 12:
            return None
        words = (self.data[i : i + 4] for i in (0, 4, 8))
        x, y, theta = (int.from_bytes(word, "little", signed=True) for word in words)
        return x * MM, y * MM, theta * DEGREE


def command(cmd: Cmd, value: int | bytes | None = None) -> bytes:
    """Encode a whole packet; integers in the table's units.

    Without a value the bare number is sent, which is legal for commands of kind `Arg.NONE` only.
    """
    if value is None:
        if cmd.argument is not Arg.NONE:
            raise ValueError(f"{cmd.name} needs an argument: {cmd.meaning}")
        return encode(bytes([cmd]))
    if isinstance(value, bytes):
        return encode(bytes([cmd, STRING, len(value)]) + value)
    return encode(bytes([cmd]) + _integer(cmd, value))


def quantity(cmd: Cmd, value: float) -> bytes:
    """Encode a whole packet from an argument in SI units, rounded to the table's."""
    return command(cmd, round(value / cmd.si))


def set_pose(x: float, y: float, theta: float) -> bytes:
    """Encode SIM_SET_POSE for a pose in m, m, rad."""
    numbers = round(x / MM), round(y / MM), round(theta / DEGREE)
    body = b"".join(number.to_bytes(4, "little", signed=True) for number in numbers)
    return encode(bytes([Cmd.SIM_SET_POSE, POSITIVE]) + body)


def decode_command(payload: bytes) -> Command:
    """Decode any payload of at least one byte: other clients' commands are not all well-formed.

    A missing argument reads as 0 (Player's SETO is `07 3B`). A superfluous one is decoded and does
    no harm (ARIA's OPEN is `01 3B 01 00`).
    """
    number = payload[0]
    kind = COMMANDS[number].argument if number in COMMANDS else Arg.INT
    argument = payload[2:]
    if kind is Arg.POSE:
        return Command(number, data=argument[:12])
    if payload[1:2] == bytes([STRING]):
        return Command(number, data=argument[1 : 1 + argument[0]] if argument else b"")
    bits = int.from_bytes(argument[:2], "little")
    negative = payload[1:2] == bytes([NEGATIVE])
    if kind is Arg.BITS:  # ARIA's VEL2 with a negative left wheel comes as 1B and absolute value
        return Command(number, -bits & 0xFFFF if negative else bits)
    return Command(number, -bits if negative else _signed(bits, 16))


def _integer(cmd: Cmd, value: int) -> bytes:
    """Argument type and value. 3B above 32767 would decode as negative, so only BITS may."""
    if cmd.argument is Arg.BITS:
        if not 0 <= value <= 0xFFFF:
            raise ValueError(f"{cmd.name} carries 0 to 65535, not {value}")
    elif abs(value) > 0x7FFF:
        raise ValueError(f"{cmd.name} carries -32767 to 32767, not {value}")
    return bytes([POSITIVE if value >= 0 else NEGATIVE]) + abs(value).to_bytes(2, "little")


def _signed(value: int, bits: int) -> int:
    return value - (1 << bits) if value >> bits - 1 else value
