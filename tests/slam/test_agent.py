"""The slam agent: pose and map belong together, in every cycle and after every loop."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest
from msgspec.structs import replace

from armadico.agents.driving.goto import Goto
from armadico.agents.localization.localization import Localization
from armadico.agents.localization.localization import Parameters as OnMap
from armadico.agents.methods.poses import Floats, compose, relative
from armadico.agents.slam.agent import INVALID, Parameters, SlamAgent
from armadico.agents.slam.logs.logs import drifted
from armadico.config.grid_map import FREE, OCCUPIED, cells_of
from armadico.core.agent import ERROR, Identity, Question
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Cycle, Log, Message, RobotState, encode
from armadico.core.outgoing import Answer, Publish
from armadico.mobile.messages import (
    Correction,
    MapGraph,
    MapMoved,
    MapRequest,
    OccupancyGrid,
    Pose,
    Scan,
)
from armadico.mobile.scans import message_of, ranges_of
from tests.robot.robots import described, with_laser
from tests.robot.scans import BEARINGS, cast
from tests.slam.worlds import ring, square

MAPPED = OnMap(world="sc1")
PATH = square()
RING = ring()
HALL = np.array(
    [[14.0, -6.0, 30.0, -6.0], [30.0, -6.0, 30.0, 7.0], [30.0, 7.0, 14.0, 7.0], [14.0, 7, 14, -6]]
)
"""A room elsewhere with far walls: x1, y1, x2, y2 in m."""


class Robot:
    """A slam agent on a robot that drives through the ring."""

    def __init__(self, parameters: Parameters | None = None, seed: int = 0) -> None:
        given = replace(parameters or Parameters(), profile=with_laser())
        self.agent = SlamAgent(Identity("slam-1", rng=Random(seed)), given)
        self.known: tuple[float, ...] = ()  # the covariance of the first pose
        self.logged = ""
        self.agent.kernel.receive(described(with_laser()), 0.0)
        self.number, self.epoch = 0, 1
        self._noise = np.random.default_rng(1)

    def cycle(
        self,
        pose: Floats,
        odometry: Floats,
        *,
        scan_first: bool = False,
        scan: bool = True,
        walls: Floats | None = None,
    ) -> list[Message]:
        """What it publishes in a cycle."""
        self.number += 1
        cycle, now = Cycle(self.epoch, self.number), 0.1 * self.number
        x, y, theta = odometry.tolist()
        state = RobotState(cycle, x, y, theta, 0.0, 0.0, 12.0, True, False)
        messages: list[Message] = [state]
        if scan:
            walls = RING if walls is None else walls
            ranges = cast(walls, pose) + 0.01 * self._noise.standard_normal(len(BEARINGS))
            step = float(BEARINGS[1] - BEARINGS[0])
            angles, limits = (float(BEARINGS[0]), step), (0.1, 30.0)
            place = 0.0, 0.0, 0.0
            messages.append(message_of(cycle, ranges, angles, limits, place, number=self.number))
        if self.number == 1:
            messages.insert(1, Pose(cycle, *pose.tolist(), self.known))
        for message in messages[::-1] if scan_first else messages:
            self.agent.kernel.receive(message, now)
        out, self.agent.kernel.outbox = self.agent.kernel.outbox, []
        logs = [one.message for one in out if isinstance(one, Publish)]
        self.logged += "".join(each.text for each in logs if isinstance(each, Log))
        return [one.message for one in out if isinstance(one, Publish | Answer)]

    def drive(self, path: Floats, odometry: Floats, **how: bool) -> list[list[Message]]:
        """What it publishes in the cycle of each pose."""
        return [self.cycle(*at, **how) for at in zip(path, odometry, strict=True)]


def of(kind: type, said: list[Message]) -> list[Message]:
    return [message for message in said if isinstance(message, kind)]


def place(correction: Message, odometry: Floats) -> Floats:
    """The pose of the robot by a correction."""
    assert isinstance(correction, Correction)
    return compose(np.array([correction.x, correction.y, correction.theta]), odometry)


def own_odometry(path: Floats, drift: float = 0.1) -> Floats:
    """The same drift in the odometry's own frame, which begins at zero."""
    odometry = drifted(path, drift, 2)
    return relative(odometry[0], odometry)


