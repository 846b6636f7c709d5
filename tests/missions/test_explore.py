"""The explore agent: from frontier to frontier by missions of the interface agent, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.grid import Margins
from armadico.agents.missions.explore import Explore, Parameters
from armadico.agents.missions.frontiers import Chart, crossed
from armadico.agents.missions.messages import (
    ChargeState,
    ChargeStatus,
    ExploreRequest,
    ExploreState,
    ExploreStatus,
)
from armadico.config.grid_map import FREE, OCCUPIED, UNKNOWN, Cells, message_of
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Message
from armadico.mobile.messages import (
    COVARIANCE,
    BatteryLevel,
    Correction,
    MapMoved,
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Moved,
    OccupancyGrid,
    Pose,
    Waypoint,
)
from armadico.testing import Alone

TRIES = (Margins(0.3), Margins(0.25))
WIDE = (-100.0, -100.0, 100.0, 100.0)
HERE = Placed(1.0, 1.0)


def hall(length: float = 4.0, *, end: int = UNKNOWN) -> Cells:
    """Free from 0 to `length` along x and from 0 to 2 m along y, walls along it."""
    states = np.full((44, round(length / 0.05) + 4), OCCUPIED, dtype=np.uint8)
    states[2:-2, 2:] = FREE
    states[2:-2, -2:] = end
    return Cells(-0.1, -0.1, 0.05, states)


def box(cells: Cells, x1: float, y1: float, x2: float, y2: float, state: int) -> Cells:
    states = cells.states.copy()
    rows = slice(round((y1 - cells.y) / 0.05), round((y2 - cells.y) / 0.05))
    columns = slice(round((x1 - cells.x) / 0.05), round((x2 - cells.x) / 0.05))
    states[rows, columns] = state
    return Cells(cells.x, cells.y, cells.cell_m, states)


# Frontiers ----------------------------------------------------------------------------------------


def test_the_way_leads_to_where_what_is_known_ends() -> None:
    way = Chart(hall(), WIDE).to_frontier(HERE, TRIES)
    assert way is not None
    assert way[0] == HERE
    assert way[-1].x == pytest.approx(3.95, abs=0.15)
    assert 0.3 <= way[-1].y <= 1.7


def test_a_room_that_is_closed_has_no_frontier() -> None:
    assert Chart(hall(end=OCCUPIED), WIDE).to_frontier(HERE, TRIES) is None


def test_pockets_too_narrow_for_the_robot_and_places_outside_are_none() -> None:
    closed = hall(end=OCCUPIED)
    pocket = box(closed, 0.0, 0.0, 0.2, 0.2, UNKNOWN)
    assert Chart(pocket, WIDE).to_frontier(HERE, TRIES) is None
    assert Chart(hall(), (0.0, 0.0, 3.0, 2.0)).to_frontier(HERE, TRIES) is None


def test_the_nearest_frontier_comes_first_and_one_that_was_given_up_last() -> None:
    cells = box(hall(), 2.0, 1.0, 2.5, 1.5, UNKNOWN)
    first = Chart(cells, WIDE).to_frontier(HERE, TRIES)
    assert first is not None
    assert first[-1].x == pytest.approx(1.95, abs=0.15)
    around = [Placed(2.25, 1.25), first[-1]]
    around += [Placed(x, y) for x in (1.9, 2.25, 2.6) for y in (0.9, 1.25, 1.6)]
    second = Chart(cells, WIDE).to_frontier(HERE, TRIES, around)
    assert second is not None
    assert second[-1].x > 3.0


def test_a_way_leads_over_what_is_known_and_round_what_is_not() -> None:
    cells = box(hall(end=OCCUPIED), 2.0, 0.0, 2.3, 1.2, UNKNOWN)
    chart = Chart(cells, WIDE)
    way = chart.way(HERE, Placed(3.5, 1.0), TRIES)
    assert way is not None
    assert max(place.y for place in way) > 1.2
    assert chart.way(HERE, Placed(9.0, 1.0), TRIES) is None


def test_a_frontier_is_none_once_what_is_beyond_is_known() -> None:
    chart = Chart(hall(), WIDE)
    way = chart.to_frontier(HERE, TRIES)
    assert way is not None
    assert chart.unknown_at(way[-1], TRIES[0])
    for known in (hall(6.0), hall(end=OCCUPIED)):
        assert not Chart(known, WIDE).unknown_at(way[-1], TRIES[0])


def test_a_way_is_crossed_by_what_was_seen_on_it() -> None:
    way = [HERE, Placed(3.0, 1.0)]
    assert not crossed(hall(), way)
    assert crossed(box(hall(), 2.0, 0.9, 2.05, 1.1, OCCUPIED), way)
    assert not crossed(hall(), [])


# The agent ----------------------------------------------------------------------------------------


class Desk(Alone):
    """An explore agent; a mapping and an interface agent that say what they are told to."""

    def __init__(self, cells: Cells | None = None) -> None:
        super().__init__(Explore(Identity("explore-1"), Parameters(tries=2)), robot=None)
        self.agent.kernel.start(0.0)
        self.mission, self.refusal = 0, ""
        self.moved(1.0, 1.0)
        if cells is not None:
            self.map(cells)

    def moved(self, x: float, y: float, after: float = 0.1) -> None:
        self.state(cycles=round(after / 0.1))
        self.give(Pose(self.at, x, y, 0.0))

    def map(self, cells: Cells) -> None:
        self.give(message_of(cells))

    def status(self, state: MissionState, to_go: float = 1.0, mission: int | None = None) -> None:
        self.give(MissionStatus(self.mission if mission is None else mission, state, to_go))

    def tick(self) -> None:
        self.agent.on_wakeup()
        self.collect()

    def charge(self, state: ChargeState, share: float = 0.5) -> None:
        self.give(BatteryLevel(self.at, 12.0, share, 1e5), ChargeStatus(self.at, state))

    def begin(self, **more: Any) -> MissionReply:
        reply = self.query(ExploreRequest(-1.0, -1.0, 9.0, 3.0, **more))
        assert isinstance(reply, MissionReply)
        return reply

    @property
    def exploring(self) -> ExploreStatus:
        return self.last(ExploreStatus)

    @property
    def sent(self) -> list[MissionRequest]:
        return [each.request for each in self.on_query if isinstance(each.request, MissionRequest)]

    def collect(self) -> list[Message]:
        """Each of its missions is taken on, or refused."""
        found = super().collect()
        if self.waits:
            self.mission += 1
            number = 0 if self.refusal else self.mission
            found += self.reply(MissionReply(number, self.refusal, length=3.0))
        return found


def exploring(**more: Any) -> Desk:
    """Under way to the end of a hall."""
    desk = Desk(hall())
    desk.begin(**more)
    desk.map(hall())
    return desk


def test_without_a_map_or_a_pose_nothing_begins() -> None:
    assert "no mapping/grid" in Desk().begin().refusal
    desk = Desk(hall())
    desk.agent.cycles.advance(Cycle(1, 90), 9.0)
    assert "no fresh encoder/pose" in desk.begin().refusal


def test_a_robot_outside_of_what_is_to_be_explored_does_not_begin() -> None:
    desk = Desk(hall())
    desk.moved(20.0, 0.0)
    assert "not in the rectangle" in desk.begin().refusal


def test_it_sends_the_robot_to_a_frontier_and_on_once_that_is_known() -> None:
    desk = Desk(hall())
    assert desk.begin().mission
    desk.map(hall())
    (first,) = desk.sent
    assert not first.planned
    assert first.goal.x == pytest.approx(3.95, abs=0.15)
    desk.map(hall())
    assert len(desk.sent) == 1
    desk.map(hall(6.0))
    assert desk.sent[-1].goal.x == pytest.approx(5.95, abs=0.15)


def test_when_nothing_is_left_it_goes_home_and_is_done() -> None:
    desk = Desk(hall())
    begun = desk.begin(home=Waypoint(1.0, 1.0, 0.5))
    desk.map(hall())
    desk.moved(3.5, 1.0)
    desk.map(hall(end=OCCUPIED))
    assert desk.exploring.state is ExploreState.RETURNING
    assert desk.sent[-1].goal == Waypoint(1.0, 1.0, 0.5)
    desk.status(MissionState.DRIVING)
    desk.status(MissionState.REACHED, 0.0)
    assert desk.exploring.state is ExploreState.DONE
    assert desk.exploring.exploration == begun.mission
    assert not desk.exploring.given_up


def test_what_it_sees_on_the_way_home_is_explored_from_there() -> None:
    desk = exploring(home=Waypoint(1.0, 1.0, 0.5))
    desk.moved(3.5, 1.0)
    desk.map(hall(end=OCCUPIED))
    desk.status(MissionState.DRIVING)
    desk.map(hall())  # there is an opening after all
    assert desk.exploring.state is ExploreState.RETURNING
    desk.moved(1.0, 1.0)
    desk.status(MissionState.REACHED, 0.0)
    assert desk.exploring.state is ExploreState.EXPLORING
    desk.map(hall())
    assert desk.sent[-1].goal.x == pytest.approx(3.95, abs=0.15)
    desk.map(hall(end=OCCUPIED))
    desk.status(MissionState.DRIVING)
    desk.status(MissionState.REACHED, 0.0)
    assert desk.exploring.state is ExploreState.DONE


@pytest.mark.parametrize(
    ("end", "state", "x"),
    [(OCCUPIED, ExploreState.RETURNING, 1.0), (UNKNOWN, ExploreState.EXPLORING, 3.95)],
)
def test_it_gets_out_of_a_gap_that_the_map_has_closed_behind_it(
    end: int, state: ExploreState, x: float
) -> None:
    """The gap is as wide as the robot, but has none of the clearances of a path."""
    cells = hall(end=end)
    for low, high in (0.0, 0.75), (1.25, 2.0):
        cells = box(cells, 2.0, low, 2.1, high, OCCUPIED)
    home = 1.0 if end == OCCUPIED else 3.0
    desk = Desk(cells)
    desk.moved(4.0 - home, 1.0)
    desk.begin(home=Waypoint(home, 1.0, 0.5))
    desk.map(cells)
    assert desk.exploring.state is state
    assert desk.sent[-1].goal.x == pytest.approx(x, abs=0.15)


def test_a_way_that_turns_out_to_be_shut_is_planned_anew() -> None:
    desk = exploring()
    y = desk.sent[-1].goal.y
    desk.map(box(hall(), 2.0, y - 0.1, 2.1, y + 0.1, OCCUPIED))
    assert len(desk.sent) == 2
    assert desk.sent[-1].waypoints  # round it


def test_a_place_that_it_does_not_come_nearer_to_is_tried_once_more_and_then_told() -> None:
    desk = Desk(hall())
    desk.begin()
    for _ in range(40):
        desk.map(hall())
        if desk.exploring.state is ExploreState.RETURNING:
            break
        desk.status(MissionState.DRIVING, 2.9)
        for _ in range(20):
            desk.moved(1.0, 1.0, 1.0)
        desk.map(hall())
        desk.tick()
    assert desk.exploring.state is ExploreState.RETURNING
    desk.status(MissionState.REACHED)
    assert desk.exploring.state is ExploreState.FAILED
    assert "could not be reached" in desk.exploring.note
    assert desk.exploring.given_up


def test_coming_nearer_is_progress_and_so_is_a_stop() -> None:
    desk = exploring()
    for step in range(5):
        desk.moved(1.0, 1.0, 10.0)
        desk.map(hall())
        desk.status(MissionState.DRIVING, 2.5 - 0.3 * step)
        desk.tick()
    assert len(desk.sent) == 1
    assert not desk.exploring.given_up


def test_whoever_sends_the_robot_elsewhere_ends_it() -> None:
    desk = exploring()
    desk.map(hall(6.0))
    desk.status(MissionState.DRIVING, mission=1)  # late, of its own first
    assert desk.exploring.state is ExploreState.EXPLORING
    desk.status(MissionState.DRIVING, mission=77)
    assert desk.exploring.state is ExploreState.FAILED
    assert "elsewhere" in desk.exploring.note


def test_it_goes_on_once_the_robot_is_charged() -> None:
    desk = exploring()
    desk.charge(ChargeState.TO_DOCK)
    for state in (ChargeState.TO_DOCK, ChargeState.DOCKING, ChargeState.CHARGING):
        desk.charge(state)
        desk.status(MissionState.DRIVING, mission=77)
        for _ in range(3):
            desk.moved(1.0, 1.0, 10.0)  # no nearer, for long
            desk.tick()
            desk.map(hall())
    assert desk.exploring.state is ExploreState.EXPLORING
    assert len(desk.sent) == 1
    desk.moved(1.0, 1.0)
    desk.charge(ChargeState.CHARGING, share=0.85)
    desk.tick()
    desk.map(hall())
    assert len(desk.sent) == 2
    desk.status(MissionState.DRIVING, mission=1)  # late, of its own first
    desk.charge(ChargeState.NONE)
    desk.status(MissionState.DRIVING, mission=78)  # and this is nobody's charging
    assert desk.exploring.state is ExploreState.FAILED


def test_a_charger_that_gives_up_leaves_it_the_robot() -> None:
    desk = exploring()
    desk.charge(ChargeState.TO_DOCK)
    desk.status(MissionState.DRIVING, mission=77)
    desk.map(hall())
    assert len(desk.sent) == 1
    desk.charge(ChargeState.NONE)
    desk.tick()
    desk.map(hall())
    assert len(desk.sent) == 2


def test_missions_that_are_refused_and_a_map_that_ends_are_told() -> None:
    desk = Desk(hall())
    desk.refusal = "no"
    desk.begin()
    desk.map(hall())
    desk.map(hall())
    assert desk.exploring.state is ExploreState.FAILED
    assert "refused: no" in desk.exploring.note
    desk = exploring()
    desk.moved(1.0, 1.0, 20.0)
    desk.tick()
    assert "no map for 15 s" in desk.exploring.note


def test_a_map_that_begins_anew_ends_it_and_the_robot_stops() -> None:
    desk = Desk()
    desk.give(message_of(hall(), map_id=1))
    desk.begin()
    desk.give(message_of(hall(), map_id=1))
    desk.status(MissionState.DRIVING)
    desk.moved(2.0, 1.0)
    under_way = desk.mission
    desk.give(message_of(hall(), map_id=2))
    assert desk.exploring.state is ExploreState.FAILED
    assert "the map was lost" in desk.exploring.note
    assert desk.sent[-1].goal == Waypoint(2.0, 1.0, 0.0)
    assert desk.sent[-1].replaces == under_way, "a mission of a person goes on"
    desk.give(message_of(hall(6.0), map_id=2))
    assert desk.sent[-1].replaces == under_way, "nothing is driven to any more"


def test_what_is_no_map_is_left_out() -> None:
    desk = Desk(hall())
    desk.begin()
    desk.give(OccupancyGrid(0.0, 0.0, 0.05, 9, 9, b"no"))
    desk.map(hall())
    assert len(desk.sent) == 1


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 1, 0), (2, 0, 1)])
def test_a_map_that_moves_takes_its_places_along_and_another_target_is_chosen(
    order: tuple[int, ...],
) -> None:
    """Grid, change and pose of a revision come in any order: it is chosen once, with all three."""
    desk = exploring(home=Waypoint(1.0, 1.0, 0.0))
    count = len(desk.sent)
    higher = hall()
    higher = Cells(higher.x, higher.y + 1.0, higher.cell_m, higher.states)
    desk.state()
    news: list[Message] = [
        message_of(higher, 2),
        MapMoved(2, (Moved(1.0, 1.0, 1.0, 2.0, 0.0),)),
        Pose(desk.at, 1.0, 2.0, 0.0, revision=2),
    ]
    for k in order[:2]:
        desk.give(news[k])
    assert len(desk.sent) == count
    desk.give(news[order[2]])
    if order[2] != 2:  # a pose comes in each cycle
        desk.state()
        desk.give(Pose(desk.at, 1.0, 2.0, 0.0, revision=2))
    assert len(desk.sent) == count + 1
    assert desk.sent[-1].revision == 2
    assert 1.3 <= desk.sent[-1].goal.y <= 2.7
    desk.give(message_of(box(higher, 3.5, 1.0, 4.2, 3.0, OCCUPIED), 2))
    assert desk.sent[-1].goal == Waypoint(1.0, 2.0, 0.0)


@pytest.mark.parametrize("correction_first", [True, False])
def test_home_stays_while_a_carried_robot_maps_a_part_of_its_own(correction_first: bool) -> None:
    desk = Desk(hall())
    home = Waypoint(1.0, 1.0, 0.0)
    desk.begin(home=home)

    def corrected(confidence: float, revision: int) -> Correction:
        desk.state()
        zero = (0.0,) * COVARIANCE
        return Correction(desk.at, 0.0, 0.0, 0.0, zero, confidence, revision=revision)

    desk.give(MapMoved(2))
    desk.give(corrected(0.5, 2))
    joins = [corrected(1.0, 3), MapMoved(3, (Moved(1.0, 1.0, 9.0, 9.0, 0.0),))]
    for news in joins if correction_first else joins[::-1]:
        desk.give(news)
    assert desk.agent._exploration.places.home == home
    desk.give(corrected(1.0, 3))  # one comes in each cycle
    desk.give(MapMoved(4, (Moved(1.0, 1.0, 1.5, 1.0, 0.0),)))
    assert desk.agent._exploration.places.home == Waypoint(1.5, 1.0, 0.0)
