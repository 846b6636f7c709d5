"""Encodes and decodes the pose graph of a map for observers, in at most 40 kB."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armadico.mobile.messages import MapGraph
from armadico.mobile.particles import pack, unpack

KEY_SCANS: Final = 3000  # most key scans of a message; of more, each n-th one
LOOPS: Final = 3000  # most loops that count, likewise
LOOPS_OFF: Final = 1000  # most loops that are switched off, likewise

Pairs = NDArray[np.intp]


class Graph(NamedTuple):
    """A pose graph to draw."""

    places: NDArray[np.float64]  # (n, 2) of key scans, m, in the order of time
    loops: Pairs  # (m, 2) indices of places
    off: Pairs  # the same, of loops that are switched off


def message_of(
    revision: int, poses: ArrayLike, loops: ArrayLike, off: ArrayLike, uncertain: str = ""
) -> MapGraph:
    """Encode the graph of a map's revision.

    Poses (n, 3) are of the key scans: m, m, rad. Each loop joins those with two indices, (m, 2),
    and may be `off`, (m,). `uncertain` is why the map may be wrong.
    """
    scans = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    pairs = np.asarray(loops, dtype=np.intp).reshape(-1, 2)
    is_off = np.asarray(off, dtype=np.bool_).reshape(-1)
    every = -(-len(scans) // KEY_SCANS) or 1
    near = pairs // every
    return MapGraph(
        revision,
        *pack(scans[::every]),
        loops=_packed(near[~is_off], LOOPS),
        off=_packed(near[is_off], LOOPS_OFF),
        key_scans=len(scans),
        loops_found=len(pairs),
        loops_off=int(is_off.sum()),
        uncertain=uncertain,
    )


def graph_of(message: MapGraph) -> Graph:
    """Decode a graph. Raises ValueError if its bytes are none."""
    poses = unpack(message.x, message.y, message.step, message.packed)
    places = np.array(poses, dtype=np.float64).reshape(-1, 3)[:, :2]
    return Graph(places, _pairs(message.loops, len(places)), _pairs(message.off, len(places)))


def _packed(pairs: Pairs, most: int) -> bytes:
    every = -(-len(pairs) // most) or 1
    return pairs[::every].astype("<u2").tobytes()


def _pairs(packed: bytes, count: int) -> Pairs:
    if len(packed) % 4:
        raise ValueError(f"{len(packed)} bytes are no loops of four")
    pairs = np.frombuffer(packed, dtype="<u2").reshape(-1, 2).astype(np.intp)
    if len(pairs) and pairs.max() >= count:
        raise ValueError(f"a loop to key scan {pairs.max()} of {count}")
    return pairs
