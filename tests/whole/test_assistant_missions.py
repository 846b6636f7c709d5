"""The assistant agent and missions."""

from __future__ import annotations

from armadico.agents.interface.messages import MissionCancel
from armadico.agents.missions.messages import Board, BoardMission, MissionEnd
from tests.watch.test_assistant import STOPPED, Counter


def test_only_its_own_missions_are_cancelled() -> None:
    counter = Counter()
    ended = MissionEnd.ACTIVE
    mine = BoardMission(5, "rounds", 0.0, ended, by="assistant: model")
    anns = BoardMission(6, "surveillance", 0.5, ended, by="ann")
    counter.receive(Board(1, 9, (mine, anns)), STOPPED)
    assert "ann" in counter.refusal("cancel", number="6")
    assert "7" in counter.refusal("cancel", number="7")
    counter.request("cancel", number="5")  # even while it is stopped
    assert counter.queries[-1].request == MissionCancel(5, "assistant: model")