def test_pose_and_map_move_together_when_a_loop_closes() -> None:
    odometry = own_odometry(PATH)
    robot, revision, leaps = Robot(), 0, 0
    for pose, here in zip(PATH, odometry, strict=True):
        said = robot.cycle(pose, here)
        corrections, grids = of(Correction, said), of(OccupancyGrid, said)
        changes = of(MapMoved, said)
        for correction in corrections:
            assert isinstance(correction, Correction)
            if correction.revision != revision:
                assert correction.revision == revision + 1
                assert grids, "the map is published in the same cycle"
                assert [change.revision for change in changes] == [correction.revision]
                changes = []
                revision, leaps = correction.revision, leaps + 1
        assert not changes, "only with a new revision"
        for grid in grids:
            assert isinstance(grid, OccupancyGrid)
            assert grid.revision == revision
        for graph in of(MapGraph, said):
            assert isinstance(graph, MapGraph)
            assert grids, "it is published with its map"
            assert graph.revision == revision
    assert leaps > 1, "a loop has moved the map"
    assert graph.key_scans > 50
    assert graph.loops_found > 3
    (last,) = corrections
    off = place(last, odometry[-1]) - PATH[-1]
    assert np.hypot(*off[:2]) < 0.1
    robot.agent.kernel.on_query(MapRequest(), Question(1), 100.0)
    (answer,) = (one for one in robot.agent.kernel.outbox if isinstance(one, Answer))
    assert isinstance(answer.message, OccupancyGrid)
    assert answer.message.revision == revision
    cells = cells_of(answer.message)
    rows, columns = np.nonzero(cells.states == OCCUPIED)
    xs = cells.x + (columns + 0.5) * cells.cell_m
    ys = cells.y + (rows + 0.5) * cells.cell_m
    near = [abs(np.abs(np.stack([xs, ys])).max(axis=0) - half) < 0.15 for half in (2.5, 4.5)]
    boxes = np.abs(np.stack([xs, ys])).max(axis=0) > 4.0
    assert np.mean(near[0] | near[1] | boxes) > 0.98
    assert cells.area(FREE) > 30.0


def test_the_same_messages_give_the_same_bytes_in_either_order_of_a_cycle() -> None:
    path = PATH[:90]
    odometry = own_odometry(path)

    def published(**how: bool) -> list[bytes]:
        robot = Robot()
        said = [robot.cycle(path[1], odometry[1]), *robot.drive(path[2:], odometry[2:], **how)]
        return [encode(message) for cycle in said for message in cycle]

    first = published()
    assert first == published()
    assert first == published(scan_first=True)
    assert len(first) > 90


