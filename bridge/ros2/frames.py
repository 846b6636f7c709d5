"""Frames of (topic, CDR payload), in both directions of a line to a ROS 2 robot; sans-IO.

A frame is `MAGIC`, the length of the topic's name (2 bytes) and of the payload (4), a check of the
head (2), the CRC-32 of name and payload (4), then these two. Numbers are little-endian. So a stream
of bytes in memory, over TCP or a pty carries what a robot publishes and receives. With DDS or
Zenoh, the transport turns samples into frames and back.

Topic names are those of the robot's profile, below the robot's namespace. Names that begin with
`@`, which ROS 2 does not allow, are the line's own messages (`Wants`, `Seen`), as JSON.
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
"""Most bytes of a payload: a scan of 2048 rays with intensities has 16 kB."""

LONGEST = 255
"""Most bytes of a topic's name."""

QUIET_S = 0.5
"""A frame that is incomplete for this long is discarded."""

_HEAD = struct.Struct("<4sHIHI")
_CHECKED = 10  # bytes of the head that its check covers

WANTS, SEEN = "@wants", "@seen"

Frame = tuple[str, bytes]
"""A topic's name and a payload."""


def frame(topic: str, payload: bytes) -> bytes:
    """A whole frame. Raises ValueError if the name or the payload is too long."""
    name = topic.encode()
    if not 0 < len(name) <= LONGEST:
        raise ValueError(f"a topic's name has 1 to {LONGEST} bytes, this one {len(name)}")
    if len(payload) > LARGEST:
        raise ValueError(f"a payload has up to {LARGEST} bytes, this one {len(payload)}")
    check = crc32(payload, crc32(name))
    head = struct.pack("<4sHI", MAGIC, len(name), len(payload))
    return b"".join((head, struct.pack("<HI", crc32(head) & 0xFFFF, check), name, payload))


class Decoder(Framing[Frame]):
    """Decodes the valid frames of a stream."""

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


# The line's own messages --------------------------------------------------------------------------


class Wanted(Struct, frozen=True):
    """One topic that the robot agent reads or writes."""

    topic: str  # as in the profile: below the namespace, unless it begins with a slash
    type: str  # as ROS 2 writes it: nav_msgs/msg/Odometry
    writes: bool = False
    reliable: bool = True
    latched: bool = False
    depth: int = 10


class Wants(Struct, frozen=True):
    """From the robot agent, first on an open line: the topics that it reads and writes."""

    topics: tuple[Wanted, ...] = ()


_Name = Annotated[str, Meta(max_length=500)]
_Names = Annotated[tuple[_Name, ...], Meta(max_length=100)]


class Seen(Struct, frozen=True):
    """To the robot agent, when it changes and as far as the line can know: the nodes present."""

    robot: _Name = ""  # the node that publishes the odometry
    drivers: _Names = ()  # other nodes that publish commands
    notes: _Names = ()  # what does not match, and what is present instead
    several: bool = False  # several nodes publish the odometry, and would obey
    unread: str = ""  # why no node reads the commands that are published here


_T = TypeVar("_T")


def control_frame(what: Wants | Seen) -> bytes:
    """The frame of one of the line's own messages."""
    return frame(WANTS if isinstance(what, Wants) else SEEN, msgspec.json.encode(what))


def read(payload: bytes, kind: type[_T]) -> _T:
    """Decode one of the line's own messages. Raises ValueError."""
    return msgspec.json.decode(payload, type=kind)
