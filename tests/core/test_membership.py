"""Whether a newcomer may join, under a virtual clock: several instances, and a network between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.core.membership import (
    AGAIN_S,
    ALONE_S,
    ANNOUNCED_S,
    CARD_S,
    GOING_S,
    GRACE_S,
    QUIET_S,
    RESTLESS_S,
    Admission,
    Stage,
)
from armadico.core.messages import PROTOCOL, Card
from armadico.mesh.door import Door
from tests.core.joiners import Joiners, Joining


def card(
    instance: str,
    protocol: int = PROTOCOL,
    host: str = "lab1",
    pid: int = 7,
    *,
    owns: tuple[str, ...] = (),
    tenure: int = 0,
) -> Card:
    name = instance.rpartition("-")[0]
    return Card(name, instance, host, pid, "1", protocol, (), (), (), owns=owns, tenure=tenure)


def settle(admission: Admission, now: float, until: float = 60.0) -> float:
    """Query and check whenever it is due, without replies. Returns the last time."""
    while True:
        admission.queries(now)
        if admission.check(now) not in (Stage.LOOKING, Stage.CLAIMING) or now >= until:
            return now
        due = admission.wakeup
        assert due is not None
        assert due > now, "it would look for ever at one instant"
        now = due


def test_alone_it_joins_after_a_moment() -> None:
    admission = Admission("goto", "goto-1", 10.0)
    assert settle(admission, 10.0) == pytest.approx(10.0 + ALONE_S)
    assert admission.stage is Stage.JOINED


def test_among_others_it_queries_each_card_once_and_joins() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    admission.appeared("goto", "goto-1", 0.01)  # itself
    for _ in range(2):
        admission.appeared("avoid", "avoid-2", 0.01)
    assert admission.queries(0.01) == [("avoid", "avoid-2")]
    assert admission.queries(0.02) == []
    admission.on_card("avoid-2", card("avoid-2"), 0.02)
    admission.on_card("avoid-2", None, 0.5)  # no more answers
    assert settle(admission, 0.02) == pytest.approx(0.01 + QUIET_S)
    assert admission.stage is Stage.JOINED


@pytest.mark.parametrize("alone", [False, True])
def test_an_instance_that_waits_is_not_woken_at_once_again(alone: bool) -> None:
    admission = Admission("goto", "goto-1", 0.0, alone=alone)
    admission.appeared("avoid", "avoid-2", 0.002)
    assert admission.queries(0.002)
    settled = 0.002 + QUIET_S
    assert admission.check(settled) is Stage.LOOKING, "a card may still come"
    assert admission.wakeup == pytest.approx(0.002 + CARD_S)


def test_however_many_come_and_go_it_waits_no_longer() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    for number in range(100):
        at = 0.01 * number
        admission.appeared("avoid", f"avoid-{number}", at)
        admission.disappeared(f"avoid-{number}", at)
        if admission.check(at) is Stage.JOINED:
            break
    assert at == pytest.approx(RESTLESS_S, abs=0.011)


def test_a_hanging_instance_is_not_waited_for_and_queried_again_later() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    admission.appeared("avoid", "avoid-2", 0.0)
    assert admission.queries(0.0)
    assert settle(admission, 0.0) == pytest.approx(CARD_S)
    admission.on_card("avoid-2", None, CARD_S)
    assert admission.queries(CARD_S) == []
    assert admission.check(CARD_S + GRACE_S) is Stage.JOINED
    due = admission.wakeup
    assert due is not None
    assert admission.queries(due) == [("avoid", "avoid-2")]


def meet(
    admission: Admission,
    instance: str,
    now: float,
    protocol: int = PROTOCOL + 1,
    *,
    owns: tuple[str, ...] = (),
    tenure: int = 0,
) -> None:
    """An instance appears and replies with its card, by default of another protocol."""
    admission.appeared(instance.rpartition("-")[0], instance, now)
    assert admission.queries(now)
    reply = card(instance, protocol, "lab3", 42, owns=owns, tenure=tenure)
    admission.on_card(instance, reply, now)


def test_among_agents_of_another_protocol_it_names_one_and_does_not_join() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    meet(admission, "avoid-2", 0.0)
    assert settle(admission, 0.0) == pytest.approx(GRACE_S), "an owner may come yet"
    assert admission.stage is Stage.REFUSED
    for part in ("avoid-2", "lab3", "42", str(PROTOCOL + 1), str(PROTOCOL)):
        assert part in admission.refusal


def test_if_it_detects_them_a_little_later_it_leaves_again() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    joined = settle(admission, 0.0)
    meet(admission, "avoid-2", joined + 1.0)
    assert admission.check(joined + 1.0) is Stage.JOINED, "an owner may speak for it yet"
    due = admission.wakeup
    assert due is not None
    assert due == pytest.approx(joined + GRACE_S)
    assert admission.check(due) is Stage.REFUSED


def test_one_that_comes_later_still_is_the_newcomer_itself() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    joined = settle(admission, 0.0)
    assert admission.check(joined + GRACE_S) is Stage.JOINED
    assert admission.wakeup is None
    meet(admission, "avoid-2", joined + GRACE_S + 0.1)
    assert admission.check(1000.0) is Stage.JOINED


@pytest.mark.parametrize(("protocol", "stays"), [(PROTOCOL, True), (PROTOCOL + 1, False)])
def test_agents_of_the_owners_protocol_stay(protocol: int, stays: bool) -> None:
    """So one stranger does not prevent a restart."""
    admission = Admission("goto", "goto-1", 0.0)
    meet(admission, "avoid-2", 0.0)
    meet(admission, "robot-3", 0.0, protocol, owns=("wheels",))
    settle(admission, 0.0)
    assert admission.check(100.0) is (Stage.JOINED if stays else Stage.REFUSED)


def replay(
    admission: Admission, news: dict[str, Card], comes: dict[str, tuple[float, float]]
) -> None:
    """Run with the given times of tokens and delays of cards."""
    coming: list[tuple[float, str, str]] = [
        (at, other, "token") for other, (at, _) in comes.items()
    ]
    now = 0.0
    while True:
        for _, other in admission.queries(now):
            coming.append((now + comes[other][1], other, "card"))
        admission.check(now)
        due = admission.wakeup
        if admission.stage is Stage.REFUSED or (due is None and not coming):
            return
        now = min([at for at, *_ in coming] + ([due] if due is not None else []))
        for item in [item for item in coming if item[0] <= now]:
            coming.remove(item)
            _, other, what = item
            if what == "token":
                admission.appeared(news[other].name, other, now)
            else:
                admission.on_card(other, news[other], now)


LATE = st.tuples(st.floats(0.001, GRACE_S - CARD_S), st.floats(0.001, 0.99 * CARD_S))


@given(owner=LATE, stranger=LATE, alone=st.booleans())
@example(owner=(0.03, 0.002), stranger=(0.01, 0.002), alone=False)
def test_it_joins_the_owner_of_its_protocol_in_any_order_of_tokens(
    owner: tuple[float, float], stranger: tuple[float, float], alone: bool
) -> None:
    """Links come up one after another: the stranger's card came first, and it went at once."""
    admission = Admission("goto", "goto-1", 0.0, alone=alone)
    news = {
        "robot-3": card("robot-3", owns=("wheels",), tenure=30),
        "avoid-2": card("avoid-2", PROTOCOL + 1, tenure=30),
    }
    replay(admission, news, {"robot-3": owner, "avoid-2": stranger})
    assert admission.stage is Stage.JOINED


