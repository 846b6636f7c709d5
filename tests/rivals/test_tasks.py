"""Each mechanism for tasks between robots has the feature that its authors rely on."""

from __future__ import annotations

from typing import Any
from weakref import WeakSet

import pytest

from armadico.agents.rivals.tasks import (
    SILENT_S,
    WAIT_S,
    Central,
    ContractNet,
    Contractor,
    Drives,
    FleetArbiter,
    Motivated,
    Parameters,
    assigned,
)
from armadico.core.agent import Identity
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.messages import Award, Ballot, Claim, Cycle, Proposal
from armadico.core.outgoing import Publish
from armadico.core.resources import Resource
from armadico.mobile.messages import FleetAwards, FleetProposals

LIST = 7
TASKS = [
    Resource(
        f"task-{n}", ("there_s", "finish_s"), (1.0, 1.0), (0.0, 0.0), period_s=1.0, stops=False
    )
    for n in range(2)
]


def bid(there_s: float, utility: float = 0.5) -> Bid:
    return Bid(utility, (there_s, there_s))


# A robot's side -----------------------------------------------------------------------------------


def contractor(*, asks: bool = True) -> tuple[Contractor, CycleClock]:
    clock = CycleClock(1.0)
    clock.advance(Cycle(LIST, 1), 0.0)
    return Contractor(TASKS[0], "fleet-1", clock, asks=asks), clock


def award(to: str | None, number: int = 1) -> Award:
    agents = () if to is None else (to,)
    return Award("task-0", Cycle(LIST, number), "contract-net-1", agents, (1.0,) * len(agents))


def utility(messages: list[Any]) -> float | None:
    (proposal,) = messages
    assert isinstance(proposal, Proposal)
    return proposal.utility


def test_a_contractor_bids_only_for_what_is_announced() -> None:
    side, clock = contractor()
    assert utility(side.bid(Cycle(LIST, 1), bid(5.0), 0.0)) is None
    side.on_message(award(None), 0.1)
    assert utility(side.bid(Cycle(LIST, 1), bid(5.0), 0.2)) == 0.5
    clock.advance(Cycle(LIST, 6), 6.0)
    assert utility(side.bid(Cycle(LIST, 6), bid(5.0), 6.0)) is None, "it was announced long ago"
    free, _ = contractor(asks=False)
    assert utility(free.bid(Cycle(LIST, 1), bid(5.0), 0.0)) == 0.5


def test_a_contract_outlives_the_manager_and_ends_by_giving_back_or_revocation() -> None:
    side, clock = contractor()
    side.on_message(award("fleet-1"), 0.0)
    clock.advance(Cycle(LIST, 50), 50.0)
    side.bid(Cycle(LIST, 50), bid(5.0), 50.0)
    assert side.share == 1.0, "no award for 49 cycles"
    side.on_message(award("fleet-2", 50), 50.0)
    assert side.share == 0.0
    side.on_message(award("fleet-1", 50), 50.0)
    side.bid(Cycle(LIST, 50), None, 50.0)
    assert side.share == 0.0


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_of_two_managers_that_award_in_one_cycle_all_robots_heed_the_same(
    order: tuple[int, int],
) -> None:
    both = [
        Award("task-0", Cycle(LIST, 1), f"contract-net-{n}", (f"fleet-{n}",), (1.0,)) for n in "12"
    ]
    shares = []
    for robot in "12":
        clock = CycleClock(1.0)
        clock.advance(Cycle(LIST, 1), 0.0)
        side = Contractor(TASKS[0], f"fleet-{robot}", clock, asks=False)
        side.bid(Cycle(LIST, 1), bid(5.0), 0.0)
        for index in order if robot == "1" else (0, 1):
            side.on_message(both[index], 0.1)
        shares.append(side.share)
    assert shares == [1.0, 0.0]


# The arbiters -------------------------------------------------------------------------------------


class Table:
    """An arbiter, and what it has awarded last."""

    def __init__(self, kind: type[FleetArbiter], robot: str = "r1") -> None:
        parameters = kind.parameters(namespace=f"lab/{robot}")
        assert isinstance(parameters, Parameters)
        self.agent = kind(Identity(f"{kind.name}-{robot}"), parameters)
        self.agent.kernel.start(0.0)

    def cycle(self, number: int, *proposed: FleetProposals) -> FleetAwards | None:
        """The decision of a cycle, if it publishes one."""
        kernel = self.agent.kernel
        for each in proposed:
            kernel.receive(each, float(number))
        kernel.wake(number + WAIT_S)
        found = [
            each.message
            for each in kernel.outbox
            if isinstance(each, Publish) and isinstance(each.message, FleetAwards)
        ]
        kernel.outbox.clear()
        assert len(found) <= 1, "one decision per cycle"
        return found[0] if found else None


