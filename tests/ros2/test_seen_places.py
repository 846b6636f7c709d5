"""Localization by a laser: the model, and the agent that weighs its scans."""

from __future__ import annotations

from math import hypot, inf, nan, pi, radians
from random import Random
from typing import Literal

import numpy as np
import pytest
from msgspec.structs import replace

from armadico.agents.localization.laser_model import BEAMS, RANDOM, LaserModel, beams_of
from armadico.agents.localization.localization import Localization, Parameters
from armadico.agents.methods.grid import Grid
from armadico.bridge.simulator.laser import LaserScanner
from armadico.bridge.simulator.plant import seeded
from armadico.bridge.simulator.walls import DEAD, Walls
from armadico.config.loading import load_entry
from armadico.config.profile import SensorProfile, load_profile
from armadico.config.shipped import find
from armadico.config.worlds import load_world
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, RobotState
from armadico.core.outgoing import Publish
from armadico.mobile.behaviour import LOST_M, UNSURE_M
from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import Correction, Echo, Pose, Scan, Sonar
from armadico.mobile.scans import message_of

WORLD = load_world("house")
GRID = Grid(WORLD.outlines, WORLD.bounds)
REAL = load_entry(find("robots", "sensors"), SensorProfile, "real")
LASER = load_profile("jackal").laser
START: Pose2 = (2.2, 4.4, 0.3)


def scanner() -> LaserScanner:
    assert LASER is not None
    world = Walls()
    world.add(WORLD.walls, [DEAD] * len(WORLD.walls))
    return LaserScanner(LASER, REAL, world, seeded(1))


def scan_at(sees: LaserScanner, pose: Pose2, number: int = 0, cycle: Cycle = Cycle(1, 1)) -> Scan:  # noqa: B008
    assert LASER is not None
    angles = radians(LASER.angle_min_deg), radians(LASER.step_deg)
    mount = LASER.x_m, LASER.y_m, radians(LASER.bearing_deg)
    limits = LASER.min_m, LASER.max_m
    return message_of(cycle, sees.scan(pose), angles, limits, mount, number=number)


# The model ----------------------------------------------------------------------------------------


def fits(model: LaserModel, poses: list[Pose2], beams: list[Echo]) -> np.ndarray:
    found = model.likelihood(np.array(poses, dtype=np.float32), beams)
    assert found.shape == (len(poses), len(beams))
    return np.log(found).mean(axis=1)


def test_a_scan_fits_best_where_it_was_taken_and_walls_on_the_maps_edge_count() -> None:
    sees, model, rng = scanner(), LaserModel(GRID), Random(1)
    rows, columns = np.nonzero(GRID.clearance > 0.4)
    for number in range(5):
        at = rng.randrange(len(rows))
        pose = (GRID.xs[columns[at]], GRID.ys[rows[at]], rng.uniform(-pi, pi))
        beams = beams_of(scan_at(sees, pose, number))
        assert len(beams) == BEAMS
        offs = [(0, 0, 0), (0.15, 0, 0), (-0.15, 0, 0), (0, 0.15, 0), (0, -0.15, 0), (0, 0, 0.1)]
        poses = [(pose[0] + x, pose[1] + y, pose[2] + t) for x, y, t in offs]
        here, *others = fits(model, poses, beams)
        assert here > np.log(0.9)
        assert max(others) < here - 0.05


def test_beyond_the_map_nothing_fits_and_guesses_may_lie_anywhere() -> None:
    model = LaserModel(GRID)
    beams = [Echo(0.1, 0.0, 0.0, 2.0)]
    far = np.array([(-500.0, 3.0, 0.0), (1e6, -1e6, 1.0)], dtype=np.float32)
    assert model.likelihood(far, beams) == pytest.approx(RANDOM, abs=1e-4)


def test_rays_without_a_hit_are_left_out_and_the_others_evenly_drawn() -> None:
    ranges = np.full(700, inf)
    ranges[100:300], ranges[300:310] = 2.0, nan
    sent = message_of(Cycle(1, 1), ranges, (-1.0, 0.003), (0.1, 30.0), (0, 0, 0), number=1)
    beams = beams_of(sent)
    assert 30 <= len(beams) <= BEAMS
    assert all(b.range == 2.0 for b in beams)
    assert beams[-1].bearing - beams[0].bearing > 0.55
    other = beams_of(replace(sent, number=2))
    assert {b.bearing for b in other}.isdisjoint({b.bearing for b in beams})
    assert beams_of(replace(sent, packed=b"")) == []


# The agent ----------------------------------------------------------------------------------------


