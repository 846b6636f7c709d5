"""The page's stick in a virtual society with a teleop agent."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from armadico.core.messages import Message
from armadico.mobile.messages import Truth
from armadico.watch.page.session import TURN_S
from armadico.watch.teleop.messages import Stick
from armadico.watch.teleop.teleop import Teleop
from tests.watch.page.stage import Stage

SEND_S = 0.1  # interval at which a page sends its stick


# Acceleration of the wheels over the controller's ramps: see `tests.watch.test_teleop_launch`.
class Hands(Stage):
    """Pages with sticks; `sticks` has the position by page."""

    def __init__(self) -> None:
        super().__init__("sc1")
        self.run.add(Teleop)
        self.sticks: dict[str, tuple[float, float]] = {}
        self.truths: list[Truth] = []
        self.published: list[Stick] = []
        self._send_at = 0.0
        self.mesh.watch(lambda _, truth, t: self.truths.append(truth), Truth)
        self.mesh.watch(self._watch, Stick)
        self.ready()
        self.session.on_connect("page 2")
        self.until(lambda: self.parts["hand"]["there"])

    def _watch(self, key: str, stick: Message, _t: float) -> None:
        if key != "teleop/stick":  # the copy for agents of protocol 2
            assert isinstance(stick, Stick)
            self.published.append(stick)

    def hold(self, browser: str, v: float, w: float) -> None:
        self.sticks[browser] = v, w

    def go_on(self, condition: Callable[[], object], seconds: float = 30.0) -> None:
        end = self.mesh.now + seconds
        while not condition():
            assert self.mesh.now < end, (self.parts["hand"], self.parts["wheels"])
            if self.mesh.now >= self._send_at:
                self._send_at = self.mesh.now + SEND_S
                for browser, (v, w) in self.sticks.items():
                    cycle = self.parts["motion"]["cycle"]
                    self.request(browser, "stick", v=v, w=w, cycle=cycle)
            self.session.turn(TURN_S)

    def holds(self, browser: str) -> bool:
        hand = self.parts["hand"]
        return bool(hand["hand"] == browser and hand["holds"])

    @property
    def v(self) -> float:
        v: float = self.parts["motion"]["v"]
        return v


@pytest.fixture
def hands() -> Hands:
    return Hands()


def test_a_page_that_disconnects_releases_the_stick_immediately(hands: Hands) -> None:
    hands.hold("page 1", 0.4, 0.0)
    hands.go_on(lambda: hands.holds("page 1"))
    hands.sticks.clear()
    hands.session.on_disconnect("page 1")
    hands.run_for(0.1)
    assert not hands.published[-1].held
    hands.go_on(lambda: hands.parts["hand"]["hand"] == "" and hands.v == 0.0, 5.0)


def test_a_stick_has_the_cycle_that_its_page_showed_and_no_later_one(hands: Hands) -> None:
    seen = hands.parts["motion"]["cycle"]
    hands.request("page 1", "stick", v=0.1, w=0.0, cycle=seen - 2)
    hands.request("page 1", "stick", v=0.1, w=0.0, cycle=seen + 1000)
    hands.run_for(0.1)
    first, second = hands.published
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
