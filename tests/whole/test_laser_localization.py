"""Localization by a laser."""

from __future__ import annotations

import random
from math import hypot, pi
from pathlib import Path

from armadico.agents.localization.localization import (
    Localization,
    Parameters,
)
from armadico.core.agent import Identity, Publish
from armadico.core.messages import Cycle, RobotState
from armadico.mobile.geometry import compose, relative
from armadico.mobile.messages import Correction, Pose
from armadico.mobile.scans import message_of
from tests.slam import made_logs

MAP = """\
2D-Map
LineMinPos: 0 0
LineMaxPos: 6000 4000
LINES
"""


def test_a_laser_may_have_any_mount_and_a_repeated_scan_counts_once(
    tmp_path: Path,
) -> None:
    path = tmp_path / "laser.map"
    walls = "\n".join(" ".join(f"{1000 * v:.0f}" for v in wall) for wall in made_logs.walls())
    path.write_text(MAP.replace("6000 4000", "9500 6000") + walls + "\n")
    parameters = Parameters(world=str(path), profile="jackal")
    agent = Localization(Identity("localization-1", rng=random.Random(3)), parameters)
    agent.start(0.0)
    mount, poses = (0.3, -0.1, -0.6), made_logs.driven()
    for number, pose in enumerate(poses[:80]):
        seen = made_logs.ranges(compose(pose, mount))
        for again, share in ((0, 0.5), (1, 1.0)):  # the robot drives on meanwhile
            cycle = Cycle(1, 2 * number + again + 1)
            step = relative(pose, poses[number + 1])
            x, y, theta = at = compose(pose, (share * step[0], share * step[1], share * step[2]))
            taken = relative(at, pose)
            limits, angles = (0.05, 20.0), (-pi / 2, pi / made_logs.RAYS)
            scan = message_of(cycle, seen, angles, limits, mount, since=taken, number=number)
            state = RobotState(cycle, x, y, theta, 0.0, 0.0, 12.0, True, False)
            for message in (state, Pose(cycle, *at), scan):
                agent.receive(message, 0.1 * cycle.number)
            assert agent._filter.due == bool(again), "nothing was weighed since it moved"
    published = [item.message for item in agent.outbox if isinstance(item, Publish)]
    last = [one for one in published if isinstance(one, Correction)][-1]
    assert hypot(last.x, last.y) < 0.05  # the odometry is exact
    assert last.confidence > 0.9


# Bad input ----------------------------------------------------------------------------------------
