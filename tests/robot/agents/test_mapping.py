"""The mapping agent and its method: the evidence of a ping for cells."""

from __future__ import annotations

from math import cos, inf, nan, pi, radians, sin
from pathlib import Path

import numpy as np
import pytest

from armadico.agents.methods.geometry import Placed
from armadico.agents.perception.grid_mapping import Mapper, Settings
from armadico.agents.perception.mapping import Mapping, Parameters
from armadico.config import grid_map
from armadico.config.grid_map import FREE, OCCUPIED, UNKNOWN, Cells, cells_of
from armadico.core.agent import Identity
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Cycle
from armadico.mobile.messages import Echo, MapRequest, OccupancyGrid, Pose, Scan, Sonar
from armadico.mobile.scans import message_of
from armadico.testing import Alone
from tests.robot.robots import described

HALF = radians(15.0)
HERE = Placed(0.0, 0.0, 0.0)


def mapped(*echoes: tuple[float, float | None], at: Placed = HERE, times: int = 12) -> Mapper:
    """What is known after some pings, each of them so many times: bearing and range."""
    mapper = Mapper(HALF)
    ping(mapper, *echoes, at=at, times=times)
    return mapper


def ping(
    mapper: Mapper, *echoes: tuple[float, float | None], at: Placed = HERE, times: int = 12
) -> None:
    for _ in range(times):
        for bearing, distance in echoes:
            mapper.add(at, Echo(0.0, 0.0, bearing, distance))


@pytest.mark.parametrize("bearing", [0.0, 1.0, pi, -2.5])
def test_a_cone_is_free_up_to_the_echo_and_occupied_on_the_arc(bearing: float) -> None:
    cells = mapped((bearing, 1.0)).cells()
    c, s = cos(bearing), sin(bearing)
    assert cells.at(0.6 * c, 0.6 * s) == FREE
    assert cells.at(1.0 * c, 1.0 * s) == OCCUPIED
    assert cells.at(1.2 * c, 1.2 * s) == UNKNOWN
    assert cells.at(-0.3 * c, -0.3 * s) == UNKNOWN
    aside = bearing + 1.3 * HALF
    assert cells.at(0.6 * cos(aside), 0.6 * sin(aside)) == UNKNOWN


def test_no_echo_is_little_evidence_and_only_near() -> None:
    once, often = (mapped((0.0, None), times=times).cells() for times in (3, 30))
    assert once.at(0.5, 0.0) == UNKNOWN
    assert often.at(0.5, 0.0) == FREE
    assert often.at(1.3, 0.0) == UNKNOWN
    assert not (often.states == OCCUPIED).any()


def test_what_is_farther_than_the_reach_is_left_for_a_nearer_ping() -> None:
    cells = mapped((0.0, 4.0)).cells()
    assert not (cells.states == OCCUPIED).any()
    assert cells.at(Settings().reach_m + 0.2, 0.0) == UNKNOWN


def test_an_echo_belongs_to_what_is_known_to_be_on_its_arc() -> None:
    """A door's jamb answers for the whole cone: the opening beside it stays open."""
    angle = 0.8 * HALF
    fresh = mapped((0.0, 1.0)).cells()
    assert fresh.at(1.0, 0.0) == OCCUPIED
    jamb = mapped((angle, 1.0), at=HERE)
    ping(jamb, (angle - HALF, 1.3), (0.0, 1.3), times=2)  # through the opening, beside the jamb
    ping(jamb, (0.0, 1.0))
    known = jamb.cells()
    assert known.at(cos(angle), sin(angle)) == OCCUPIED
    assert known.at(cos(angle / -2), sin(angle / -2)) != OCCUPIED


def test_what_is_behind_something_known_is_not_cleared() -> None:
    """A wall at a glancing angle does not answer, and what is behind it does."""
    mapper = mapped((0.0, 0.6))
    behind = mapper.cells()
    assert behind.at(0.6, 0.0) == OCCUPIED
    ping(mapper, (0.0, 1.4), times=2)
    assert mapper.cells().at(1.0, 0.0) == UNKNOWN


def test_what_has_gone_is_forgotten_after_seeing_through_it() -> None:
    mapper = mapped((0.0, 0.6))
    ping(mapper, (0.0, 1.4), times=60)
    assert mapper.cells().at(0.6, 0.0) == FREE


