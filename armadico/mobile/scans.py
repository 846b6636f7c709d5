"""A laser's scan as a message, and back: two bytes a ray.

Whatever a driver says comes in here: rays that say NaN, 0 or an infinity, a laser that turns the
other way or hangs upside down, ranges beyond what it can see. What of it is no scan is refused with
a reason; what is left is a message that every other agent may take as it is.
"""

from __future__ import annotations

from math import ceil, isfinite, tau
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armadico.core.messages import Cycle
from armadico.mobile.geometry import Pose2, compose
from armadico.mobile.messages import RAYS, Scan

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

INVALID: Final = 0
FREE: Final = 65535
"""Of a ray's two bytes: nothing valid, and nothing within reach."""

MM: Final = 1000.0
FINEST_RAD: Final = 1e-4
"""From one ray to the next at the least: 62,800 a turn."""


def message_of(
    cycle: Cycle,
    ranges: ArrayLike,
    angles: tuple[float, float],
    limits: tuple[float, float],
    mount: Pose2,
    *,
    upside_down: bool = False,
    since: Pose2 = (0.0, 0.0, 0.0),
    number: int = 0,
) -> Scan:
    """A scan as a message. Raises ValueError, saying why, if it is none.

    Args:
        cycle: Of the robot.
        ranges: m, one a ray. NaN, and what is nearer than the limit, is no valid range; infinity,
            and what is at the limit or beyond it, is that nothing is within reach.
        angles: The first ray's, and from one to the next (below 0: clockwise), about the laser's
            own axis, rad. What goes on beyond a whole turn is left out.
        limits: The least and the longest range that it measures, m.
        mount: Where it sits and looks on the body: m, m, rad.
        upside_down: Whether it hangs: counter-clockwise to it is clockwise to the robot.
        since: The body's pose when the scan was taken, in the frame of the body now.
        number: Tells one scan from the next.
    """
    first, step = angles
    seen: Floats = np.asarray(ranges, dtype=np.float64).ravel()
    if not (isfinite(first) and isfinite(step)) or not FINEST_RAD <= abs(step) <= 1.0:
        raise ValueError(f"rays from {first:g} rad on, each {step:g} rad from the one before")
    if not len(seen):
        raise ValueError("no rays")
    seen = seen[: max(1, round(tau / abs(step)))]
    if (together := ceil(len(seen) / RAYS)) > 1:
        seen = _nearest(seen, together, limits[0])
        first, step = first + 0.5 * (together - 1) * step, together * step
    turns = -1.0 if upside_down else 1.0
    x, y, bearing = compose(since, compose(mount, (0.0, 0.0, turns * first)))
    return Scan(cycle, x, y, bearing, turns * step, limits[1], packed(seen, *limits), number=number)


def _nearest(ranges: Floats, together: int, least: float) -> Floats:
    """Of so many rays side by side the nearest one's range that is valid stands for them."""
    groups = np.append(ranges, np.full(-len(ranges) % together, np.nan)).reshape(-1, together)
    groups = np.where(groups >= least, groups, np.nan)
    nearest: Floats = np.fmin.reduce(groups, axis=1)
    return nearest


def packed(ranges: Floats, least: float, most: float) -> bytes:
    """Ranges in m as two bytes each."""
    with np.errstate(invalid="ignore"):
        # REP-117 and LaserScan: range_max itself is what a driver reports where nothing is.
        valid, beyond = ranges >= least, ranges >= most
        mm = np.where(valid & ~beyond, np.rint(MM * ranges), INVALID)
    mm[beyond] = FREE
    return mm.astype("<u2").tobytes()


def ranges_of(scan: Scan) -> Floats:
    """m, one a ray: NaN where nothing is valid, inf where nothing is within reach.

    Raises ValueError if its bytes are not two for each, or all go the same way.
    """
    if abs(scan.step) < FINEST_RAD:
        raise ValueError("rays that all go the same way")
    mm = np.frombuffer(scan.packed, dtype="<u2")
    ranges: Floats = mm.astype(np.float64) / MM
    ranges[mm == INVALID] = np.nan
    ranges[mm == FREE] = np.inf
    return ranges


def bearings_of(scan: Scan) -> Floats:
    """Where each ray goes, in the body frame, rad; not wrapped."""
    bearings: Floats = scan.bearing + scan.step * np.arange(scan.rays, dtype=np.float64)
    return bearings


def points_of(scan: Scan) -> Floats:
    """What was seen, (n, 2), in the body frame, m."""
    ranges, bearings = ranges_of(scan), bearings_of(scan)
    seen = np.isfinite(ranges)
    ranges, bearings = ranges[seen], bearings[seen]
    return np.column_stack([scan.x + ranges * np.cos(bearings), scan.y + ranges * np.sin(bearings)])


def beside(
    bearings: Floats, first: float, step: float, count: int
) -> tuple[Indices, Indices, Flags]:
    """The two rays between which each bearing lies, and whether the laser looks there at all.

    Of a whole turn the first ray is the last one's neighbour. Beyond an edge of what the laser
    sees, by half a step at the most, both are the ray at that edge; farther off both are 0.

    Args:
        bearings: rad, in the frame of `first`; not wrapped.
        first: Where the first ray goes, rad.
        step: From one ray to the next, rad; below 0: clockwise.
        count: How many there are.
    """
    at = np.remainder((bearings - first) * np.sign(step), tau) / abs(step)
    whole = round(tau / abs(step))
    nearest = np.rint(at).astype(np.intp) % whole
    inside: Flags = nearest < count
    low = np.floor(at).astype(np.intp)
    high = low + 1
    if count == whole:
        low, high = low % whole, high % whole
    low, high = (np.where(ray < count, ray, nearest) for ray in (low, high))
    return np.where(inside, low, 0), np.where(inside, high, 0), inside