def test_it_joins_once_the_strangers_have_gone() -> None:
    """As where one protocol's agents are taken down while the next's come up."""
    admission = Admission("goto", "goto-1", 0.0)
    meet(admission, "avoid-2", 0.0)
    assert admission.check(1.0) is Stage.LOOKING
    admission.disappeared("avoid-2", 1.0)
    assert settle(admission, 1.0) < GRACE_S
    assert admission.stage is Stage.JOINED


def test_an_owners_card_that_is_on_its_way_is_waited_for_at_the_end_of_the_grace() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    end = settle(admission, 0.0) + GRACE_S
    meet(admission, "avoid-2", end - 0.2)
    admission.appeared("robot", "robot-3", end - 0.1)
    assert admission.queries(end - 0.1)
    assert admission.check(end) is Stage.JOINED
    assert admission.wakeup == pytest.approx(end - 0.1 + CARD_S)
    admission.on_card("robot-3", card("robot-3", owns=("wheels",)), end + 0.1)
    assert admission.check(100.0) is Stage.JOINED


# One that must be alone ---------------------------------------------------------------------------

ONE_ALONE = ("encoder", "sonar", "interface", "path-planning", "robot")


@pytest.mark.parametrize("name", ONE_ALONE)
def test_a_second_one_is_refused_at_once_with_the_working_instance(name: str) -> None:
    admission = Admission(name, f"{name}-2", 0.0, alone=True)
    meet(admission, f"{name}-9", 0.01, PROTOCOL, tenure=500)
    assert settle(admission, 0.01) == pytest.approx(0.01)
    assert admission.stage is Stage.REFUSED
    assert f"another {name} agent is alive already: {name}-9 (host lab3, pid 42" in (
        admission.refusal
    )
    assert "--namespace" in admission.refusal


