"""The planner serves requests in the order in which they came."""

from __future__ import annotations

from typing import Any

import pytest

from armadico.agents.rivals.arbiter import Wish
from armadico.agents.rivals.queues import Queue
from armadico.core.agent import Agent, Identity
from armadico.core.exchange import Bid
from armadico.core.messages import Ack, Award, Cycle, Message
from armadico.core.parameters import Social
from armadico.mesh.virtual import Node, VirtualMesh
from armadico.mobile.messages import Plan, Planned, PlanTask, Waypoint
from armadico.mobile.resources import PLANNER
from armadico.testing.society import ResourceOwner, RobotOwner

HERE, THERE = Waypoint(0.0, 0.0, 0.0), Waypoint(1.0, 0.0, 0.0)


def asks(number: int, utility: float, *, critical: bool = False) -> Wish:
    return Wish(f"of-{number}", utility, PlanTask(number, HERE, THERE), critical)


class Line:
    def __init__(self) -> None:
        self.queue = Queue(Identity("queue-1"))
        self.number = 0

    def serves(self, after_s: float = 0.2, **wishes: Wish) -> str:
        self.number += 1
        self.queue.kernel.now += after_s
        decision = self.queue.decide(wishes, Cycle(1, self.number))
        (name,) = decision.shares
        assert decision.action == wishes[name].action
        return name


def test_who_came_first_is_served_first_whatever_the_utility() -> None:
    line = Line()
    mission, charger = asks(1, 0.2), asks(2, 0.9, critical=True)
    assert line.serves(mission=mission) == "mission"
    assert line.serves(mission=mission, charger=charger) == "mission", "ballots would change"
    assert line.serves(charger=charger) == "charger"
    again = asks(3, 0.2)
    assert line.serves(mission=again, charger=charger) == "charger", "a new request queues anew"
    assert line.serves(mission=again) == "mission"


def test_a_request_that_is_not_served_for_long_goes_to_the_end() -> None:
    line, fails_s = Line(), Queue.parameters().fails_s  # type: ignore[attr-defined]
    hangs, waits, last = asks(1, 0.5), asks(2, 0.4), asks(3, 0.9)
    line.serves(a=hangs)
    line.serves(a=hangs, b=waits)
    assert line.serves(fails_s - 0.5, a=hangs, b=waits, c=last) == "a"
    assert line.serves(1.0, a=hangs, b=waits, c=last) == "b"
    assert line.serves(a=hangs, c=last) == "c"
    assert line.serves(a=hangs) == "a", "it has another turn"


# On a mesh ----------------------------------------------------------------------------------------


class Planning(ResourceOwner):
    """Plans for whoever holds it, in its fourth cycle."""

    name = "planning"
    owns = (PLANNER,)
    provides = (Planned,)
    latest_four: tuple[int, ...] = ()

    def obey(self, resource: Any, action: PlanTask) -> None:
        self.latest_four = (*self.latest_four[-3:], action.id)
        if self.latest_four == (action.id,) * 4:
            self.publish(Planned(action.id, Plan((THERE,), 1.0)))


def requester(title: str, number: int, utility: float, from_s: float, *, deaf: bool) -> type[Agent]:
    """An agent that requests one plan; a deaf one goes on when it has it."""

    class Requester(Agent):
        name = title
        competes_for = (PLANNER,)
        receives = (Planned,)
        planned = False

        def bid(self, _message: Message) -> Bid | None:
            if self.now < from_s or self.planned:
                return None
            return Bid(utility, PlanTask(number, HERE, THERE))

        def on_planned(self, message: Planned) -> None:
            self.planned = self.planned or (message.id == number and not deaf)

    return Requester


def on_mesh(coordination: str | None, *, deaf: bool = False) -> tuple[VirtualMesh, dict[str, Node]]:
    """A mesh with a planner, and two requesters: the later one has the higher utility."""
    mesh = VirtualMesh(1)
    kinds: list[type[Agent]] = [
        requester("mission", 1, 0.2, 5.0, deaf=deaf),
        requester("charger", 2, 0.9, 5.2, deaf=False),
    ]
    made: dict[str, Node] = {}
    for kind in (RobotOwner, Planning, *kinds, *([Queue] if coordination else [])):
        given = kind.parameters(social=Social(coordination=coordination))
        made[kind.name] = mesh.add(kind(mesh.identity(kind.name), given), admit=False)
    return mesh, made


def test_the_planner_follows_the_queue_and_its_requesters_get_their_plans() -> None:
    order: dict[str | None, list[int]] = {None: [], "queue": []}
    acks: list[Ack] = []
    awarded: set[str] = set()
    for coordination, planned in order.items():
        mesh, _ = on_mesh(coordination)
        mesh.watch(lambda _k, each, _t, to=planned: to.append(each.id), Planned)
        mesh.watch(lambda _k, each, _t: acks.append(each), Ack)
        mesh.watch(lambda _k, each, _t: awarded.update(each.agents), Award)
        mesh.run(9.0)
    assert list(dict.fromkeys(order[None])) == [2, 1], "by ballots the better bid takes over"
    assert list(dict.fromkeys(order["queue"])) == [1, 2]
    assert {name.rpartition("-")[0] for name in awarded} == {"mission", "charger"}
    assert any(each.obeyed and each.obeyed.instance.startswith("queue-") for each in acks)


def test_a_requester_that_is_killed_or_never_content_keeps_no_other_one_waiting() -> None:
    mesh, made = on_mesh("queue", deaf=True)
    mesh.call_at(5.6, lambda *_: made["mission"].kill(), None)
    mesh.run(8.0)
    assert made["charger"].agent.planned  # type: ignore[attr-defined]
    mesh, made = on_mesh("queue", deaf=True)
    mesh.run(12.0)
    assert made["charger"].agent.planned, "after its time the deaf one is passed over"  # type: ignore[attr-defined]
    assert not made["mission"].agent.planned  # type: ignore[attr-defined]


@pytest.mark.parametrize(("standby", "order"), [(True, [1, 2]), (False, [2, 1])])
def test_the_order_outlives_a_queue_only_by_a_second_one(standby: bool, order: list[int]) -> None:
    """A queue that starts anew knows no times: those that wait are served by name, each once."""
    mesh, made = on_mesh("queue")
    given = Queue.parameters(social=Social(coordination="queue"))

    def another(*_: object) -> Node:
        return mesh.add(Queue(mesh.identity("queue", 1), given), admit=False)

    if standby:
        another()
    else:
        mesh.call_at(5.6, another, None)
    planned: list[int] = []
    mesh.watch(lambda _k, each, _t: planned.append(each.id), Planned)
    mesh.call_at(5.5, lambda *_: made["queue"].kill(), None)
    mesh.run(5.5)
    assert not planned, "both wait"
    mesh.run(12.0)
    assert list(dict.fromkeys(planned)) == order


def test_a_planner_that_is_replaced_goes_on_with_the_queue() -> None:
    mesh, made = on_mesh("queue")
    mesh.call_at(5.3, lambda *_: made["planning"].kill(), None)
    mesh.call_at(
        7.3, lambda *_: mesh.add(Planning(mesh.identity("planning", 1)), admit=False), None
    )
    order: list[int] = []
    mesh.watch(lambda _k, each, _t: order.append(each.id), Planned)
    mesh.run(7.2)
    assert not order
    mesh.run(14.0)
    assert list(dict.fromkeys(order)) == [1, 2]
