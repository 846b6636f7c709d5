"""Processes of protocol 2 are replaced one by one by processes of protocol 3, on the way."""

from __future__ import annotations

import signal

import pytest
from msgspec import structs

from armadico.core.messages import OLDEST, PROTOCOL
from armadico.mobile.messages import MissionState, MissionStatus
from tests.robot.society import ballots_never_go_down
from tests.whole.live.conftest import Start
from tests.whole.live.society import LINE, SOON, Linked, Society

pytestmark = pytest.mark.live


def upgrade(society: Society, name: str) -> None:
    old = society.process(name)
    society.send(name, signal.SIGTERM)
    old.popen.wait(SOON)
    new = society.restart(name)
    society.until(lambda: _card(society, name) == (new.popen.pid, PROTOCOL), f"{name} is back")
    society.drives_on()


def _card(society: Society, name: str) -> tuple[int, int]:
    """The process and the protocol of an agent's only instance; zeros without an answer."""
    found = [agent for agent in society.client.alive if agent[0] == name]
    card = society.client.card(*found[0]) if len(found) == 1 else None
    return (0, 0) if card is None else (card.pid, card.speaks)


@pytest.mark.long
def test_a_society_is_upgraded_process_by_process(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Linked, "protocol", OLDEST)
    agents = ("encoder", "sonar", "goto", "avoid", "path-planning", "interface")
    society = start(structs.replace(LINE, agents=agents, goal=(16.0, 0.0, 0.0)))
    members = ("robot", *agents)
    assert {_card(society, name)[1] for name in members} == {OLDEST}
    monkeypatch.setattr(Linked, "protocol", PROTOCOL)
    for name in reversed(members):  # the robot agent last: its restart is the one that stops
        upgrade(society, name)
    status = society.client.latest(MissionStatus, 5.0)
    assert status is not None
    assert status.state is MissionState.DRIVING, "it is still the first mission"
    society.nobody_else_died()
    ballots_never_go_down(society.acks)
    assert not [text for text in society.logs if "refused" in text and "protocol" in text]