def test_a_token_without_a_card_keeps_a_newcomer_out_once_it_could_have_gone() -> None:
    admission = Admission("robot", "robot-2", 0.0, alone=True)
    admission.appeared("robot", "robot-9", 0.01)
    assert settle(admission, 0.01) == pytest.approx(0.01 + GOING_S)
    assert admission.stage is Stage.REFUSED
    assert "alive already: robot-9;" in admission.refusal


def test_it_joins_if_the_token_goes_in_time() -> None:
    admission = Admission("robot", "robot-2", 0.0, alone=True)
    admission.appeared("robot", "robot-9", 0.0)
    admission.queries(0.0)
    admission.check(1.0)
    admission.disappeared("robot-9", 1.0)
    assert settle(admission, 1.0) < 1.0 + QUIET_S + max(ANNOUNCED_S, ALONE_S, QUIET_S) + 0.01
    assert admission.stage is Stage.JOINED


def test_of_two_that_begin_at_once_the_larger_id_leaves() -> None:
    admission = Admission("robot", "robot-9", 0.0, alone=True)
    now = 0.0
    while admission.check(now) is not Stage.CLAIMING:
        due = admission.wakeup
        assert due is not None
        now = due
    meet(admission, "robot-2", now, PROTOCOL, tenure=0)
    assert admission.check(now) is Stage.REFUSED


def test_one_with_a_larger_id_that_does_not_leave_keeps_it_out() -> None:
    admission = Admission("robot", "robot-2", 0.0, alone=True)
    while admission.check(1.0) is not Stage.CLAIMING:
        assert admission.stage is Stage.LOOKING
    admission.appeared("robot", "robot-9", 1.01)
    settle(admission, 1.01)
    assert admission.stage is Stage.REFUSED


@pytest.mark.parametrize("more", [0, 10, 11, 15, 20, 21, 40])
@pytest.mark.parametrize("longer", ["robot-2", "robot-9"])
def test_of_two_at_work_one_leaves_however_much_longer_it_has_been(more: int, longer: str) -> None:
    """Between 11 and 20 cycles none did, for good."""
    both = {one: Admission("robot", one, 0.0, alone=True) for one in ("robot-2", "robot-9")}
    for admission in both.values():
        settle(admission, 0.0)
    others = {"robot-2": "robot-9", "robot-9": "robot-2"}
    for one, other in others.items():
        both[one].appeared("robot", other, 50.0)
    for cycle in range(400):
        now = 50.0 + 0.1 * cycle
        for one, admission in both.items():
            admission.tenure = 4 + cycle + (more if one == longer else 0)
        for one, admission in both.items():
            for _, other in admission.queries(now):
                theirs = replace(card(other), tenure=both[other].tenure)
                admission.on_card(other, theirs, now)
            if admission.check(now) is Stage.REFUSED:
                both[others[one]].disappeared(one, now)
    stay = [one for one, admission in both.items() if admission.stage is Stage.JOINED]
    assert len(stay) == 1
    if more > 20:
        assert stay == [longer]