class Society:
    """A localization agent, and a robot with a laser whose odometry is off by a little."""

    def __init__(self, parameters: Parameters) -> None:
        self.agent = Localization(Identity("localization-1", rng=Random(1)), parameters)
        self.sees, self.pose, self.now, self.number = scanner(), START, 0.0, 0
        self.odometry: Pose2 = (0.0, 0.0, 0.0)

    def cycle(self, motion: Pose2 = (0.04, 0.0, 0.02), *, scans: bool = True) -> Correction | None:
        self.now += 0.1
        self.number += 1
        self.pose = compose(self.pose, motion)
        self.odometry = compose(self.odometry, (1.03 * motion[0], 0.0, 0.97 * motion[2]))
        cycle = Cycle(1, self.number)
        take = self.agent.kernel.receive
        take(RobotState(cycle, *self.odometry, 0.4, 0, 12, True, False), self.now)
        each = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)
        take(Pose(cycle, *compose(START, self.odometry), each), self.now)
        if scans:
            take(scan_at(self.sees, self.pose, self.number, cycle), self.now)
        out, self.agent.kernel.outbox = self.agent.kernel.outbox, []
        messages = [o.message for o in out if isinstance(o, Publish)]
        found = [message for message in messages if isinstance(message, Correction)]
        return found[-1] if found else None

    def off(self, correction: Correction) -> float:
        x, y, _ = compose((correction.x, correction.y, correction.theta), self.odometry)
        return hypot(x - self.pose[0], y - self.pose[1])


JACKAL = Parameters(world="house", profile="jackal")


def test_a_robot_with_a_laser_knows_where_it_is_to_centimetres() -> None:
    society = Society(JACKAL)
    for _ in range(60):
        correction = society.cycle()
    assert correction is not None
    assert society.off(correction) < 0.03
    assert correction.confidence > 0.9
    assert correction.covariance[0] + correction.covariance[3] < 0.05**2


def test_a_kidnapped_robot_is_found() -> None:
    society = Society(JACKAL)
    for _ in range(20):
        society.cycle()
    society.pose = (9.0, 4.6, 2.0)
    lost = found = False
    for step in range(300):
        correction = society.cycle((0.03 if step % 80 < 30 else 0.0, 0.0, 0.08))
        assert correction is not None
        unsure = correction.covariance[0] + correction.covariance[3] > LOST_M**2
        lost = lost or unsure
        found = lost and not unsure and society.off(correction) < 0.1
        if found:
            break
    assert found, f"after {step} cycles"


@pytest.mark.parametrize("motion", ["wheels", "scans"])
def test_a_kidnapped_robot_at_rest_is_suspicious_too(motion: Literal["wheels", "scans"]) -> None:
    """Its scans contradict those before, so by them it is lost, which is more."""
    society = Society(replace(JACKAL, motion=motion))
    for _ in range(20):
        society.cycle()
    society.pose = (9.0, 4.6, 2.0)
    for _ in range(25):
        society.cycle((0.0, 0.0, 0.04))  # it turns by a radian, and stands
    correction = [society.cycle((0.0, 0.0, 0.0)) for _ in range(50)]
    assert correction[-1] is not None
    assert correction[-1].covariance[0] + correction[-1].covariance[3] > UNSURE_M**2
    if motion == "wheels":
        assert correction[-1].elsewhere
    else:
        assert correction[-1].confidence == 0.0


def test_sonars_do_not_count_beside_a_laser_and_a_scan_counts_once() -> None:
    society = Society(JACKAL)
    for _ in range(5):
        society.cycle()
    weighed = []
    weigh = society.agent._filter.weigh
    society.agent._filter.weigh = lambda echoes: (weighed.append(len(echoes)), weigh(echoes))[1]  # type: ignore[method-assign]
    assert society.cycle(scans=False) is None
    cycle = Cycle(1, society.number)
    society.agent.kernel.receive(Sonar(cycle, 5.0, (Echo(0, 0, 0, 1.0),)), society.now)
    assert weighed == []
    sent = scan_at(society.sees, society.pose, 77, cycle)
    society.agent.kernel.receive(sent, society.now)
    assert len(weighed) == 1
    assert weighed[0] > 0.9 * BEAMS
    society.cycle(scans=False)
    again = replace(sent, cycle=Cycle(1, society.number))
    society.agent.kernel.receive(again, society.now)
    assert weighed[1:] == [0], "the same scan again"
    society.agent.kernel.receive(replace(again, packed=b"abc", number=78), society.now)
    assert weighed[1:] == [0]


def test_a_large_map_takes_cells_of_its_own_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("armadico.agents.localization.laser_model.LARGE", 10)
    sees, model = scanner(), LaserModel(GRID)
    assert 1.0 / model._inverse == pytest.approx(GRID.cell_m)
    assert fits(model, [START], beams_of(scan_at(sees, START)))[0] > np.log(0.8)


def test_its_correction_is_the_odometrys_origin() -> None:
    society = Society(JACKAL)
    correction = society.cycle()
    assert correction is not None
    assert (
        relative(START, compose((correction.x, correction.y, correction.theta), society.odometry))[
            0
        ]
        < 0.3
    )
