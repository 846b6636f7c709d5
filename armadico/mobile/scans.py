"""Encodes and decodes a laser's scan with two bytes per ray.

All variants of drivers are converted here: NaN, 0 and infinite ranges, clockwise lasers, lasers
mounted upside down, ranges beyond the limit. Invalid scans are rejected with a reason, so agents
need not check messages again.
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

INVALID: Final = 0  # value of a ray: no valid range
FREE: Final = 65535  # value of a ray: nothing within reach
MM: Final = 1000.0
SURFACE: Final = 0.1  # neighbours that differ by more than this share are of two surfaces
AROUND_M: Final = 0.3  # points so near to a place may be of the same surface
LONG_M: Final = 0.08  # and show its direction if one is so far away
THIN_M: Final = 0.05  # by which noise may shift points of a surface across a ray
FINEST_RAD: Final = 1e-4  # the smallest step between two rays: 62,800 per turn


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
    """Encode a scan. Raises ValueError, with the reason, for an invalid one.

    Args:
        cycle: The robot's cycle.
        ranges: m, one per ray. NaN and ranges below the lower limit are invalid; infinity and
            ranges from the upper limit mean that nothing is within reach.
        angles: The first ray's angle and the step (below 0: clockwise) about the laser's own axis,
            rad. Rays beyond a whole turn are omitted.
        limits: The smallest and the largest range that it measures, m.
        mount: The laser's pose on the body: m, m, rad.
        upside_down: The laser's counter-clockwise is the robot's clockwise.
        since: The body's pose at the time of the scan, in the body frame now.
        number: Identifies the scan.
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


def deskewed(ranges: Floats, angles: tuple[float, float], mount: Pose2, moved: Floats) -> Floats:
    """Return the ranges (n,) as if the robot had stood at one pose while they were measured.

    The measured points are moved to that pose and read off at the same angles again: between two
    points of one surface by a line, else from the nearer one. A ray without a point beside it is
    invalid.

    Args:
        ranges: m, (n,). Invalid and infinite ones keep their value.
        angles: The first ray's and the step to the next one, rad, counter-clockwise on the robot.
        mount: The laser's pose on the body: m, m, rad.
        moved: (n, 3) the body's pose at each ray, in the body frame of that one pose: m, m, rad.
    """
    first, step = angles
    rays = np.arange(len(ranges))
    looks = np.exp(1j * (first + step * rays))
    laser, turn = complex(mount[0], mount[1]), np.exp(1j * mount[2])
    measured = np.isfinite(ranges) & (ranges > 0.0)
    seen = np.where(measured, ranges, 1.0) * looks
    body = moved[:, 0] + 1j * moved[:, 1]
    seen = (body + np.exp(1j * moved[:, 2]) * (laser + turn * seen) - laser) / turn
    # Without a point only the direction of a ray counts.
    ways = np.where(measured, seen, looks * np.exp(1j * moved[:, 2]))
    at = rays + np.angle(ways / looks) / step
    away = np.where(measured, np.abs(seen), ranges)
    whole = round(tau / abs(step))
    if len(ranges) == whole:  # the rays beyond both ends of a whole turn
        at = np.concatenate([at - whole, at, at + whole])
        away, measured = np.tile(away, 3), np.tile(measured, 3)
    order = np.argsort(at, kind="stable")
    at, away, measured = at[order], away[order], measured[order]
    high = np.clip(np.searchsorted(at, rays), 1, len(at) - 1)
    low = high - 1
    nearer = np.where(rays - at[low] <= at[high] - rays, low, high)
    found = np.where(np.abs(at[nearer] - rays) <= 1.0, away[nearer], np.nan)
    near, far = np.minimum(away[low], away[high]), np.maximum(away[low], away[high])
    one = measured[low] & measured[high] & (at[high] - at[low] <= 2.0)
    one &= (at[low] <= rays) & (rays <= at[high]) & (far <= (1.0 + SURFACE) * near)
    share = (rays - at[low])[one] / np.maximum(at[high] - at[low], 1e-9)[one]
    # A line is straight in 1 / range for small angles.
    found[one] = 1.0 / ((1.0 - share) / away[low][one] + share / away[high][one])
    return np.asarray(found, dtype=np.float64)