def proposals(robot: str, number: int, *holds: str, **bids: tuple[float, float]) -> FleetProposals:
    """By task (`t0` is task-0): utility and time of arrival, s."""
    cycle = Cycle(LIST, number)
    made = tuple(
        Proposal(f"task-{name[1:]}", cycle, f"fleet-{robot}", u, False, (there, there))
        for name, (u, there) in bids.items()
    )
    named = {each.resource for each in made}
    lacking = tuple(
        Proposal(task.name, cycle, f"fleet-{robot}") for task in TASKS if task.name not in named
    )
    return FleetProposals(robot, f"fleet-{robot}", cycle, (*made, *lacking), holds)


def awarded(message: FleetAwards | None) -> dict[str, tuple[str, ...]]:
    assert message is not None
    return {each.resource: each.agents for each in message.awards}


@pytest.mark.parametrize("kind", [ContractNet, Central])
def test_a_robot_whose_bids_always_come_after_the_decision_gets_a_task(
    kind: type[FleetArbiter],
) -> None:
    table, far, near = Table(kind), {"t0": (0.9, 1.0)}, {"t0": (0.5, 9.0)}
    table.cycle(1, proposals("r1", 1), proposals("r2", 1))
    table.cycle(2, proposals("r1", 2, **near))
    table.agent.kernel.receive(proposals("r2", 2, **far), 2.9)
    assert awarded(table.cycle(3, proposals("r1", 3, **near)))["task-0"] == ("fleet-r2",)


def test_contract_net_announces_awards_to_the_best_and_announces_again() -> None:
    manager = Table(ContractNet)
    first = manager.cycle(1, proposals("r1", 1), proposals("r2", 1))
    assert awarded(first) == {"task-0": (), "task-1": ()}
    bids = {"t0": (0.5, 9.0), "t1": (0.4, 9.0)}
    better = {"t0": (0.6, 9.0), "t1": (0.5, 9.0)}
    second = manager.cycle(2, proposals("r1", 2, **bids), proposals("r2", 2, **better))
    assert awarded(second) == {"task-0": ("fleet-r2",), "task-1": ("fleet-r1",)}, "one a round"
    third = manager.cycle(3, proposals("r1", 3, "task-1"), proposals("r2", 3, "task-0"))
    assert awarded(third) == {}, "contracts are not revised"
    assert awarded(manager.cycle(4, proposals("r1", 4, "task-1"))) == {}, "r2 may be late"
    assert awarded(manager.cycle(6, proposals("r1", 6, "task-1"))) == {"task-0": ()}, "r2 is silent"


def test_central_reassigns_in_each_cycle_if_that_saves_enough() -> None:
    allocator = Table(Central)
    near = {"t0": (0.5, 10.0), "t1": (0.5, 30.0)}
    far = {"t0": (0.5, 12.0), "t1": (0.5, 60.0)}
    first = allocator.cycle(1, proposals("r1", 1, **near), proposals("r2", 1, **far))
    assert awarded(first) == {"task-0": ("fleet-r2",), "task-1": ("fleet-r1",)}, "12 + 30 < 10 + 60"
    held = {"r1": "task-1", "r2": "task-0"}
    little = {"t0": (0.5, 12.0), "t1": (0.5, 29.0)}
    kept = allocator.cycle(
        2, proposals("r1", 2, held["r1"], **near), proposals("r2", 2, held["r2"], **little)
    )
    assert awarded(kept) == awarded(first), "an exchange would save 3 s"
    much = {"t0": (0.5, 40.0), "t1": (0.5, 12.0)}
    changed = allocator.cycle(
        3, proposals("r1", 3, held["r1"], **near), proposals("r2", 3, held["r2"], **much)
    )
    assert awarded(changed) == {"task-0": ("fleet-r1",), "task-1": ("fleet-r2",)}


def test_an_assignment_is_better_than_greedy_and_leaves_out_what_is_too_much() -> None:
    costs = {("a", "1"): 1.0, ("a", "2"): 2.0, ("b", "1"): 2.0, ("b", "2"): 10.0}
    assert assigned(costs) == {"a": "2", "b": "1"}
    assert assigned({("a", "1"): 3.0, ("b", "1"): 2.0}) == {"b": "1"}
    assert assigned({}) == {}