def test_the_footprint_is_free_whatever_was_sensed() -> None:
    mapper = mapped((0.0, 0.6))
    mapper.stand(Placed(0.6, 0.0, 1.0), ((0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2), (0.2, -0.2)))
    cells = mapper.cells()
    assert cells.at(0.6, 0.0) == FREE
    assert cells.at(0.6, 0.21) == FREE  # turned by 1 rad
    assert cells.at(0.6, 0.4) == UNKNOWN


def test_the_grid_grows_whichever_way_and_not_for_ever() -> None:
    mapper = Mapper(HALF)
    places = [Placed(0, 0), Placed(30, -20), Placed(-40, 35), Placed(5000, 0)]
    for place in places:
        ping(mapper, (0.0, 1.0), at=place)
    cells = mapper.cells()
    for place in places[:3]:
        assert cells.at(place.x + 1.0, place.y) == OCCUPIED
    assert cells.at(5001.0, 0.0) == UNKNOWN
    assert cells.bounds[2] < 40.0


def test_it_goes_on_with_a_map_in_its_cells_and_unlearns_what_is_wrong() -> None:
    saved = mapped((0.0, 1.0), (2.0, 1.2)).cells()
    mapper = Mapper(HALF)
    mapper.resume(saved)
    again = mapper.cells()
    assert np.array_equal(again.states, saved.states)
    assert (again.x, again.y) == pytest.approx((saved.x, saved.y))
    ping(mapper, (0.0, 1.4), times=60)
    assert mapper.cells().at(1.0, 0.0) == FREE


def test_a_map_of_another_resolution_goes_on_where_its_cells_are() -> None:
    states = np.full((40, 40), FREE, dtype=np.uint8)
    mapper = Mapper(HALF)
    mapper.resume(Cells(-1.03, -2.01, 0.08, states))
    ping(mapper, (0.0, 1.0), at=Placed(1.2, -0.4))
    cells = mapper.cells()
    assert cells.cell_m == 0.08
    assert (cells.x, cells.y) == pytest.approx((-1.03, -2.01))
    assert cells.at(2.2, -0.4) == OCCUPIED
    assert cells.at(2.3, -0.4) == UNKNOWN


# The agent ----------------------------------------------------------------------------------------


class Ring(Alone):
    """A mapping agent, and a robot at rest with echoes from a wall."""

    def __init__(self, parameters: Parameters | None = None) -> None:
        super().__init__(Mapping(Identity("mapping-1"), parameters), robot=described())

    def cycle(self, *, pose_first: bool = False, pose: bool = True) -> None:
        self.state()
        messages = [Sonar(self.at, 5.0, (Echo(0.2, 0.0, 0.0, 1.0),))]
        messages = [*messages, *([Pose(self.at, 2.0, 1.0, 0.0)] if pose else [])]
        self.give(*messages[:: -1 if pose_first else 1])

    def map(self) -> OccupancyGrid:
        """The map on request."""
        found = self.query(MapRequest())
        assert isinstance(found, OccupancyGrid)
        return found


@pytest.mark.parametrize("pose_first", [False, True])
def test_pings_are_put_where_the_robot_was_in_their_cycle(pose_first: bool) -> None:
    ring = Ring()
    for _ in range(12):
        ring.cycle(pose_first=pose_first)
    first, second = ring.all(OccupancyGrid)  # one a second
    assert cells_of(second).at(3.2, 1.0) == OCCUPIED
    assert cells_of(second).at(2.6, 1.0) == FREE
    assert cells_of(first).area(FREE) <= cells_of(second).area(FREE)


def test_a_ping_without_a_pose_of_its_cycle_is_left_out() -> None:
    ring = Ring()
    ring.cycle()
    for _ in range(20):
        ring.cycle(pose=False)
    (only,) = ring.all(OccupancyGrid)
    assert not (cells_of(only).states == OCCUPIED).any()


def continued(wall_m: float, folder: Path) -> Ring:
    """A mapping agent that has seen a wall 1 m ahead, with a saved one that has it so far ahead."""
    saved = mapped((0.0, wall_m), (pi, 1.0), at=Placed(2.2, 1.0, 0.0))
    file, _ = grid_map.save(saved.cells(), folder / "saved.yaml")
    ring = Ring(Parameters(resume=str(file)))
    assert not ring.map().rows, "nothing is seen yet"
    for _ in range(25):
        ring.cycle()
    return ring


