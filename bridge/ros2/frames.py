"""Frames of (topic, CDR payload): what crosses a line to a ROS 2 robot, both ways; sans-IO.

A frame is `MAGIC`, the length of the topic's name (2 bytes) and of the payload (4), two bytes of
the head's own check, the CRC-32 of name and payload, then those two. All numbers little-endian. So
one line of bytes, in memory, over TCP or a pty, carries what a robot publishes and obeys; where DDS
or Zenoh carry it, their transport turns samples into frames and back.

A topic's name is as the robot's profile has it, below the robot's namespace. Names that begin with
`@`, which ROS 2 has not, are the line's own (`Wants`, `Seen`): JSON.
"""

from __future__ import annotations

import struct
from typing import Annotated, TypeVar
from zlib import crc32

import msgspec
from msgspec import Meta, Struct

from armadico.bridge.framing import Framing

MAGIC = b"\xf5R2\x01"
LARGEST = 262_144
"""Bytes of a payload: a scan of 2048 rays with intensities has 16 kB."""

LONGEST = 255
"""Bytes of a topic's name."""

QUIET_S = 0.5
"""A frame broken off for this long is given up."""

_HEAD = struct.Struct("<4sHIHI")
_CHECKED = 10  # of the head, by its own check

WANTS, SEEN = "@wants", "@seen"

Frame = tuple[str, bytes]
"""A topic's name and what was said there."""


def frame(topic: str, payload: bytes) -> bytes:
    """A whole frame. Raises ValueError for what is too long."""
    name = topic.encode()
    if not 0 < len(name) <= LONGEST:
        raise ValueError(f"a topic's name has 1 to {LONGEST} bytes, this one {len(name)}")
    if len(payload) > LARGEST:
        raise ValueError(f"a payload has up to {LARGEST} bytes, this one {len(payload)}")
    check = crc32(payload, crc32(name))
    head = struct.pack("<4sHI", MAGIC, len(name), len(payload))
    return b"".join((head, struct.pack("<HI", crc32(head) & 0xFFFF, check), name, payload))


class Decoder(Framing[Frame]):
    """The good frames of a stream."""

    def __init__(self) -> None:
        super().__init__(MAGIC, _HEAD.size, QUIET_S)

    def _next(self) -> Frame | None:
        buffer = self._buffer
        while self._find():
            _, named, length, check, whole = _HEAD.unpack_from(buffer)
            sound = crc32(buffer[:_CHECKED]) & 0xFFFF == check
            if sound and 0 < named <= LONGEST and length <= LARGEST:
                end = _HEAD.size + named + length
                if len(buffer) < end:
                    return None
                body = bytes(buffer[_HEAD.size : end])
                if crc32(body) == whole:
                    del buffer[:end]
                    topic = body[:named].decode(errors="replace")
                    return topic, body[named:]
            self.mangled += 1
            self._drop(len(MAGIC))
        return None


# The line's own -----------------------------------------------------------------------------------


class Wanted(Struct, frozen=True):
    """One topic that the robot agent reads or writes."""

    topic: str  # as in the profile: below the namespace, unless it begins with a slash
    type: str  # as ROS 2 writes it: nav_msgs/msg/Odometry
    writes: bool = False
    reliable: bool = True
    latched: bool = False
    depth: int = 10


class Wants(Struct, frozen=True):
    """From the robot agent, first of all after the line was opened: what it reads and writes."""

    topics: tuple[Wanted, ...] = ()


_Name = Annotated[str, Meta(max_length=500)]
_Names = Annotated[tuple[_Name, ...], Meta(max_length=100)]


class Seen(Struct, frozen=True):
    """To the robot agent, whenever it changes, as far as the line can tell: who is there."""

    robot: _Name = ""  # who publishes the odometry
    drivers: _Names = ()  # who else publishes commands
    notes: _Names = ()  # what does not match, and what is there instead
    several: bool = False  # more than one publishes the odometry, and would obey


_T = TypeVar("_T")


def said(what: Wants | Seen) -> bytes:
    """The frame of what the line itself has to say."""
    return frame(WANTS if isinstance(what, Wants) else SEEN, msgspec.json.encode(what))


def read(payload: bytes, kind: type[_T]) -> _T:
    """What the line itself said. Raises ValueError."""
    return msgspec.json.decode(payload, type=kind)
