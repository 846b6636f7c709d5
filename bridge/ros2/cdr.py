"""ROS 2 messages as bytes (CDR), and the names of their types on DDS and in rmw_zenoh.

Sources: OMG DDSI-RTPS 2.5, section 10 (CDR); REP-2011 and REP-2016 (type descriptions, RIHS01);
design.ros2.org, "Topic and Service name mapping to DDS".

`rosbags` 0.11.9 also has the types and their CDR, and decodes faster. It is not used:

- it adds 22 MB (SQLite, LZ4, Zstandard, YAML) to each robot's computer; pycdr2 has 0.7 MB;
- its messages have no defaults, which 130 places here use, and its constructors are unchecked;
- it rejects Humble's longer discovery messages and hashes `rmw_dds_common/Gid` differently from
  ROS 2, so both would need patches here.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

from pycdr2 import IdlStruct
from pycdr2._support import Buffer
from pycdr2.types import array, bounded_str, sequence

from armadico.bridge.ros2 import types

M = TypeVar("M", bound=IdlStruct)

_HEADER = 4
# The numbers of type_description_interfaces/msg/FieldType, by the type's name in `.msg` files.
_PRIMITIVES = {
    "int8": 2,
    "uint8": 3,
    "int32": 6,
    "uint32": 7,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
_NESTED, _BOUNDED_STRING = 1, 21
_ARRAY, _SEQUENCE = 48, 144


class _Bounded(Buffer):
    """A buffer that checks lengths: pycdr2's own loops 4e9 times for a false length."""

    def read_bytes(self, length: int) -> bytes:
        """Read bytes. pycdr2 passes -1 for a text of length 0, to step back over the final zero."""
        if self._pos + length > self._size:
            raise ValueError(f"a length of {length} bytes exceeds the message")
        return super().read_bytes(length)


def encode(message: IdlStruct) -> bytes:
    """Encode a message as little-endian CDR with its header.

    Raises ValueError if a field is of another type, or does not fit.
    """
    try:
        # A new buffer each time: pycdr2 shares one per type between threads.
        return message.serialize(buffer=Buffer())
    except Exception as error:  # pycdr2 raises whatever struct or its own code raises
        raise ValueError(f"{ros_name(type(message))} cannot be encoded: {_first(error)}") from error


def decode(kind: type[M], data: bytes) -> M:
    """Read a message from CDR. Raises ValueError if the bytes are not such a message."""
    # ROS 2 uses plain CDR only, in either byte order.
    if len(data) < _HEADER or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError(f"{len(data)} bytes are not CDR of {ros_name(kind)}")
    try:
        buffer = _Bounded(data, align_offset=_HEADER)
        return kind.deserialize(cast("Any", buffer))  # it accepts buffers; its annotation does not
    except Exception as error:  # struct.error, UnicodeDecodeError, and pycdr2's own
        raise ValueError(
            f"{len(data)} bytes are not a {ros_name(kind)}: {_first(error)}"
        ) from error


def ros_name(kind: type[IdlStruct]) -> str:
    """The type's name in ROS 2: `sensor_msgs/msg/LaserScan`."""
    return str(kind.__idl_typename__)


def dds_name(kind: type[IdlStruct]) -> str:
    """The type's name on DDS and in keys of rmw_zenoh: `sensor_msgs::msg::dds_::LaserScan_`."""
    package, _, name = ros_name(kind).split("/")
    return f"{package}::msg::dds_::{name}_"


def from_dds_name(name: str) -> str:
    """Turn a DDS type name into that of ROS 2; other names are returned unchanged."""
    parts = name.split("::")
    if len(parts) == 4 and parts[2] == "dds_" and parts[3].endswith("_"):
        return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
    return name


@functools.cache
def type_hash(kind: type[IdlStruct]) -> str:
    """The type's hash by REP-2016, `RIHS01_` and 64 hexadecimal digits."""
    others = sorted(_referenced(kind), key=ros_name)
    described = {
        "type_description": _described(kind),
        "referenced_type_descriptions": [_described(other) for other in others],
    }
    text = json.dumps(described, separators=(", ", ": "), ensure_ascii=True)
    return "RIHS01_" + hashlib.sha256(text.encode()).hexdigest()


@functools.cache
def definition(kind: type[IdlStruct]) -> str:
    """The type as `.msg` text; nested types follow lines of 80 `=` (rosbag2's `ros2msg`)."""
    texts = [_msg(kind)]
    for other in sorted(_referenced(kind), key=ros_name):
        package, _, name = ros_name(other).split("/")
        texts.append(f"{'=' * 80}\nMSG: {package}/{name}\n{_msg(other)}")
    return "".join(texts)


@functools.cache
def known() -> dict[str, type[IdlStruct]]:
    """The types of `types`, by their ROS 2 names."""
    found = (value for value in vars(types).values() if isinstance(value, type))
    return {
        ros_name(kind): kind
        for kind in found
        if issubclass(kind, IdlStruct) and kind is not IdlStruct
    }


def _first(error: Exception) -> str:
    """The innermost cause: pycdr2 wraps each field's error in one with all its values."""
    cause: BaseException = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    return str(cause)[:200] or type(cause).__name__


def _fields(kind: type[IdlStruct]) -> list[tuple[str, Any, int, int]]:
    """Name, element (a `.msg` type name or a class), offset of its type number, and capacity.

    A field's metadata may have another `.msg` type under `msg`: CDR has no `byte`.
    """
    hints = get_type_hints(kind, include_extras=True)
    found = []
    for each in dataclasses.fields(cast("Any", kind)):
        element, shape, capacity = _shape(hints[each.name])
        found.append((each.name, each.metadata.get("msg", element), shape, capacity))
    return found


def _shape(hint: Any) -> tuple[Any, int, int]:
    if get_origin(hint) is not Annotated:
        names = {str: "string", bool: "bool"}
        return names.get(hint, hint), 0, 0
    mark = get_args(hint)[1]
    if isinstance(mark, array):
        return _shape(mark.subtype)[0], _ARRAY, mark.length
    if isinstance(mark, sequence):
        return _shape(mark.subtype)[0], _SEQUENCE, 0
    return mark, 0, 0


def _referenced(kind: type[IdlStruct]) -> set[type[IdlStruct]]:
    nested = {e for _, e, _, _ in _fields(kind) if isinstance(e, type)}
    return nested.union(*(_referenced(each) for each in nested))


def _described(kind: type[IdlStruct]) -> dict[str, object]:
    fields = []
    for name, element, shape, capacity in _fields(kind):
        text, nested = 0, ""
        if isinstance(element, type):
            number, nested = _NESTED, ros_name(element)
        elif isinstance(element, bounded_str):
            number, text = _BOUNDED_STRING, element.max_length
        else:
            number = _PRIMITIVES[element]
        fields.append(
            {
                "name": name,
                "type": {
                    "type_id": number + shape,
                    "capacity": capacity,
                    "string_capacity": text,
                    "nested_type_name": nested,
                },
            }
        )
    return {"type_name": ros_name(kind), "fields": fields}


def _msg(kind: type[IdlStruct]) -> str:
    lines = []
    for name, element, shape, capacity in _fields(kind):
        if isinstance(element, type):
            word = ros_name(element).replace("/msg/", "/")
        elif isinstance(element, bounded_str):
            word = f"string<={element.max_length}"
        else:
            word = element
        length = {0: "", _ARRAY: f"[{capacity}]", _SEQUENCE: "[]"}[shape]
        lines.append(f"{word}{length} {name}\n")
    return "".join(lines)
