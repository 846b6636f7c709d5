"""The arrays of an `.npz` file, also if the file is cut.

A cut archive has lost its directory, which is at the end. The members before the cut have headers
of their own and are read one after the other. Of the member in which the cut is, the whole rows
are read.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from io import BytesIO
from math import pi, prod
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

Array = NDArray[Any]

ROWS: Final = ("t", "odometry", "reference", "ranges")
"""Fields with a row for each scan."""

RAYS: Final = (180, 181, 360, 361)
"""Scanners with so many rays look 180 degrees ahead, as in CARMEN's FLASER."""

CENTIMETRES: Final = 0.01
"""Of ranges that are whole numbers, if their scale is lost, m."""

_LOCAL: Final = struct.Struct("<4s5H3L2H")  # the header of a member
_DEFLATED: Final = 8


class Fields(NamedTuple):
    """The arrays of a file."""

    arrays: dict[str, Array]
    lost: int = 0  # rows behind the cut
    notes: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()  # in place of what is lost


def fields_of(path: Path) -> Fields:
    """The arrays that can be read. Raises ValueError if there is none, OSError."""
    try:
        # numpy leaves a file open that it opened itself and cannot read.
        with path.open("rb") as raw, np.load(raw) as file:
            return Fields({name: file[name] for name in file.files})
    except (EOFError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        found = _members(path.read_bytes())
        if not found:
            raise ValueError(error) from None
    rows = {name: len(found[name]) for name in ROWS if name in found and found[name].ndim}
    count, most = min(rows.values(), default=0), max(rows.values(), default=0)
    found |= {name: found[name][:count] for name in rows}
    notes = (f"the file is cut: {count} of {most} rows are read",)
    return Fields(found, most - count, notes, _assume(found))


def _assume(found: dict[str, Array]) -> tuple[str, ...]:
    """Add what describes the ranges if it was behind the cut; what was assumed."""
    ranges, assumed = found.get("ranges"), []
    if ranges is None or ranges.ndim != 2:
        return ()
    if "scale" not in found and ranges.dtype.kind in "iu":
        found["scale"] = np.array(CENTIMETRES)
        assumed.append("the file is cut before 'scale': the ranges are taken as cm")
    rays = ranges.shape[1]
    if not {"angle_min", "angle_step"} <= {*found} and rays in RAYS:
        step = pi / (rays - 1 if rays % 2 else rays)
        found |= {"angle_min": np.array(-pi / 2), "angle_step": np.array(step)}
        assumed.append(
            "the file is cut before its angles: the scanner is taken to look 180 degrees"
        )
    return tuple(assumed)


def _members(data: bytes) -> dict[str, Array]:
    """The arrays of the members up to the cut; the last one may lack rows."""
    found: dict[str, Array] = {}
    at = 0
    while at + _LOCAL.size <= len(data):
        magic, _, flags, method, _, _, _, packed, _, name, extra = _LOCAL.unpack_from(data, at)
        if magic != b"PK\x03\x04" or flags & 0b1001:  # encrypted, or its size is behind it
            break
        begin = at + _LOCAL.size + name + extra
        title = data[at + _LOCAL.size :][:name].decode("utf-8", "replace")
        if packed == 0xFFFFFFFF:  # its size is in the extra field, behind the unpacked one
            fields = data[begin - extra : begin]
            packed = struct.unpack_from("<Q", fields, 12)[0] if len(fields) >= 20 else len(data)
        at = begin + packed
        content = data[begin:at]
        try:
            if method == _DEFLATED:
                content = zlib.decompressobj(-zlib.MAX_WBITS).decompress(content)
            found[title.removesuffix(".npy")] = _array(content)
        except (ValueError, zlib.error, EOFError):
            break
    return found


def _array(content: bytes) -> Array:
    """The array of a member, or its whole rows. Raises ValueError."""
    stream = BytesIO(content)
    version = npy.read_magic(stream)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.hasobject or (fortran and len(shape) > 1):
        raise ValueError("not an array of numbers by rows")
    body = content[stream.tell() :]
    size = dtype.itemsize * prod(shape)
    if len(body) >= size:
        return np.frombuffer(body[:size], dtype).reshape(shape)
    row = dtype.itemsize * prod(shape[1:])
    if not shape or not row:
        raise ValueError("no whole row")
    whole = len(body) // row
    return np.frombuffer(body[: whole * row], dtype).reshape(whole, *shape[1:])
