"""An occupancy grid by a laser."""

from __future__ import annotations

from math import nan, radians

import numpy as np
from msgspec.structs import replace

from armadico.agents.perception.mapping import Mapping, Parameters
from armadico.config.grid_map import OCCUPIED, UNKNOWN, cells_of
from armadico.core.agent import Identity, Question
from armadico.core.messages import Cycle, RobotState
from armadico.mobile.messages import Echo, MapRequest, Pose, Scan, Sonar
from armadico.mobile.scans import message_of
from tests.robot.robots import described


def scan(*rays: tuple[float, float], cycle: Cycle = Cycle(1, 1)) -> Scan:  # noqa: B008 - frozen
    ranges = np.full(360, nan)
    for bearing, distance in rays:
        ranges[round(bearing / radians(1.0)) % 360] = distance
    return message_of(cycle, ranges, (0.0, radians(1.0)), (0.1, 30.0), (0.0, 0.0, 0.0))


def test_with_a_laser_its_scans_make_the_map_and_sonars_none() -> None:
    agent = Mapping(Identity("mapping-1"), Parameters(profile="jackal"))
    agent.kernel.receive(described("jackal"), 0.0)
    for number in range(1, 6):
        cycle = Cycle(1, number)
        agent.kernel.receive(RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False), 0.1 * number)
        agent.kernel.receive(Pose(cycle, 1.02, 0.02, 0.0), 0.1 * number)
        agent.kernel.receive(Sonar(cycle, 5.0, (Echo(0.0, 0.0, 1.57, 1.0),)), 0.1 * number)
        agent.kernel.receive(scan((0.0, 2.0), cycle=cycle), 0.1 * number)
    agent.kernel.receive(replace(scan(cycle=cycle), packed=b"abc"), 0.6)
    cells = cells_of(agent.on_map_request(MapRequest(), Question(1)))
    assert cells.at(3.02, 0.02) == OCCUPIED
    assert cells.at(1.0, 1.0) == UNKNOWN