def test_a_graph_that_does_not_change_is_published_each_ten_seconds() -> None:
    path = np.repeat(PATH[:1], 305, axis=0)
    said = Robot().drive(path, own_odometry(path, 0.0))
    at = [n for n, cycle in enumerate(said) if of(MapGraph, cycle)]
    assert [n // 100 for n in at] == [0, 1, 2, 3]
    assert sum(len(of(OccupancyGrid, cycle)) for cycle in said) > 25


def test_a_scan_may_come_before_its_odometry() -> None:
    path = PATH[:30]
    odometry = own_odometry(path)
    robot = Robot()
    robot.cycle(path[0], odometry[0])
    for pose, here in zip(path[1:], odometry[1:], strict=True):
        said = robot.cycle(pose, here, scan_first=True)
    (last,) = of(Correction, said)
    assert np.hypot(*(place(last, odometry[-1]) - path[-1])[:2]) < 0.1


def test_without_a_scan_nothing_is_corrected() -> None:
    robot = Robot()
    robot.drive(PATH[:3], own_odometry(PATH[:3]))
    assert not robot.cycle(PATH[3], own_odometry(PATH[:4])[3], scan=False)


def test_a_restarted_agent_begins_another_map_as_uncertain_as_the_pose() -> None:
    first, again = Robot(), Robot(seed=1)
    again.known = (0.04, 0.0, 0.0, 0.05, 0.0, 0.01)
    for robot in (first, again):
        robot.drive(PATH[:20], own_odometry(PATH[:20]))
    grids, corrections = [], []
    for robot in (first, again):
        said = robot.cycle(PATH[20], own_odometry(PATH[:21])[20])
        corrections += of(Correction, said)
        robot.agent.kernel.on_query(MapRequest(), Question(1), 100.0)
        grids += [one.message for one in robot.agent.kernel.outbox if isinstance(one, Answer)]
    assert grids[0].map_id != grids[1].map_id
    more = np.subtract(corrections[1].covariance, corrections[0].covariance)
    assert more == pytest.approx(again.known, abs=1e-9)
    assert "a new map begins" in again.logged
    assert "a new map begins" not in first.logged


def test_a_controller_that_begins_anew_does_not_move_the_robot() -> None:
    path = PATH[:40]
    odometry = own_odometry(path)
    robot = Robot()
    robot.drive(path[:20], odometry[:20])
    robot.epoch, robot.number = 2, robot.number + 10  # a new epoch is accepted after a silence
    anew = relative(odometry[19], odometry)
    for pose, here in zip(path[19:], anew[19:], strict=True):
        said = robot.cycle(pose, here)
    (last,) = of(Correction, said)
    assert np.hypot(*(place(last, anew[-1]) - path[-1])[:2]) < 0.1


def test_a_robot_without_a_laser_is_refused() -> None:
    with pytest.raises(ConfigError, match="slam needs a robot with a laser"):
        SlamAgent(Identity("slam-1"), Parameters(profile="pioneer-2dx"))


def test_a_second_agent_that_publishes_the_same_is_reported() -> None:
    robot = Robot()
    for other in (Localization(Identity("localization-1"), MAPPED), Goto(Identity("goto-1"))):
        robot.agent.kernel.met(other.kernel.card(), 1.0)
    logs = [one.message for one in robot.agent.kernel.outbox if isinstance(one, Publish)]
    assert [(log.level, "localization-1" in log.text) for log in logs if isinstance(log, Log)] == [
        (ERROR, True)
    ]


def test_a_lost_return_frees_nothing_behind_a_wall() -> None:
    robot = Robot()
    robot.drive(PATH[:1], own_odometry(PATH[:1]))
    ranges = np.full(360, 1.0)
    ranges[[40, 200, 201]] = np.inf
    scan = message_of(Cycle(1, 2), ranges, (0.0, np.radians(1.0)), (0.1, 30.0), (0.0, 0.0, 0.0))
    robot.agent.kernel.receive(RobotState(Cycle(1, 2), 0.0, 0.0, 0.0, 0, 0, 12.0, True, False), 0.2)
    robot.agent.kernel.receive(scan, 0.2)
    kept = robot.agent._drawn[-1].scan
    assert isinstance(kept, Scan)
    assert np.flatnonzero(np.isnan(ranges_of(kept))).tolist() == [40]
    assert np.isinf(ranges_of(kept)[200:202]).all()
    assert np.frombuffer(kept.packed, "<u2")[40] == INVALID


def test_a_robot_that_is_carried_is_reported_once_and_has_a_map_of_its_own() -> None:
    path = PATH[:60]
    odometry = own_odometry(path)
    far = np.array([20.0, 0.0, 0.0])
    robot = Robot()
    robot.drive(path, odometry)
    logs: list[str] = []
    for k in range(12):
        step = np.array([0.34 * k, 0.0, 0.0])
        said = robot.cycle(compose(far, step), compose(odometry[-1], step), walls=HALL)
        logs += [log.text for log in of(Log, said) if isinstance(log, Log)]
    assert [text for text in logs if "carried" in text] == [
        "the robot was carried: a new part of the map begins"
    ]
    (last,) = of(Correction, said)
    assert isinstance(last, Correction)
    assert last.confidence == 0.5
    cells = cells_of(robot.agent.on_map_request(MapRequest(), Question(1)))
    assert cells.states.shape[0] * cells.cell_m > 10.0, "only the hall"
    x, _, _ = compose(odometry[-1], step).tolist()
    assert cells.bounds[0] > x - 15.0
