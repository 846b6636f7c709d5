"""Places move with a map that is made while the robot drives (`MapMoved`)."""

from __future__ import annotations

from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import MapMoved


def moved(change: MapMoved, x: float, y: float, theta: float = 0.0) -> Pose2:
    """The pose after the change of a pose that was set before: m, m, rad.

    It keeps its place beside the nearest of the message's places.
    """
    near = min(
        change.places, key=lambda place: (place.x - x) ** 2 + (place.y - y) ** 2, default=None
    )
    if near is None:
        return x, y, theta
    before, after = (near.x, near.y, 0.0), (near.to_x, near.to_y, near.turn)
    return compose(after, relative(before, (x, y, theta)))