def test_a_token_without_a_card_displaces_no_instance() -> None:
    """However small its id, and however often it is queried."""
    admission = Admission("robot", "robot-9", 0.0, alone=True, owns=("wheels",))
    settle(admission, 0.0)
    admission.tenure = 400
    admission.appeared("robot", "robot-0000000000000000", 50.0)
    queried = 0
    for step in range(3000):
        now = 50.0 + 0.02 * step
        if admission.queries(now):
            queried += 1
            admission.on_card("robot-0000000000000000", None, now)
        assert admission.check(now) is Stage.JOINED
    assert queried == pytest.approx(60.0 / AGAIN_S, abs=1)


def test_a_card_without_worked_cycles_displaces_no_instance() -> None:
    admission = Admission("robot", "robot-9", 0.0, alone=True)
    settle(admission, 0.0)
    admission.tenure = 400
    meet(admission, "robot-0", 50.0, PROTOCOL, tenure=0)
    assert admission.check(60.0) is Stage.JOINED


# One that owns a resource -------------------------------------------------------------------------


def test_a_second_owner_is_refused_with_the_present_owner() -> None:
    admission = Admission("claw", "claw-1", 0.0, owns=("gripper", "lamp"))
    meet(admission, "arm-5", 0.0, PROTOCOL, owns=("gripper", "elbow"), tenure=30)
    settle(admission, 0.0)
    assert admission.stage is Stage.REFUSED
    assert "gripper has an owner already: arm-5 (host lab3, pid 42" in admission.refusal
    assert "lamp" not in admission.refusal


def test_owners_of_different_resources_are_not_in_each_others_way() -> None:
    admission = Admission("claw", "claw-1", 0.0, owns=("gripper",))
    meet(admission, "arm-5", 0.0, PROTOCOL, owns=("elbow",), tenure=30)
    settle(admission, 0.0)
    assert admission.stage is Stage.JOINED


def test_an_agent_without_resources_may_join_beside_any_owner_and_its_twin() -> None:
    admission = Admission("goto", "goto-1", 0.0)
    meet(admission, "goto-2", 0.0, PROTOCOL, tenure=30)
    meet(admission, "robot-2", 0.0, PROTOCOL, owns=("wheels",), tenure=30)
    settle(admission, 0.0)
    assert admission.stage is Stage.JOINED


@dataclass
class Drawn:
    """What may go one way or another, as hypothesis draws it: starts, and how long news takes."""

    starts: list[float]
    delay: Callable[[str, str], float]

    def pick(self, what: str, _ways: Sequence[str], _cost: int) -> str:
        kind, *words = what.split()
        if kind == "cut":
            return "nothing"
        if kind == "token":  # of A to B
            return f"{self.delay(words[3], words[1])} s"
        if kind == "card":
            return f"{min(self.delay(words[3], words[1]), CARD_S / 3)} s"
        return f"{self.starts.pop()} s"


STARTS = st.lists(st.floats(0.0, 0.6), min_size=1, max_size=3)


@given(
    starts=STARTS,
    backwards=st.booleans(),
    delays=st.lists(st.floats(0.001, 0.04), min_size=20, max_size=20),
)
def test_of_several_that_begin_together_exactly_one_ever_drives(
    starts: list[float], backwards: bool, delays: list[float]
) -> None:
    setup = Joining(len(starts) + 1, backwards)
    joiners = Joiners(setup, Drawn(starts, lambda to, of: delays[4 * int(to[-1]) + int(of[-1])]))
    assert joiners.run() == ""
    assert len(joiners.worked) == 1, "two drove at once, or one after another"


