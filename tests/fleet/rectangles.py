"""The map of a union of rectangles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

Rectangle = tuple[float, float, float, float]
"""x1, y1, x2, y2 of free ground, m."""


def map_of(free: Sequence[Rectangle]) -> str:
    """The borders of the union of rectangles, as the text of an ARIA map."""
    xs = sorted({x for r in free for x in r[::2]})
    ys = sorted({y for r in free for y in r[1::2]})

    def covered(x: float, y: float) -> bool:
        return any(x1 < x < x2 and y1 < y < y2 for x1, y1, x2, y2 in free)

    def borders(at: float, among: Sequence[float], middle: Callable[[float], bool]) -> bool:
        """Whether a coordinate separates covered from uncovered ground."""
        k = among.index(at)
        sides = [among[k - 1 : k + 1], among[k : k + 2]]
        low, high = (len(side) == 2 and middle(sum(side) / 2) for side in sides)
        return low != high

    lines = [
        (x, a, x, b)
        for x in xs
        for a, b in pairwise(ys)
        if borders(x, xs, lambda at, y=(a + b) / 2: covered(at, y))  # type: ignore[misc]
    ]
    lines += [
        (a, y, b, y)
        for y in ys
        for a, b in pairwise(xs)
        if borders(y, ys, lambda at, x=(a + b) / 2: covered(x, at))  # type: ignore[misc]
    ]
    head = ["2D-Map", "LineMinPos: 0 0", f"LineMaxPos: {_mm(xs[-1])} {_mm(ys[-1])}"]
    body = [" ".join(_mm(end) for end in line) for line in lines]
    return "\n".join([*head, f"NumLines: {len(lines)}", "LINES", *body, "DATA", ""])


def _mm(metres: float) -> str:
    return str(round(1000 * metres))
