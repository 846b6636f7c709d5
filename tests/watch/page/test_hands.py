"""The page's stick in a virtual society with a teleop agent."""

from __future__ import annotations

import pytest

from armadico.watch.teleop.teleop import Teleop
from tests.watch.page.stage import Stage


@pytest.fixture
def stage() -> Stage:
    """Two pages."""
    made = Stage()
    made.run.add(Teleop)
    made.ready()
    made.session.on_connect("page 2")
    made.until(lambda: made.parts["hand"]["there"])
    return made


def test_a_page_that_disconnects_releases_the_stick_immediately(
    stage: Stage,
) -> None:
    published = stage.sticks()

    def holds() -> bool:
        cycle, hand = stage.parts["motion"]["cycle"], stage.parts["hand"]
        stage.request("page 1", "stick", v=0.4, w=0.0, cycle=cycle)
        return bool(hand["hand"] == "page 1" and hand["holds"])

    stage.until(holds)
    stage.session.on_disconnect("page 1")
    stage.run_for(0.1)
    assert not published[-1].held
    stage.until(lambda: not stage.parts["hand"]["hand"] and stage.parts["motion"]["v"] == 0.0, 5.0)


def test_a_stick_has_the_cycle_that_its_page_showed_and_no_later_one(
    stage: Stage,
) -> None:
    published = stage.sticks()
    seen = stage.parts["motion"]["cycle"]
    stage.request("page 1", "stick", v=0.1, w=0.0, cycle=seen - 2)
    stage.request("page 1", "stick", v=0.1, w=0.0, cycle=seen + 1000)
    stage.run_for(0.1)
    first, second = published
    assert first.cycle.number == seen - 2
    assert seen <= second.cycle.number <= seen + 2
    assert (first.number, second.number) == (1, 2)


def test_the_page_starts_a_missing_teleop_agent() -> None:
    stage = Stage()
    stage.ready()
    assert not stage.parts["hand"]["there"]
    assert stage.parts["could"] == ["teleop"]
    assert stage.ask("page 1", "start", agent="teleop")["ok"]
    stage.until(lambda: stage.parts["hand"]["there"])
    assert stage.parts["could"] == []
    assert not stage.ask("page 1", "start", agent="teleop")["ok"]
    assert len(stage.spawned) == 1


def test_without_robot_states_a_stick_is_refused() -> None:
    stage = Stage()
    stage.session.on_connect("page 1")
    stage.request("page 1", "stick", v=1.0, w=0.0, cycle=0)
    stage.until(lambda: stage.shown.answers)
    assert not stage.shown.answers[0]["ok"]
