"""The pose from scan to scan: by what the laser has seen lately, with the odometry between.

The newest key scans are a local map, the *window*. It tells the motion much better than the wheels,
on the map and off it, but drifts. The window *breaks* if scans contradict it, since the robot was
carried, or if there is nothing to see.
"""

from __future__ import annotations

from collections import deque
from math import hypot
from typing import Final, NamedTuple

import numpy as np

from armadico.agents.methods.front_end import (
    FrontEnd,
    FrontEndParameters,
    matched_points,
)
from armadico.agents.methods.poses import Floats, compose, relative, rotation
from armadico.agents.methods.scan_matching import LEAST_MATCHED, PointCloud, in_world
from armadico.config.profile import Odometry
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Scan
from armadico.mobile.scans import bearings_of, ranges_of

OVERDUE: Final = 10.0
"""After so many times the travel from one key scan to the next without one, the wheels count."""

TORN: Final = 0.5
"""Share of a key scan's points that fit those before, over the usual one, below which the robot may
have been moved. It is 0.9 to 1 in the simulator, and 0.2 to 0.4 after a lift. In real buildings the
usual one is 0.55 (edmonton, a scan each metre) to 0.8."""

USUAL_GAIN: Final = 0.05
"""Weight of the newest key scan in the usual share."""

LEAST_USUAL: Final = 0.7
"""The usual share at least, so that a key scan that fits by less than 0.35 is torn in any building.
"""

BLIND_M: Final = 2.5
"""Distance by the wheels alone after which the window is broken, m."""


REFERENCE: Final = 4.0
"""Key scans that refer to the same older ones, so that their errors do not add up. By the drift on
three logs of real robots: it is then within two standard deviations."""


FEIGNED: Final = 0.04
"""Share of the information on one direction of a shift that lines feign in the direction square to
it. It is the squared sine of 11.5 degrees, by which the noise of ranges turns the normals of a near
wall. Beside one wall (scenario 2, Jackal) the share is 0.001 to 0.037, and a match slides along it
by up to 0.1 m. Chosen on that, and against 0.1 on parts of intel, seattle and edmonton."""


DISPUTED: Final = 4.5
"""Deviations of the wheels beyond which a match contradicts them, so that one of both is wrong.
Chosen on own seeds: a stuck laser makes 6 of them with each key scan, and in logs of four buildings
the most was 3.7."""


class Errors(NamedTuple):
    """Of a step, as covariances (3, 3) in the robot's frame."""

    matched: Floats  # by the match of a scan
    wheels: Floats  # by the odometry, if the match is wrong
    normals: Floats  # (n, 2) of the walls, in the robot's frame; NaN where unknown
    disputed: tuple[float, float]  # by how much both contradict each other, m, rad; else 0