@settings(max_examples=100)
@given(starts=st.lists(st.floats(0.0, 4.0), min_size=1, max_size=3), delay=st.floats(0.001, 3.0))
def test_however_late_the_news_of_tokens_is_one_stays_in_the_end(
    starts: list[float], delay: float
) -> None:
    joiners = Joiners(Joining(len(starts) + 1), Drawn(starts, lambda _to, _of: delay))
    assert joiners.run() == ""


@pytest.mark.parametrize(
    ("own", "oldest", "newest", "understood"),
    [
        (PROTOCOL, PROTOCOL - 1, 0, True),  # not upgraded yet
        (PROTOCOL, PROTOCOL - 1, PROTOCOL, True),
        (PROTOCOL, PROTOCOL, PROTOCOL + 1, True),  # the next one
        (PROTOCOL - 1, PROTOCOL - 1, PROTOCOL, True),
        (PROTOCOL - 1, PROTOCOL, PROTOCOL + 1, False),
        (PROTOCOL, PROTOCOL + 1, PROTOCOL + 2, False),
        (PROTOCOL, PROTOCOL - 2, 0, False),
    ],
)
def test_agents_whose_ranges_of_protocols_overlap_understand_each_other(
    own: int, oldest: int, newest: int, understood: bool
) -> None:
    admission = Admission("goto", "goto-1", 0.0, protocol=own)
    admission.appeared("robot", "robot-1", 0.0)
    admission.queries(0.0)
    admission.on_card("robot-1", replace(card("robot-1", oldest), newest=newest), 0.01)
    stages = {admission.check(0.1 * tick) for tick in range(1, 40)}
    assert (Stage.REFUSED not in stages) == understood
    assert (f"uses protocol {newest or oldest}" in admission.refusal) != understood


class RobotOwns(Door):
    def may_own(self, instance: str, resource: str) -> bool:
        return instance.startswith("robot-")


@pytest.mark.parametrize("protocol", [PROTOCOL, PROTOCOL + 9])
@pytest.mark.parametrize("keys", [True, False])
def test_with_keys_a_card_that_claims_a_resource_keeps_its_owner_out_no_more(
    protocol: int, keys: bool
) -> None:
    """A member's card may lie, and an owner that was killed has to come back."""
    rights = RobotOwns("robot1/robot", {}) if keys else None
    admission = Admission("robot", "robot-1", 0.0, owns=["wheels"], rights=rights)
    admission.appeared("liar", "liar-1", 0.0)
    admission.queries(0.0)
    lie = card("liar-1", owns=("wheels",), tenure=2**32, protocol=protocol)
    admission.on_card("liar-1", lie, 0.1)
    settle(admission, 0.1)
    assert admission.stage is (Stage.JOINED if keys else Stage.REFUSED)


def test_with_keys_the_rightful_owner_keeps_another_one_out() -> None:
    admission = Admission("lift2", "lift2-1", 0.0, owns=["lift"], rights=Door("robot1/lift", {}))
    admission.appeared("lift", "lift-1", 0.0)
    admission.queries(0.0)
    admission.on_card("lift-1", card("lift-1", owns=("lift",), tenure=9), 0.1)
    settle(admission, 0.1)
    assert admission.stage is Stage.REFUSED


def test_tokens_without_agents_cost_ever_fewer_queries() -> None:
    """A member can show many tokens of its own, and each process queries each one's card."""
    admission = Admission("goto", "goto-1", 0.0)
    now = settle(admission, 0.0)
    forged = [f"sonar-{number:016x}" for number in range(31)]
    for instance in forged:
        admission.appeared("sonar", instance, now)
    counts = []
    for _ in range(2):
        queried, end = 0, now + 300.0
        while now < end:
            for _, instance in admission.queries(now):
                queried += 1
                admission.on_card(instance, None, now)
            assert admission.check(now) is Stage.JOINED
            now = min(admission.wakeup or end, end)
        counts.append(queried)
    assert counts[0] <= 9 * len(forged)
    assert counts[1] <= 5 * len(forged), "one in 80 s"
