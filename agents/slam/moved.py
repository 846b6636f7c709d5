"""How a map has moved by an optimisation, in a message of bounded size."""

from __future__ import annotations

from typing import Final

import numpy as np

from armadico.agents.methods.poses import Floats, wrapped
from armadico.mobile.messages import MOVED, MapMoved, Moved

APART_M: Final = 1.0
"""Key scans nearer than this to each other are told by one of them, in a map that is small enough:
an optimisation moves neighbours alike."""


def map_moved(revision: int, before: Floats, after: Floats) -> MapMoved:
    """The message of a new revision, by the key scans' poses (n, 3) before and after it."""
    if not len(before):
        return MapMoved(revision)
    apart = APART_M
    while len(kept := _thinned(before, apart)) > MOVED:
        apart *= 2.0
    turns = wrapped(after[:, 2] - before[:, 2])
    columns = (before[kept, 0], before[kept, 1], after[kept, 0], after[kept, 1], turns[kept])
    return MapMoved(revision, tuple(Moved(*row) for row in np.column_stack(columns).tolist()))


def _thinned(poses: Floats, apart: float) -> list[int]:
    """The first pose in each cell of a grid, in order."""
    cells = np.floor(poses[:, :2] / apart).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return sorted(first.tolist())
