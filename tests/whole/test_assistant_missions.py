"""The assistant agent and missions."""

from __future__ import annotations

import zlib

import pytest

from armadico.agents.interface.messages import MissionCancel, MissionOrder
from armadico.agents.missions.messages import Board, BoardMission, MissionEnd
from tests.watch.test_assistant import STOPPED, Counter


def test_only_its_own_missions_are_cancelled() -> None:
    counter = Counter()
    ended = MissionEnd.ACTIVE
    mine = BoardMission(5, "rounds", 0.0, ended, by="assistant: model")
    anns = BoardMission(6, "surveillance", 0.5, ended, by="ann")
    others = BoardMission(8, "rounds", 0.0, ended, by="assistant: other")
    counter.receive(Board(1, 9, (mine, anns, others)), STOPPED)
    assert "ann" in counter.refusal("cancel", number="6")
    assert "by assistant: other" in counter.refusal("cancel", number="8")
    assert "7" in counter.refusal("cancel", number="7")
    counter.request("cancel", number="5")  # even while it is stopped
    assert counter.queries[-1].request == MissionCancel(5, "assistant: model")


def test_no_mission_begins_while_the_robot_is_stopped() -> None:
    """The release would set the robot in motion unexpectedly."""
    counter = Counter()
    counter.receive(STOPPED)
    for refusal in (
        counter.refusal("goto", x=1, y=0),
        counter.refusal("mission", name="surveillance"),
    ):
        assert "ann" in refusal
    assert not counter.queries


def test_a_mission_is_ordered_by_its_name_at_the_lowest_priority() -> None:
    counter = Counter()
    counter.request("mission", name="surveillance")
    order = counter.queries[-1].request
    assert isinstance(order, MissionOrder)
    assert (order.name, order.priority, order.by) == ("surveillance", 0.0, "assistant: model")
    assert b"# Thesis 3.6.1" in zlib.decompress(order.text)
    counter.reply_to_query(None)
    assert counter.queries[-1].request == MissionCancel(order.mission, order.by), "or done later"


@pytest.mark.parametrize("name", ["/etc/passwd", "../surveillance.toml", "surveillanse", "."])
def test_an_unknown_mission_is_refused_and_no_file_is_read(name: str) -> None:
    refusal = Counter().refusal("mission", name=name)
    assert repr(name) in refusal
    assert "surveillance" in refusal, "the known ones are listed"