def _nearest(ranges: Floats, together: int, least: float) -> Floats:
    """Replace each group of `together` adjacent rays by its smallest valid range."""
    groups = np.append(ranges, np.full(-len(ranges) % together, np.nan)).reshape(-1, together)
    groups = np.where(groups >= least, groups, np.nan)
    nearest: Floats = np.fmin.reduce(groups, axis=1)
    return nearest


def packed(ranges: Floats, least: float, most: float) -> bytes:
    """Encode ranges in m as two bytes each."""
    with np.errstate(invalid="ignore"):
        # REP-117 and LaserScan: a driver reports range_max itself where nothing is.
        valid, beyond = ranges >= least, ranges >= most
        mm = np.where(valid & ~beyond, np.rint(MM * ranges), INVALID)
    mm[beyond] = FREE
    return mm.astype("<u2").tobytes()


def is_readable(scan: Scan) -> bool:
    """Return whether a scan's rays go different ways and have two bytes each."""
    return abs(scan.step) >= FINEST_RAD and len(scan.packed) % 2 == 0


def ranges_of(scan: Scan) -> Floats:
    """Return the ranges, m, one per ray: NaN if invalid, inf if nothing is within reach.

    Raises ValueError for an odd number of bytes, or a step of almost 0.
    """
    if abs(scan.step) < FINEST_RAD:
        raise ValueError("rays that all go the same way")
    mm = np.frombuffer(scan.packed, dtype="<u2")
    ranges: Floats = mm.astype(np.float64) / MM
    ranges[mm == INVALID] = np.nan
    ranges[mm == FREE] = np.inf
    return ranges


def bearings_of(scan: Scan) -> Floats:
    """Return each ray's angle in the body frame, rad, not wrapped."""
    bearings: Floats = scan.bearing + scan.step * np.arange(scan.rays, dtype=np.float64)
    return bearings


def points_of(scan: Scan) -> Floats:
    """Return the measured points, (n, 2), in the body frame, m."""
    ranges, bearings = ranges_of(scan), bearings_of(scan)
    seen = np.isfinite(ranges)
    ranges, bearings = ranges[seen], bearings[seen]
    return paired(scan.x + ranges * np.cos(bearings), scan.y + ranges * np.sin(bearings))


def paired(x: Floats, y: Floats) -> Floats:
    """Return places, (n, 2), by their coordinates: `column_stack` in half the time, if few."""
    found = np.empty((len(x), 2))
    found[:, 0], found[:, 1] = x, y
    return found


def beside(
    bearings: Floats, first: float, step: float, count: int
) -> tuple[Indices, Indices, Flags]:
    """Return the indices of the two rays around each bearing, and whether it is in view.

    In a whole turn the first ray is next to the last one. Up to half a step beyond an edge of the
    field of view, both are the ray at that edge; farther away both are 0. Bearings (not wrapped),
    the first ray's angle and the step (below 0: clockwise) are rad in one frame.
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


def edge_on(places: Floats, known: Floats, eye: tuple[float, float], step: float) -> Flags:
    """Return which places are on a surface that a scan would not show, as it looks along it.

    The rays beside the end of a wall, seen along the wall, pass it on both sides. The surface is
    told by the points that are known around a place: a row of them along the ray, and no wider
    across it than noise and the gap between two rays.

    Args:
        places: (m, 2), m.
        known: Points that were sensed, (n, 2), in the same frame.
        eye: The laser's position there.
        step: Angle from one ray to the next, rad.
    """
    low, high = places.min(axis=0) - AROUND_M, places.max(axis=0) + AROUND_M
    known = known[((known >= low) & (known <= high)).all(axis=1)]
    ahead = places - eye
    away = np.maximum(np.hypot(*ahead.T), 1e-9)
    looks = ahead / away[:, None]
    off = known - places[:, None]
    along = np.abs(off[..., 0] * looks[:, :1] + off[..., 1] * looks[:, 1:])
    across = np.abs(off[..., 1] * looks[:, :1] - off[..., 0] * looks[:, 1:])
    near = np.hypot(along, across) < AROUND_M
    longest = np.max(along, axis=1, where=near, initial=0.0)
    widest = np.max(across, axis=1, where=near, initial=0.0)
    found: Flags = (longest > LONG_M) & (widest < THIN_M + away * abs(step))
    return found
