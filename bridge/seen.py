"""What a robot's sensors have shown: where something is, and what they saw to be free.

`heard` has what its sonars show, `scanned` what its laser shows, and `cells` which places were seen
to be free. Places are kept in the odometry's frame, so they move along with the robot. A point
stays until a newer reading looks through its place, or for some time: what has left the sensors'
view is still there.

Frame of the arguments: the body's, x forward, y left, origin at the middle of the wheel axle;
m, rad, s.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from armadico.bridge.cells import CELL_M, LATELY_S, Cells
from armadico.bridge.heard import NOISE_M, Heard
from armadico.bridge.scanned import GONE_S, Scanned
from armadico.config.profile import RobotProfile
from armadico.mobile.admissible import View
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Echo, Scan
from armadico.mobile.motion import clearances
from armadico.mobile.scans import Floats
from armadico.mobile.swept_path import Outline

AROUND_M: Final = 0.05
"""The middles of free cells may be so far beyond the footprint, where the robot stands. A cell goes
on for half its size, where a wall beside the robot may be. Chosen: with 0.025 m 4 instead of 8 of
14 collected cases touched, but on a foreign map a robot stood before a box for over a minute."""

NEAR_M: Final = 0.3
GOES_ON_M: Final = 0.15
PERSON_M: Final = 0.25
"""What is within the first of the footprint goes on by the second, and what a laser saw, which may
be a person's side, by the third, where no sensor has looked: behind and beside the robot, where no
sensor looks, memory does."""


class Seen:
    """Collects readings; `view` returns what they show."""

    def __init__(self, profile: RobotProfile, reach: float) -> None:
        """`reach`: how far from the robot places matter, m."""
        ring, laser, body = profile.sonar, profile.laser, profile.body
        outline = Outline(body.front_m, body.rear_m, body.width_m / 2)
        self._outline = outline
        self._noise = max(0.0 if laser is None else laser.noise_m, 0.0 if ring is None else NOISE_M)
        self._cells = Cells(reach)
        self._heard = None if ring is None else Heard(ring, outline)
        self._scanned = None if laser is None else Scanned(laser, outline)

    def update(self, echoes: Iterable[Echo], scan: Scan | None, pose: Pose2, now: float) -> None:
        """Add one cycle's readings, of a robot at a pose by its odometry."""
        cells, heard, scanned = self._cells, self._heard, self._scanned
        cells.move(pose, now)
        x, y = cells.places.T
        front, rear, half = self._outline.grown(AROUND_M)
        cells.seen[(x < front) & (-rear < x) & (np.abs(y) < half)] = now
        if heard is not None:
            for echo in echoes:
                heard.update(echo, cells)
        if scanned is not None:
            rays = scanned.update(scan, cells)
            if rays is not None and heard is not None:
                heard.forget(rays.through, cells)
        if heard is not None:
            heard.age(cells)

    def view(self, within: float) -> View:
        """What is known of the surroundings, up to a distance (m) ahead, behind and aside."""
        cells, heard, scanned = self._cells, self._heard, self._scanned
        lately, empty = LATELY_S, np.empty((0, 2))
        looked = sure = inferred = maybe = empty
        if scanned is not None:
            looked = scanned.points(cells)
            # Where a moving object was seen lately, another may have stepped out of view.
            lately = GONE_S if cells.now - scanned.moved_at < LATELY_S else LATELY_S
        if heard is not None:
            sure, inferred, maybe = heard.points(cells)
        unseen = cells.unseen(within, lately)
        hidden = [self._beside(unseen, looked, PERSON_M), self._beside(unseen, sure, GOES_ON_M)]
        points = np.concatenate([looked, sure, inferred, *hidden])
        x, y = np.abs(points).T
        points = points[(x < within) & (y < within)]
        return View(points, np.concatenate([unseen, maybe]), 0.5 * CELL_M, self._noise)

    def _beside(self, unseen: Floats, points: Floats, within: float) -> Floats:
        """The unseen places within a distance (m) of points that are near the footprint."""
        points = points[clearances(self._outline, *points.T) < NEAR_M]
        if not len(points):
            return points
        unseen = unseen[clearances(self._outline, *unseen.T) < NEAR_M + within]
        dx, dy = (unseen[:, None] - points).transpose(2, 0, 1)
        found: Floats = unseen[(dx * dx + dy * dy < within * within).any(axis=1)]
        return found