@pytest.mark.parametrize("kind", [ContractNet, Central])
def test_an_arbiter_on_standby_awards_once_the_first_is_silent(kind: type[FleetArbiter]) -> None:
    first, second = Table(kind, "r1"), Table(kind, "r2")
    for number in (1, 2):
        both = proposals("r1", number), proposals("r2", number)
        message = first.cycle(number, *both)
        assert message is not None
        second.agent.kernel.receive(message, number + 0.1)
        assert second.cycle(number, *both) is None
    after = 2 + int(SILENT_S) + 2
    assert second.cycle(after, proposals("r1", after), proposals("r2", after)) is not None


# Motivation ---------------------------------------------------------------------------------------


class Robot:
    """A robot's motivations for two tasks, in cycles of 1 s."""

    def __init__(self, name: str, **drives: float) -> None:
        active: WeakSet[Motivated] = WeakSet()
        self.sides = [Motivated(t, name, Drives(**drives), active) for t in TASKS]
        self.name, self.now = name, 0.0

    def cycles(self, count: int, *there_s: float | None) -> list[Claim]:
        """Bid for so many cycles; return the claims of the last one."""
        found: list[Claim] = []
        for _ in range(count):
            self.now += 1.0
            found = []
            for side, s in zip(self.sides, there_s, strict=True):
                wanted = None if s is None else bid(s)
                messages = side.bid(Cycle(LIST, int(self.now)), wanted, self.now)
                found += [each for each in messages if isinstance(each, Claim)]
        return found

    def hears(self, other: str, task: int, utility: float | None = 0.5) -> None:
        ballot = Ballot(1, 0.0, False, other)
        claim = Claim(TASKS[task].name, ballot, Cycle(LIST, int(self.now)), utility)
        self.sides[task].on_claim(claim, self.now)

    @property
    def does(self) -> list[int]:
        return [n for n, side in enumerate(self.sides) if side.share]


def test_a_robot_grows_impatient_sooner_for_a_near_task_and_does_one_at_a_time() -> None:
    robot = Robot("fleet-1", fast=0.2)
    assert robot.cycles(1, 40.0, 10.0) == []
    claims = robot.cycles(1, 40.0, 10.0)
    assert [claim.resource for claim in claims] == ["task-1"], "after 0.2 x 10 s"
    robot.cycles(30, 40.0, 10.0)
    assert robot.does == [1], "activity suppression"
    robot.cycles(1, 40.0, None)
    assert robot.does == [], "its task is done"
    robot.cycles(7, 40.0, None)
    assert robot.does == [], "the motivation begins anew"
    robot.cycles(1, 40.0, None)
    assert robot.does == [0]


def test_a_robot_waits_for_another_one_and_takes_over_once_that_is_silent() -> None:
    robot = Robot("fleet-1", fast=0.2)
    robot.cycles(2, 12.0, None)
    for _ in range(20):
        robot.hears("fleet-2", 0)
        robot.cycles(1, 12.0, None)
    assert robot.does == []
    robot.cycles(int(SILENT_S) + 3, 12.0, None)
    assert robot.does == [0], "the other robot has been silent"


def test_a_robot_loses_its_patience_with_one_that_takes_too_long() -> None:
    robot = Robot("fleet-1", fast=0.2, allowed_s=30.0, slow_s=1000.0)
    for _ in range(29):
        robot.hears("fleet-2", 0)
        robot.cycles(1, 12.0, None)
    assert robot.does == []
    for _ in range(6):
        robot.hears("fleet-2", 0)
        robot.cycles(1, 12.0, None)
    assert robot.does == [0], "the other one still says that it does it"


def test_a_robot_acquiesces_after_a_time_to_another_that_does_its_task() -> None:
    robot = Robot("fleet-1", fast=0.2, yields_s=20.0, gives_up_s=1000.0)
    robot.cycles(2, 10.0, None)
    for _ in range(20):
        robot.hears("fleet-2", 0)
        robot.cycles(1, 10.0, None)
    assert robot.does == [0]
    robot.hears("fleet-2", 0)
    (release,) = robot.cycles(1, 10.0, None)
    assert release.utility is None
    assert robot.does == []
    alone = Robot("fleet-1", fast=0.2, gives_up_s=40.0)
    alone.cycles(42, 10.0, None)
    assert alone.does == [0]
    alone.cycles(1, 10.0, None)
    assert alone.does == [], "it gives up a task that it does not get done"
