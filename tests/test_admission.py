"""Whether a newcomer may join, under a virtual clock: several instances, and a network between."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from itertools import count

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.admission import (
    ALONE_S,
    CARD_S,
    GOING_S,
    GRACE_S,
    QUIET_S,
    RESTLESS_S,
    Admission,
    Stage,
)
from armadico.messages import PROTOCOL, Card


def card(instance: str, protocol: int = PROTOCOL, host: str = "lab1", pid: int = 7) -> Card:
    name = instance.rpartition("-")[0]
    return Card(name, instance, host, pid, "1", protocol, (), (), ())


def settle(admission: Admission, now: float, until: float = 60.0) -> float:
    """Look whenever it asks to; returns when that was for the last time."""
    while admission.look(now) in (Stage.LOOKING, Stage.CLAIMING) and now < until:
        due = admission.wakeup
        assert due is not None
        assert due > now or admission.questions(now), "it would look for ever at one instant"
        now = max(due, now)
    return now


def test_where_nobody_is_it_joins_after_a_moment() -> None:
    admission = Admission("goto", "goto-1", 10.0)
    assert settle(admission, 10.0) == pytest.approx(10.0 + ALONE_S)
    assert admission.stage is Stage.JOINED


def test_where_others_are_it_asks_each_for_its_card_once_and_joins() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    admission.appeared("goto", "goto-1", 0.01)  # itself
    for _ in range(2):
        admission.appeared("avoid", "avoid-2", 0.01)
    assert admission.questions(0.01) == [("avoid", "avoid-2")]
    assert admission.questions(0.02) == []
    admission.answered("avoid-2", card("avoid-2"), 0.02)
    admission.answered("avoid-2", None, 0.5)  # no more answers
    assert settle(admission, 0.02) == pytest.approx(0.01 + QUIET_S)
    assert admission.stage is Stage.JOINED


def test_however_many_come_and_go_it_waits_no_longer() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    for number in range(100):
        at = 0.01 * number
        admission.appeared("avoid", f"avoid-{number}", at)
        admission.disappeared(f"avoid-{number}", at)
        if admission.look(at) is Stage.JOINED:
            break
    assert at == pytest.approx(RESTLESS_S, abs=0.011)


def test_one_that_hangs_is_not_waited_for_and_asked_again_later() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    admission.appeared("avoid", "avoid-2", 0.0)
    assert admission.questions(0.0)
    assert settle(admission, 0.0) == pytest.approx(CARD_S)
    admission.answered("avoid-2", None, CARD_S)
    assert admission.questions(CARD_S) == []
    assert admission.look(CARD_S + GRACE_S) is Stage.JOINED
    due = admission.wakeup
    assert due is not None
    assert admission.questions(due) == [("avoid", "avoid-2")]


def meet(admission: Admission, instance: str, now: float, protocol: int = PROTOCOL + 1) -> None:
    """An instance appears and gives its card, which says another protocol."""
    admission.appeared(instance.rpartition("-")[0], instance, now)
    assert admission.questions(now)
    admission.answered(instance, card(instance, protocol, "lab3", 42), now)


def test_among_agents_of_another_protocol_it_names_one_and_does_not_join() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    meet(admission, "avoid-2", 0.0)
    settle(admission, 0.0)
    assert admission.stage is Stage.REFUSED
    for part in ("avoid-2", "lab3", "42", f"protocol {PROTOCOL + 1}", f"this one {PROTOCOL}"):
        assert part in admission.refusal


def test_if_it_hears_of_them_a_little_later_it_leaves_again() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    joined = settle(admission, 0.0)
    meet(admission, "avoid-2", joined + 1.0)
    assert admission.look(joined + 1.0) is Stage.JOINED, "a robot agent may speak for it yet"
    due = admission.wakeup
    assert due == pytest.approx(joined + GRACE_S)
    assert admission.look(due) is Stage.REFUSED


def test_one_that_comes_later_still_is_the_newcomer_itself() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    joined = settle(admission, 0.0)
    assert admission.look(joined + GRACE_S) is Stage.JOINED
    assert admission.wakeup is None
    meet(admission, "avoid-2", joined + GRACE_S + 0.1)
    assert admission.look(1000.0) is Stage.JOINED


@pytest.mark.parametrize(("protocol", "stays"), [(PROTOCOL, True), (PROTOCOL + 1, False)])
def test_whoever_speaks_the_robot_agents_protocol_stays(protocol: int, stays: bool) -> None:
    """So one stranger keeps nobody from starting again."""
    admission = Admission("goto", "goto-1", 0.0)
    meet(admission, "avoid-2", 0.0)
    meet(admission, "robot-3", 0.0, protocol)
    settle(admission, 0.0)
    assert admission.look(100.0) is (Stage.JOINED if stays else Stage.REFUSED)


def test_a_robot_agent_that_has_joined_does_not_leave_for_a_stranger() -> None:
    admission = Admission("robot", "robot-1", 0.0, alone=True)
    joined = settle(admission, 0.0)
    meet(admission, "avoid-2", joined)
    assert admission.look(joined + 100.0) is Stage.JOINED
    late = Admission("robot", "robot-1", 0.0, alone=True)
    meet(late, "avoid-2", 0.0)
    settle(late, 0.0)
    assert late.stage is Stage.REFUSED, "it is the newcomer"


# One that must be alone ---------------------------------------------------------------------------


def test_a_second_one_names_the_first_once_its_token_could_have_gone() -> None:
    admission = Admission("robot", "robot-2", 0.0, alone=True)
    admission.appeared("robot", "robot-9", 0.01)
    admission.questions(0.01)
    admission.answered("robot-9", card("robot-9", host="lab1", pid=42), 0.02)
    assert settle(admission, 0.02) == pytest.approx(0.01 + GOING_S)
    assert admission.stage is Stage.REFUSED
    assert "robot-9 (host lab1, pid 42" in admission.refusal
    assert "--namespace" in admission.refusal


def test_it_joins_if_the_token_goes_in_time() -> None:
    admission = Admission("robot", "robot-2", 0.0, alone=True)
    admission.appeared("robot", "robot-9", 0.0)
    admission.look(1.0)
    admission.disappeared("robot-9", 1.0)
    assert settle(admission, 1.0) < 1.0 + 3 * QUIET_S
    assert admission.stage is Stage.JOINED


def test_others_of_other_names_are_not_in_its_way() -> None:
    admission = Admission("robot", "robot-2", 0.0, alone=True)
    admission.appeared("goto", "goto-1", 0.0)
    settle(admission, 0.0)
    assert admission.stage is Stage.JOINED


def test_one_with_a_larger_id_that_does_not_leave_keeps_it_out() -> None:
    admission = Admission("robot", "robot-2", 0.0, alone=True)
    while admission.look(1.0) is not Stage.CLAIMING:
        assert admission.stage is Stage.LOOKING
    admission.appeared("robot", "robot-9", 1.01)
    settle(admission, 1.01)
    assert admission.stage is Stage.REFUSED


def test_after_a_cut_the_one_with_the_smaller_id_stays() -> None:
    both = [Admission("robot", who, 0.0, alone=True) for who in ("robot-2", "robot-9")]
    for admission in both:
        settle(admission, 0.0)
    for admission, other in zip(both, ("robot-9", "robot-2"), strict=True):
        admission.appeared("robot", other, 50.0)
        assert admission.questions(50.0)
        assert admission.look(50.0) is Stage.JOINED, "it waits for the card, to say who that is"
    both[1].answered("robot-2", card("robot-2", host="lab3"), 50.1)
    assert [admission.look(50.1) for admission in both] == [Stage.JOINED, Stage.REFUSED]
    assert "robot-2 (host lab3" in both[1].refusal


def test_without_a_card_the_other_is_named_by_its_id() -> None:
    admission = Admission("robot", "robot-9", 0.0, alone=True)
    settle(admission, 0.0)
    admission.appeared("robot", "robot-2", 50.0)
    assert admission.questions(50.0)
    assert admission.wakeup == pytest.approx(50.0 + CARD_S)
    assert admission.look(50.0 + CARD_S) is Stage.REFUSED
    assert "there already: robot-2;" in admission.refusal


class World:
    """Instances that begin when they begin, and hear of each other's tokens after a delay."""

    def __init__(self, begins: Mapping[str, float], delay: Callable[[str, str], float]) -> None:
        self.delay = delay
        self.now = 0.0
        self.those: dict[str, Admission] = {}
        self.shown: dict[str, bool] = {}
        self.driving: dict[str, bool] = {}
        self._order = count()
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        for who, at in begins.items():
            self.at(at, lambda who=who: self.begin(who))  # type: ignore[misc]

    def at(self, when: float, what: Callable[[], None]) -> None:
        heapq.heappush(self._queue, (when, next(self._order), what))

    def begin(self, who: str) -> None:
        self.those[who] = Admission("robot", who, self.now, alone=True)
        for other, shown in self.shown.items():
            if shown:
                self.tell(who, other, there=True)
        self.look(who)

    def tell(self, who: str, of: str, *, there: bool) -> None:
        def deliver() -> None:
            admission = self.those[who]
            if there:
                admission.appeared("robot", of, self.now)
                for _, instance in admission.questions(self.now):
                    admission.answered(instance, card(instance), self.now)
            else:
                admission.disappeared(of, self.now)
            self.look(who)

        self.at(self.now + self.delay(who, of), deliver)

    def look(self, who: str) -> None:
        admission = self.those[who]
        stage = admission.look(self.now)
        shown = stage in (Stage.CLAIMING, Stage.JOINED)
        if shown != self.shown.get(who, False):
            self.shown[who] = shown
            for other in self.those:
                if other != who:
                    self.tell(other, who, there=shown)
        self.driving[who] = stage is Stage.JOINED
        due = admission.wakeup
        if due is not None and due > self.now:
            self.at(due, lambda: self.look(who))

    def run(self, until: float) -> list[list[str]]:
        """Who drove, at each instant at which something happened."""
        seen = []
        while self._queue and self._queue[0][0] <= until:
            self.now, _, what = heapq.heappop(self._queue)
            what()
            seen.append([who for who, drives in self.driving.items() if drives])
        return seen


STARTS = st.lists(st.floats(0.0, 0.6), min_size=2, max_size=4)


@given(starts=STARTS, delays=st.lists(st.floats(0.001, 0.04), min_size=16, max_size=16))
def test_of_several_that_begin_together_exactly_one_ever_drives(
    starts: list[float], delays: list[float]
) -> None:
    names = [f"robot-{number}" for number in range(len(starts))]
    pairs = {(a, b): delays[4 * i + j] for i, a in enumerate(names) for j, b in enumerate(names)}
    world = World(dict(zip(names, starts, strict=True)), lambda to, of: pairs[to, of])
    seen = world.run(30.0)
    assert max(map(len, seen)) == 1, "two drove at once"
    assert len({who for drivers in seen for who in drivers}) == 1, "one drove after another"
    assert sum(world.driving.values()) == 1


@given(starts=STARTS, delay=st.floats(0.001, 3.0))
def test_however_late_the_news_is_one_stays_in_the_end(starts: list[float], delay: float) -> None:
    names = [f"robot-{number}" for number in range(len(starts))]
    world = World(dict(zip(names, starts, strict=True)), lambda to, of: delay)
    world.run(60.0)
    assert sum(world.driving.values()) == 1
