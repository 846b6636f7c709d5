"""Localization by a laser."""

from __future__ import annotations

import random
from math import hypot, pi, sqrt
from pathlib import Path

import numpy as np
import pytest

from armadico.agents.localization.localization import (
    Localization,
    Parameters,
)
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, RobotState
from armadico.core.outgoing import Publish
from armadico.mobile.geometry import STOOD, Pose2, compose, relative
from armadico.mobile.messages import Correction, Pose
from armadico.mobile.scans import message_of
from tests.slam import made_logs

MAP = """\
2D-Map
LineMinPos: 0 0
LineMaxPos: 6000 4000
LINES
"""


class Driven:
    """A localization agent in a room, and the odometry and scans that it is given."""

    def __init__(self, folder: Path) -> None:
        path = folder / "laser.map"
        walls = "\n".join(" ".join(f"{1000 * v:.0f}" for v in wall) for wall in made_logs.walls())
        path.write_text(MAP.replace("6000 4000", "9500 6000") + walls + "\n")
        parameters = Parameters(world=str(path), profile="jackal")
        self.agent = Localization(Identity("localization-1", rng=random.Random(3)), parameters)
        self.agent.kernel.start(0.0)
        self.cycles = self.scans = 0

    def see(
        self,
        odometry: Pose2,
        ranges: np.ndarray,
        mount: Pose2 = STOOD,
        *,
        since: Pose2 = STOOD,
        again: bool = False,
    ) -> Correction:
        """Receive a cycle, and return the pose; `again`: the scan is the one before."""
        self.cycles += 1
        self.scans += not again
        cycle = Cycle(1, self.cycles)
        limits, angles = (0.05, 20.0), (-pi / 2, pi / made_logs.RAYS)
        scan = message_of(cycle, ranges, angles, limits, mount, since=since, number=self.scans)
        state = RobotState(cycle, *odometry, 0.0, 0.0, 12.0, True, False)
        for message in (state, Pose(cycle, *odometry), scan):
            self.agent.kernel.receive(message, 0.1 * cycle.number)
        sent = (item.message for item in self.agent.kernel.outbox if isinstance(item, Publish))
        return [each for each in sent if isinstance(each, Correction)][-1]


def test_a_laser_may_have_any_mount_and_a_repeated_scan_counts_once(
    tmp_path: Path,
) -> None:
    driven, mount, poses = Driven(tmp_path), (0.3, -0.1, -0.6), made_logs.driven()
    for number, pose in enumerate(poses[:80]):
        seen = made_logs.ranges(compose(pose, mount))
        for again, share in ((False, 0.5), (True, 1.0)):  # the robot drives on meanwhile
            step = relative(pose, poses[number + 1])
            at = compose(pose, (share * step[0], share * step[1], share * step[2]))
            last = driven.see(at, seen, mount, since=relative(at, pose), again=again)
            assert driven.agent._filter.due == again, "nothing was weighed since it moved"
    assert hypot(last.x, last.y) < 0.05  # the odometry is exact
    assert last.confidence > 0.9


@pytest.mark.parametrize("after", [20, 28], ids=["straight", "in a turn"])
def test_a_stuck_laser_leaves_the_pose_as_uncertain_as_it_is_wrong(
    tmp_path: Path, after: int
) -> None:
    """Its scans differ by noise alone and fit the map, but the wheels contradict them."""
    rng, driven, poses = np.random.default_rng(1), Driven(tmp_path), made_logs.driven()
    for number, pose in enumerate(poses[: after + 14]):
        ranges = made_logs.ranges(poses[min(number, after)])
        found = driven.see(pose, ranges + 0.005 * rng.standard_normal(len(ranges)))
        xx, _, _, yy, _, tt = found.covariance
        place = compose((found.x, found.y, found.theta), pose)
        off, turned = hypot(*relative(pose, place)[:2]), abs(relative(pose, place)[2])
        assert off < 0.3 + 3.0 * sqrt(xx + yy)
        assert turned < 0.3 + 3.0 * sqrt(tt)
    assert off > 1.0, "the scans hold the pose back"


# Bad input ----------------------------------------------------------------------------------------
