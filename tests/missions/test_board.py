"""The board: which mission is next, and that it always fits into a message."""

from __future__ import annotations

import random
import zlib

import pytest
from msgspec.structs import replace

from armadico.agents.interface.messages import MissionOrder
from armadico.agents.missions.board import Missions, RefusedError, text_of
from armadico.agents.missions.messages import (
    Board,
    BoardMission,
    Course,
    MissionEnd,
    StepEnd,
    StepResult,
)
from armadico.config.places import Places
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core.config_errors import ConfigError
from armadico.core.messages import decode, encode

WAIT = 'steps = [{ do = "wait", seconds = 1 }]'


@pytest.fixture
def missions() -> Missions:
    return Missions(Places(load_world("empty"), load_profile("pioneer-2dx").body))


def order(text: str = WAIT, priority: float | None = None) -> MissionOrder:
    return MissionOrder("m", zlib.compress(text.encode()), priority)


def begin(missions: Missions) -> int:
    """The one that is chosen is done; its number."""
    entry = missions.choose()
    assert entry is not None
    before = missions.active
    if before is not None and before is not entry:
        before.listed = replace(before.listed, state=MissionEnd.SUSPENDED)
    entry.listed = replace(entry.listed, state=MissionEnd.ACTIVE)
    return entry.listed.mission


def test_the_most_urgent_is_done_and_of_equals_the_one_that_was_begun_first(
    missions: Missions,
) -> None:
    assert missions.choose() is None
    for number, priority in ((1, 0.5), (2, 0.5), (3, 0.2)):
        missions.propose(number, order(priority=priority), None)
    assert begin(missions) == 1
    missions.propose(4, order(priority=0.5), None)
    assert begin(missions) == 1
    missions.propose(5, order(priority=0.9), None)
    assert begin(missions) == 5
    done = []
    while (entry := missions.choose()) is not None:
        done.append(begin(missions))
        missions.end(entry, MissionEnd.DONE, "")
    assert done == [5, 1, 2, 4, 3]


def test_those_that_are_over_are_forgotten_the_oldest_first(missions: Missions) -> None:
    for number in range(1, 20):
        missions.end(missions.propose(number, order(), None), MissionEnd.DONE, "")
    assert list(missions.entries) == list(range(8, 20))


def test_the_end_of_a_long_waiting_mission_is_published(missions: Missions) -> None:
    missions.propose(1, order(priority=0.1), None)
    for number in range(2, 16):
        missions.propose(number, order(priority=0.9), None)
        missions.end(missions.entries[number], MissionEnd.DONE, "")
    missions.end(missions.entries[1], MissionEnd.DONE, "")
    board = missions.board(Board(1, 1, ())).missions
    assert {each.mission: each.state for each in board}[1] is MissionEnd.DONE


def test_the_end_of_each_is_published_when_all_are_cancelled(missions: Missions) -> None:
    for number in range(1, 13):
        missions.propose(number, order(), None)
    missions.cancel(0)
    assert len(missions.board(Board(1, 1, ())).missions) == 12


def test_the_board_fits_into_a_message_and_unfinished_missions_keep_the_most(
    missions: Missions,
) -> None:
    results = tuple(
        StepResult(f"{n:03}" + "move(" * 39, StepEnd.FAILED, "x" * 200, 1e5) for n in range(100)
    )
    for number in range(1, 13):
        entry = missions.propose(number, order(), None)
        entry.listed = replace(entry.listed, course=Course(results=results), note="y" * 2000)
        if number < 9:
            missions.end(entry, MissionEnd.FAILED, "z" * 2000)
    board = missions.board(Board(5, 6, (), ("R1",), ("R2",)))
    assert decode(encode(board), Board) == board
    assert (board.counter, board.by, board.alarms, board.unchecked) == (5, 6, ("R1",), ("R2",))
    kept = {m.mission: len(m.course.results) for m in board.missions}
    assert kept[12] >= 10
    assert kept[12] > kept[1]
    assert board.missions[0].course.results[-1] == results[-1]


def test_texts_that_would_fill_it_are_refused(missions: Missions) -> None:
    drawn = random.Random(1)
    noise = "".join(chr(drawn.randrange(33, 127)) for _ in range(15_000))
    long = order(f"{WAIT}\n# {noise}")
    assert len(long.text) > 5_000
    missions.propose(1, long, None)
    with pytest.raises(RefusedError, match="the board is full"):
        missions.propose(2, long, None)


def test_the_board_of_peers_is_taken_over_and_own_missions_stay(
    missions: Missions,
) -> None:
    own = missions.propose(1, order(), None)
    text = zlib.compress(WAIT.encode())
    missions.learn(
        Board(
            9,
            9,
            (
                BoardMission(2, "two", 0.5, MissionEnd.ACTIVE, text=text),
                BoardMission(3, "three", 0.5, MissionEnd.QUEUED, text=b"no text at all"),
                BoardMission(4, "four", 0.5, MissionEnd.DONE),
            ),
        )
    )
    assert missions.entries[1] is own
    assert missions.active is missions.entries[2]
    assert missions.entries[3].listed.state is MissionEnd.FAILED
    assert not missions.entries[3].goes_on
    assert not missions.entries[4].goes_on


def test_a_text_that_swells_or_is_none_is_refused() -> None:
    for packed, why in (
        (zlib.compress(b"#" * 1_000_000), "more than 16,000 characters"),
        (b"nothing", "cannot be read"),
        (zlib.compress(b"\xff\xfe"), "cannot be read"),
    ):
        with pytest.raises(ConfigError, match=why):
            text_of(packed)


def test_next_steps_are_left_out_if_the_board_is_too_large(missions: Missions) -> None:
    for number in range(1, 4):
        missions.propose(number, order(), None)
    for entry in missions.entries.values():
        entry.listed = replace(entry.listed, ahead=("x" * 2000,) * 16)
    board = missions.board(Board(1, 1))
    encode(board)
    assert len(board.missions) == 3
    assert not any(mission.ahead for mission in board.missions)
