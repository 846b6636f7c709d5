"""The cells of a map that nobody has seen, as an array."""

from __future__ import annotations

import zlib
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armadico.config.worlds import Unseen

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]

MOST_REACH = 100
"""Most cells of a distance whose square, with the sums that are compared, fits in 16 bits."""


def packed(
    mask: Mask, cell_m: float, origin: tuple[float, float, float], *, refused: bool
) -> Unseen | None:
    """The unseen cells of a map, bottom row first; None if all are seen."""
    if not mask.any():
        return None
    x, y, theta = origin
    rows, columns = mask.shape
    bits = zlib.compress(np.packbits(mask).tobytes())
    return Unseen(x, y, theta, cell_m, rows, columns, bits, refused)


@lru_cache(maxsize=4)
def cells(unseen: Unseen) -> Mask:
    """Which cells are unseen, (rows, columns), bottom row first."""
    count = unseen.rows * unseen.columns
    bits = np.frombuffer(zlib.decompress(unseen.packed), dtype=np.uint8)
    mask: Mask = np.unpackbits(bits, count=count).astype(np.bool_)
    return mask.reshape(unseen.rows, unseen.columns)


def over(unseen: Unseen, xs: Floats, ys: Floats, cell_m: float) -> Mask:
    """Which cells of another grid contain an unseen one, (ys, xs).

    `xs` and `ys` are the centres of its columns and rows, m. True also for cells outside the map,
    as in the corners around a turned one.
    """
    mask, found = cells(unseen), np.zeros((len(ys), len(xs)), dtype=np.bool_)
    times = max(1, int(np.ceil(cell_m / unseen.cell_m - 1e-6)))  # samples, for finer maps
    off = ((np.arange(times) + 0.5) / times - 0.5) * cell_m
    for dx in off:
        for dy in off:
            x, y = (xs + dx - unseen.x)[None, :], (ys + dy - unseen.y)[:, None]
            if unseen.theta:
                c, s = np.cos(unseen.theta), np.sin(unseen.theta)
                x, y = c * x + s * y, c * y - s * x
            columns, inside = _indices(x, unseen.cell_m, unseen.columns)
            rows, within = _indices(y, unseen.cell_m, unseen.rows)
            found |= mask[rows, columns] | ~(inside & within)
    return found


def _indices(along: Floats, cell_m: float, count: int) -> tuple[NDArray[np.intp], Mask]:
    """The indices of cells, and which of them are on the map."""
    found = np.floor(along / cell_m).astype(np.intp)
    return np.clip(found, 0, count - 1), (found >= 0) & (found < count)


def without_specks(mask: Mask) -> Mask:
    """The mask without what fits in two by two cells: scans leave such gaps between their rays."""
    padded = np.pad(mask, 3).astype(np.uint8)

    def doubled(counts: NDArray[np.uint8], off: int) -> NDArray[np.uint8]:
        """The counts of windows that are longer by `off` rows and columns."""
        tall = counts[:-off] + counts[off:]
        whole: NDArray[np.uint8] = tall[:, :-off] + tall[:, off:]
        return whole

    two = doubled(padded, 1)
    alone = doubled(two, 2) == two[1:-1, 1:-1]  # nothing in the ring around two by two cells
    speck = np.zeros(padded.shape, dtype=np.bool_)
    rows, columns = alone.shape
    for row in (1, 2):
        for column in (1, 2):
            speck[row : row + rows, column : column + columns] |= alone
    kept: Mask = mask & ~speck[3:-3, 3:-3]
    return kept


def distances(mask: Mask, cell_m: float, most_m: float) -> Floats:
    """The distance of each cell's centre from the nearest cell of a mask, at most `most_m`, m.

    It is 0 in the mask, and else measured to the border of the nearest cell's inscribed circle.
    """
    reach = int(np.ceil(most_m / cell_m)) + 1
    rows, columns = mask.shape
    index = np.arange(columns, dtype=np.int32)
    before = np.maximum.accumulate(np.where(mask, index, -2 * reach - columns), axis=1)
    after = np.minimum.accumulate(np.where(mask, index, 2 * reach + 2 * columns)[:, ::-1], axis=1)[
        :, ::-1
    ]
    near = np.minimum(np.minimum(index - before, after - index), 2 * reach)
    small = np.uint32 if reach > MOST_REACH else np.uint16
    along: NDArray[np.unsignedinteger] = (near * near).astype(small)
    square = along.copy()
    for off in range(1, min(reach, rows - 1) + 1):
        np.minimum(square[off:], along[:-off] + small(off * off), out=square[off:])
        np.minimum(square[:-off], along[off:] + small(off * off), out=square[:-off])
    away: Floats = np.sqrt(square, dtype=np.float64)
    away -= 0.5
    away *= cell_m
    return np.clip(away, 0.0, most_m, out=away)
