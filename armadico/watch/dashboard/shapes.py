"""Shapes in the body frame: the robot, sonar cones, zones. Metres, radians, REP-103; (n, 2)."""

from __future__ import annotations

from math import pi, radians
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from armadico.core.messages import Description
from armadico.mobile.messages import Echo
from armadico.watch.dashboard.canvas import Colour, pixels

Points = NDArray[np.float64]

# Half the angle of a drawn cone. A sonar's beam is about 30 degrees wide, but sixteen cones of that
# width would hide everything else.
HALF_CONE: Final = radians(10)


def arc(start: float, end: float, steps: int) -> Points:
    """Points of the unit circle between two angles, both included."""
    angles = np.linspace(start, end, steps + 1)
    return np.column_stack([np.cos(angles), np.sin(angles)])


CIRCLE: Final = arc(0.0, 2.0 * pi, 72)


def robot_shape(robot: Description, colour: Colour, width: float) -> rr.LineStrips2D:
    """The footprint about the middle of the axle, with an arrow head that points forward."""
    x, y = 0.2 * robot.front, 0.6 * robot.half_width
    nose = np.array([(x, y), (0.85 * robot.front, 0.0), (x, -y)])
    strips = [around_footprint(robot, 0.0), nose]
    return rr.LineStrips2D(strips, radii=pixels(width), colors=colour, draw_order=40)


def around_footprint(robot: Description, distance: float) -> Points:
    """The line at a distance (m) from the footprint: a closed rectangle with rounded corners."""
    front, rear, half = robot.front, -robot.rear, robot.half_width
    corners = [(front, half), (rear, half), (rear, -half), (front, -half)]
    arcs = [distance * arc(n * pi / 2.0, (n + 1) * pi / 2.0, 6) for n in range(4)]
    line = np.vstack([np.array(c) + turn for c, turn in zip(corners, arcs, strict=True)])
    return np.vstack([line, line[:1]])


def ellipse(xx: float, xy: float, yy: float, sigmas: float) -> Points:
    """The line at `sigmas` standard deviations of a covariance (m^2), about the origin."""
    variances, axes = np.linalg.eigh([[xx, xy], [xy, yy]])
    line: Points = sigmas * CIRCLE * np.sqrt(np.maximum(variances, 0.0)) @ axes.T
    return line


def cone(echo: Echo) -> Points:
    """The wedge of a sonar that measured a range."""
    assert echo.range is not None, "without an echo there is no wedge"
    tip = np.array([(echo.x, echo.y)])
    far = echo.range * arc(echo.bearing - HALF_CONE, echo.bearing + HALF_CONE, 2)
    return np.vstack([tip, tip + far, tip])