def test_a_saved_map_is_continued_once_what_is_seen_agrees_with_it(tmp_path: Path) -> None:
    ring = continued(1.0, tmp_path)
    published = ring.last(OccupancyGrid)
    for grid in (published, ring.map()):
        assert cells_of(grid).at(3.2, 1.0) == OCCUPIED
        assert cells_of(grid).at(1.2, 1.0) == OCCUPIED, "of the saved one"
    assert published.map_id == 0


def test_a_saved_map_that_is_contradicted_is_not_mixed_with_what_is_seen(tmp_path: Path) -> None:
    ring = continued(0.5, tmp_path)
    published = ring.last(OccupancyGrid)
    assert cells_of(published).at(3.2, 1.0) == OCCUPIED
    assert cells_of(published).at(1.2, 1.0) == UNKNOWN, "only the saved one has that wall"
    assert published.map_id, "it is another map: an exploration of the saved one fails"
    assert not ring.map().rows, "nothing is saved over the map that was to be continued"


def test_a_saved_map_that_cannot_be_read_is_an_error(tmp_path: Path) -> None:
    file, image = grid_map.save(mapped((0.0, 1.0)).cells(), tmp_path / "saved.yaml")
    image.unlink()
    with pytest.raises(ConfigError, match=r"saved\.pgm"):
        Mapping(Identity("mapping-2"), Parameters(resume=str(file)))


# A laser ------------------------------------------------------------------------------------------


MIDDLE = Placed(0.02, 0.02, 0.0)
"""Not on the line between two cells."""


def scanned(*rays: tuple[float, float], at: Placed = HERE, times: int = 3) -> Mapper:
    """What is known after a scan with these ranges at these bearings, and no others valid."""
    mapper = Mapper()
    for _ in range(times):
        mapper.see(at, scan(*rays))
    return mapper


def scan(*rays: tuple[float, float], cycle: Cycle = Cycle(1, 1)) -> Scan:  # noqa: B008 - frozen
    ranges = np.full(360, nan)
    for bearing, distance in rays:
        ranges[round(bearing / radians(1.0)) % 360] = distance
    return message_of(cycle, ranges, (0.0, radians(1.0)), (0.1, 30.0), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("bearing", [0.0, 1.0, pi, -2.5])
def test_a_ray_is_a_line_that_is_free_up_to_what_it_met(bearing: float) -> None:
    bearing = radians(round(bearing / radians(1.0)))
    cells = scanned((bearing, 2.01), at=MIDDLE).cells()
    c, s = cos(bearing), sin(bearing)
    for way in (0.1, 1.0, 1.9):
        assert cells.at(0.02 + way * c, 0.02 + way * s) == FREE
    assert cells.at(0.02 + 2.01 * c, 0.02 + 2.01 * s) == OCCUPIED
    assert cells.at(0.02 + 2.2 * c, 0.02 + 2.2 * s) == UNKNOWN
    assert cells.at(0.02 + c - 0.1 * s, 0.02 + s + 0.1 * c) == UNKNOWN, "no cone"


def test_a_ray_without_a_return_is_free_for_a_limited_range_and_an_invalid_one_is_none() -> None:
    cells = scanned((0.0, inf), (radians(90), 0.0), (radians(180), 12.0), at=MIDDLE).cells()
    p = Settings()
    assert cells.at(p.unseen_m - 0.2, 0.02) == FREE
    assert cells.at(p.unseen_m + 0.2, 0.02) == UNKNOWN
    assert cells.at(0.02, 0.5) == UNKNOWN
    assert cells.at(0.2 - p.seen_m, 0.02) == FREE
    assert cells.at(-11.98, 0.02) == UNKNOWN, "too far: left for a nearer scan"
    assert not (cells.states == OCCUPIED).any()
    assert not Mapper().cells().states.size


def test_what_a_ray_met_is_not_free_for_the_one_beside_it_and_may_be_unlearnt() -> None:
    ahead, beside = (0.0, 4.0), (radians(1.0), 4.2)
    mapper = scanned(ahead, beside, at=MIDDLE, times=6)
    assert mapper.cells().at(4.02, 0.02) == OCCUPIED
    for _ in range(20):
        mapper.see(MIDDLE, scan((0.0, 6.0)))
    assert mapper.cells().at(4.02, 0.02) == FREE
    assert mapper.cells().at(6.02, 0.02) == OCCUPIED