class Window:
    """Where the robot is by the scans of the last metres, in a frame of its own."""

    def __init__(self, wheels: Odometry) -> None:
        """Begin without a scan; `wheels` are the standard deviations of the odometry."""
        self.parameters = p = FrontEndParameters()
        self.front = FrontEnd(p, sides=True)
        self._wheels = wheels
        self._keys: deque[tuple[Floats, PointCloud]] = deque(maxlen=p.scan_buffer_size)
        self._drawn: deque[PointCloud] = deque(maxlen=p.scan_buffer_size)  # these in the frame
        self._newest: tuple[Floats, Floats] | None = None  # odometry and pose of the last step
        self._known: tuple[Pose2, Pose2] | None = None  # the newest odometry, and its pose
        self._since = 0  # key scans since the first one that contradicts those before, with it
        self._against = 0  # of these, those that contradict
        self._doubtful: tuple[float, float] | None = None  # the scanner of a key scan to `check`
        self._blind_m = 0.0  # driven by the wheels alone,
        self._untold_m = 0.0  # and in a direction in which they alone told the motion
        self._empty = False  # the newest scan had too few points
        self._usual = 1.0  # share of a key scan's points that fit those before
        self.torn = False  # the newest key scan does not fit those before
        self.carried = False  # the newest key scans contradict those before

    @property
    def follows(self) -> bool:
        """Whether it tells where the robot has moved."""
        return not (self.carried or self._since or self.blind)

    @property
    def blind(self) -> bool:
        """Whether the wheels alone have told the motion for some way."""
        return self._blind_m > BLIND_M

    def pose(self, odometry: Pose2) -> Pose2:
        """The pose in the frame of the window at an odometry: m, m, rad."""
        if self._newest is None:
            return odometry
        if self._known is None or self._known[0] != odometry:
            at, pose = self._newest
            step = self.front.model.corrected(relative(at, np.array(odometry)))
            x, y, theta = compose(pose, step).tolist()
            self._known = odometry, (x, y, theta)
        return self._known[1]

    def see(self, odometry: Pose2, scan: Scan) -> Errors | None:
        """Take a scan.

        Returns the errors of the step since the last one; None if the robot has not moved enough,
        or if there is too little to see. Raises ValueError if the scan's bytes are no ranges.
        """
        p, here, origin = self.parameters, np.array(odometry), (scan.x, scan.y)
        if self._keys and self._newest is not None and self._moved(here) < 1.0:
            return None
        cloud = matched_points(ranges_of(scan), bearings_of(scan), origin, p.max_range)
        self._empty = len(cloud.points) < LEAST_MATCHED
        if self._empty:
            return None
        if not self._keys or self._newest is None:
            self._keep(np.array(self.pose(odometry)), here, cloud)
            return None
        at, before = self._newest
        step = relative(at, here)
        guess = compose(before, self.front.model.corrected(step))
        points, normals = zip(*self._drawn, strict=True)
        local = PointCloud(np.concatenate(points), np.concatenate(normals))
        match, prior = self.front.matched(local, cloud, guess, step, self._usual)
        untold = untold_by(match.information[:2, :2])
        pose = match.pose.copy()
        pose[:2] -= untold @ (match.pose - guess)[:2]
        told = np.eye(3)
        told[:2, :2] -= untold
        self.front.learn(
            match._replace(information=told @ match.information @ told),
            prior,
            step,
            relative(before, pose),
            heading=bool(match.information[2, 2] > 4.0 * prior.heading**-2),
        )
        share = match.inliers / self._usual
        self.torn, self.carried = share < TORN, False
        self._keep(pose, here, cloud)
        if self._since or share < p.match_good:
            self._doubtful = origin
        usual = self._usual + USUAL_GAIN * (match.inliers - self._usual)
        self._usual = max(LEAST_USUAL, usual)
        covariance = np.linalg.inv(REFERENCE * self.front.information(match) + prior.information)
        covariance = told @ covariance @ told.T
        along = float(np.linalg.norm(untold @ (pose - before)[:2]))
        covariance[:2, :2] += untold @ untold * self._along(step, along)
        self._untold_m = float(np.linalg.norm(untold, 2)) * self._untold_m + along
        turn = rotation(-float(pose[2]))
        wheels = turn @ prior.covariance @ turn.T
        disputed = self._disputed(step, relative(guess, pose))
        return Errors(turn @ covariance @ turn.T, wheels, cloud.normals, disputed)

    def _disputed(self, step: Floats, off: Floats) -> tuple[float, float]:
        """How far a match is off a step by the wheels, m, rad; 0 within what these may err."""
        o, noise = self._wheels, self.parameters.odometry
        way, turn = hypot(step[0], step[1]), abs(float(step[2]))
        most_m = hypot(noise.translation_noise, o.alpha3 * way, o.alpha4 * turn)
        most_rad = hypot(noise.rotation_noise, o.alpha1 * turn, o.alpha2 * way)
        off_m, turned = hypot(off[0], off[1]), abs(float(off[2]))
        far = max(off_m / most_m, turned / most_rad)
        return (off_m, turned) if far > DISPUTED else (0.0, 0.0)

    def reckon(self, odometry: Pose2) -> Floats | None:
        """The covariance of a step by the wheels alone if no scan has told it; None: not due."""
        here = np.array(odometry)
        if self._newest is None:  # nothing has been seen yet
            self._newest = here, here
        if self._moved(here) < (1.0 if self._empty else OVERDUE):
            return None
        o, before = self._wheels, self._blind_m
        step, pose = relative(self._newest[0], here), np.array(self.pose(odometry))
        way = hypot(step[0], step[1])
        along = self._along(step, way)
        self._blind_m += way
        self._untold_m += way
        self._newest, self._known = (here, pose), None
        turning, drift, _ = self._lasting
        heading = drift**2 * (self._blind_m**2 - before**2) + (turning * step[2]) ** 2
        return np.diag([along, along, heading + 0.25 * o.alpha2**2 * way])

    @property
    def _lasting(self) -> tuple[float, float, float]:
        """Deviations of the wheels' lasting errors: turn (rad/rad), drift (rad/m), way (m/m)."""
        o, (turning, drift, way) = self._wheels, self.front.model.deviations
        return min(o.alpha1, turning), min(o.alpha2, drift), min(o.alpha3, way)

    def _along(self, step: Floats, untold: float) -> float:
        """The variance, m^2, of a step by the wheels, of which they alone tell `untold` m."""
        o, before = self._wheels, self._untold_m
        lasting = self._lasting[2] ** 2 * ((before + untold) ** 2 - before**2)
        return lasting + o.alpha3**2 * hypot(step[0], step[1]) + (o.alpha4 * float(step[2])) ** 2

    def _moved(self, here: Floats) -> float:
        """How far the robot has moved since the last step, in travels to the next key scan."""
        assert self._newest is not None, "callers have checked it"
        p, step = self.parameters, relative(self._newest[0], here)
        far = hypot(step[0], step[1]) / p.minimum_travel_distance
        return max(far, abs(float(step[2])) / p.minimum_travel_heading)

    def _keep(self, pose: Floats, here: Floats, cloud: PointCloud) -> None:
        self._newest, self._known, self._blind_m = (here, pose), None, 0.0
        self._keys.append((pose, cloud))
        self._drawn.append(in_world([(pose, cloud)]))

    def check(self) -> None:
        """Hold a doubtful key scan against those before the first one, if that is still to be done.

        It takes as long as `see`, and so is done in the cycle after it.
        """
        origin, self._doubtful = self._doubtful, None
        if origin is None:
            return
        p, (*before, (pose, cloud)) = self.parameters, self._keys
        count = len(before) - self._since
        last = self._against == p.lost_scans - 1
        against = count > 0 and self.front.contradicts(
            before[:count],
            before[count:],
            pose,
            cloud,
            origin,
            last=last,
            field=None if self._since else self.front.field,
        )
        if against is False or self._since >= 2 * p.lost_scans:
            self._since = self._against = 0
        elif against or self._since:
            self._since, self._against = self._since + 1, self._against + bool(against)
        if self._against >= p.lost_scans:
            self.carried, self._since, self._against = True, 0, 0
            for _ in range(count):
                self._keys.popleft()
                self._drawn.popleft()


def untold_by(information: Floats) -> Floats:
    """(2, 2) the share of a shift that lines do not tell: a projection on one direction, or less.

    By the information (2, 2) of a match on a shift. It moves freely in such a direction, as along a
    wall. There the wheels tell the motion (*solution remapping*, after Zhang, Kaess and Singh,
    2016).
    """
    (least, most), axes = np.linalg.eigh(information)
    if most <= 0.0:
        return np.eye(2)
    share = FEIGNED * most / max(least, FEIGNED * most)
    return float(share) * np.outer(axes[:, 0], axes[:, 0])
