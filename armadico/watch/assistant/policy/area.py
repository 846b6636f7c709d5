"""Areas of the floor: unions of polygons, less others, and how far inside a place is. Sans-IO."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from math import hypot, inf
from typing import Final

from armadico.config.worlds import distance

Place = tuple[float, float]
"""x, y, m."""

Polygon = Sequence[Place]
"""Its corners, in either direction; the last side leads back to the first corner."""

Side = tuple[Place, Place]

LEAST_M2: Final = 0.01
"""A smaller polygon is an error: no robot fits in."""

BESIDE_M: Final = 1e-6
"""So far beside a side it is looked what is there."""

STEP_M: Final = 0.05
"""The place where a path leaves an area is named as exactly as this."""


class Area:
    """Where a robot may be: in one of the polygons, and in none of the others.

    Polygons may overlap or share sides: a border between two of them is none.
    """

    def __init__(self, inside: Sequence[Polygon], outside: Sequence[Polygon] = ()) -> None:
        """Without polygons in `inside` it is everywhere."""
        self._inside = [tuple(each) for each in inside]
        self._outside = [tuple(each) for each in outside]
        self._borders = [*_outline(self._inside), *(s for each in outside for s in _sides(each))]

    @property
    def everywhere(self) -> bool:
        return not self._borders

    def has(self, x: float, y: float) -> bool:
        """Whether a place belongs to it, with its border."""
        within = not self._inside or any(_has(each, x, y) for each in self._inside)
        return within and not any(_has(each, x, y) for each in self._outside)

    def margin(self, x: float, y: float) -> float:
        """The distance of a place from the border, m; negative outside; inf: there is none."""
        away = min((_distance((x, y), side) for side in self._borders), default=inf)
        return away if self.has(x, y) else -away

    def leaves(self, path: Sequence[Place], margin: float) -> Place | None:
        """The first place of a path that is nearer to the border than `margin`, m, or outside.

        None: the whole path keeps it. The sides of the path count, not only its corners.
        """
        if self.everywhere or not path:
            return None
        least = max(margin, BESIDE_M)  # a path across the border is at no distance from it
        bad = next((leg for leg in _legs(path) if not self._keeps(leg, least)), None)
        if bad is None:
            return None
        (ax, ay), (bx, by) = bad
        while hypot(bx - ax, by - ay) > STEP_M:
            x, y = (ax + bx) / 2, (ay + by) / 2
            if self._keeps(((ax, ay), (x, y)), least):
                ax, ay = x, y
            else:
                bx, by = x, y
        return min((ax, ay), (bx, by), key=lambda place: self.margin(*place))

    def _keeps(self, leg: Side, least: float) -> bool:
        """Whether all of a leg is inside, and nowhere nearer to the border than `least`, m."""
        return all(self.has(*place) for place in leg) and not any(
            _closer(leg, side, least) for side in self._borders
        )

    def near(self, path: Sequence[Place], margin: float) -> bool:
        """Whether a path comes nearer to it than `margin`, m, or crosses it."""
        least = max(margin, BESIDE_M)  # a path across the border is at no distance from it
        return any(self.has(*place) for place in path) or any(
            _closer(leg, side, least) for leg in _legs(path) for side in self._borders
        )


def away(place: Place, path: Sequence[Place]) -> float:
    """The distance of a place from a path, m; inf: the path has no places."""
    return min((_distance(place, leg) for leg in _legs(path)), default=inf)


def wrong_with(polygon: Polygon) -> str:
    """What is wrong with a polygon; "" if nothing is."""
    if len(polygon) < 3:
        return f"expected at least 3 corners, not {len(polygon)}"
    sides = list(_sides(polygon))
    for index, side in enumerate(sides):
        (x, y), to = side
        if side[0] == to:
            return f"expected corners that differ, not ({x:g}, {y:g}) twice in a row"
        for later in range(index + 1, len(sides)):
            beside = later == index + 1 or (index == 0 and later == len(sides) - 1)
            if _turns_back(side, sides[later]) if beside else _touch(side, sides[later]):
                return (
                    f"expected sides that do not cross, and those from ({x:g}, {y:g}) and"
                    f" ({sides[later][0][0]:g}, {sides[later][0][1]:g}) do"
                )
    if abs(_area(polygon)) < LEAST_M2:
        return f"expected at least {LEAST_M2:g} m2, not {abs(_area(polygon)):.2g}"
    return ""


def _sides(polygon: Polygon) -> Iterator[Side]:
    return pairwise([*polygon, polygon[0]])


def _area(polygon: Polygon) -> float:
    return sum(ax * by - bx * ay for (ax, ay), (bx, by) in _sides(polygon)) / 2


def _has(polygon: Polygon, x: float, y: float) -> bool:
    """Whether a polygon has a place, with its border."""
    odd = False
    for side in _sides(polygon):
        (ax, ay), (bx, by) = side
        if _closer(((x, y), (x, y)), side, BESIDE_M / 10):
            return True
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            odd = not odd
    return odd


def _outline(polygons: Sequence[Polygon]) -> Iterator[Side]:
    """The sides of the union of polygons: parts with another place of it on both sides are none."""

    def covered(x: float, y: float) -> bool:
        return any(_has(each, x, y) for each in polygons)

    sides = [side for polygon in polygons for side in _sides(polygon)]
    for side in sides:
        for part in _parts(side, sides):
            (ax, ay), (bx, by) = part
            length = hypot(bx - ax, by - ay)
            if length < BESIDE_M:
                continue
            nx, ny = (ay - by) / length * BESIDE_M, (bx - ax) / length * BESIDE_M
            x, y = (ax + bx) / 2, (ay + by) / 2
            if not (covered(x + nx, y + ny) and covered(x - nx, y - ny)):
                yield part


def _parts(side: Side, others: Iterable[Side]) -> Iterator[Side]:
    """A side cut wherever another one meets it."""
    (ax, ay), (bx, by) = side
    cuts = {0.0, 1.0}
    length2 = (bx - ax) ** 2 + (by - ay) ** 2
    for (cx, cy), (dx, dy) in others:
        for x, y in ((cx, cy), (dx, dy)):  # its ends that lie on this side
            share = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length2
            if 0.0 < share < 1.0 and _distance((x, y), side) < BESIDE_M:
                cuts.add(share)
        across = (bx - ax) * (dy - cy) - (by - ay) * (dx - cx)
        if across:
            share = ((cx - ax) * (dy - cy) - (cy - ay) * (dx - cx)) / across
            if 0.0 < share < 1.0:  # on its line; a cut too many does no harm
                cuts.add(share)
    places = [(ax + share * (bx - ax), ay + share * (by - ay)) for share in sorted(cuts)]
    return pairwise(places)


def _distance(place: Place, side: Side) -> float:
    return distance(*place, (*side[0], *side[1]))


def _closer(one: Side, other: Side, least: float) -> bool:
    """Whether two sides come nearer to each other than `least`, m."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = *one, *other
    if (  # most are far away, and this is much faster than their distance
        (cx - least > ax < dx - least and cx - least > bx < dx - least)
        or (cx + least < ax > dx + least and cx + least < bx > dx + least)
        or (cy - least > ay < dy - least and cy - least > by < dy - least)
        or (cy + least < ay > dy + least and cy + least < by > dy + least)
    ):
        return False
    return _apart(one, other) < least


def _apart(one: Side, other: Side) -> float:
    """The distance between two sides, m; 0 if they cross."""
    if _touch(one, other):
        return 0.0
    ends = [_distance(place, other) for place in one] + [_distance(place, one) for place in other]
    return min(ends)


def _touch(one: Side, other: Side) -> bool:
    """Whether two sides have a place in common."""
    (a, b), (c, d) = one, other
    crosses = _side(a, b, c) * _side(a, b, d) < 0.0 and _side(c, d, a) * _side(c, d, b) < 0.0
    near = [_distance(c, one), _distance(d, one), _distance(a, other), _distance(b, other)]
    return crosses or min(near) <= BESIDE_M / 10


def _turns_back(one: Side, other: Side) -> bool:
    """Whether of two sides with a common corner one lies on the other."""
    (a, b), (c, d) = one, other
    mine, theirs = (a, d) if b == c else (b, c)
    return _distance(theirs, one) <= BESIDE_M / 10 or _distance(mine, other) <= BESIDE_M / 10


def _side(a: Place, b: Place, c: Place) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _legs(path: Sequence[Place]) -> Iterator[Side]:
    return pairwise(path if len(path) != 1 else [*path, *path])
