"""What strangers do to a society, and what the workload does not do to it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, pairwise
from math import hypot

import pytest

from armadico.core.driver import NOT_CURRENT
from armadico.core.kernel import Kernel
from armadico.core.messages import (
    JUMP,
    LARGEST_COUNT,
    Claim,
    Command,
    Log,
    Message,
    RobotState,
    Stop,
)
from armadico.core.services import by_people
from armadico.mobile.messages import Origin, Pose, Trajectory, Truth
from armadico.mobile.obstacles import Obstacles
from armadico_tools.faults.fault_types import KINDS
from armadico_tools.faults.plan import Case, Fault
from armadico_tools.faults.sightings import Sight
from armadico_tools.faults.stranger import BEYOND, FLOOD, INSTANCE, MOST_POINTS, RATCHET
from armadico_tools.faults.variants import case_of
from armadico_tools.faults.workload import End, Workload

ALL = ("robot", "encoder", "sonar", "goto", "avoid", "gothrough", "path-planning", "interface")


class Spied(Workload):
    """Keeps what arrives at goto and at the robot agent, from any sender."""

    def __init__(self, *faults: Fault, lasts: float = 12.0) -> None:
        super().__init__(Case(1, "sc4", lasts, faults))
        self.lines: list[str] = []
        self.mesh.watch(lambda _key, line, _now: self.lines.append(line.text), Log)  # type: ignore[attr-defined]
        self.received: dict[str, list[Message]] = {"goto": [], "robot": []}
        self.stops: list[Stop] = []  # that the robot agent held after each message
        for name, received in self.received.items():
            self._spy(self.mesh.node(name).driver.kernel, received)

    def _spy(self, kernel: Kernel, received: list[Message]) -> None:
        receive = kernel.receive

        def spy(message: Message, now: float) -> None:
            received.append(message)
            receive(message, now)
            if kernel.memory.judges:
                self.stops.append(kernel.memory.newest(Stop) or Stop())

        vars(kernel)["receive"] = spy


def strange(received: Sequence[Message], kind: type[Claim | Command]) -> list[Claim | Command]:
    return [m for m in received if isinstance(m, kind) and m.ballot.instance == INSTANCE]


def test_every_kind_of_fault_can_be_applied() -> None:
    assert {*Workload(case_of(0, 5.0))._injector.acts} == {*KINDS}


def test_a_stray_state_is_refused_by_all_and_no_watcher_takes_it_for_the_robots() -> None:
    spied = Spied(Fault("stray-state", 6.0, 1.0, ALL))
    spied.run()
    epochs = [m.cycle.epoch for m in spied.received["goto"] if isinstance(m, RobotState)]
    refused = {
        line.partition("-")[0] for line in spied.lines if f"robot/state: {NOT_CURRENT}" in line
    }
    assert {"goto", "encoder", "sonar", "interface"} <= refused
    state = spied.checker.record.owner.state
    assert state is not None
    assert {*epochs} == {state.cycle.epoch}
    assert len(epochs) > 50


def test_a_state_far_ahead_is_accepted_while_the_robot_agent_hangs_and_left_again() -> None:
    hang = Fault("hang", 6.0, 0.6, ("robot",))
    spied = Spied(hang, Fault("stray-state", 6.5, 0.05, ALL, (), 1.0), lasts=14.0)
    outcome = spied.run()
    numbers = [m.cycle.number for m in spied.received["goto"] if isinstance(m, RobotState)]
    assert numbers.count(LARGEST_COUNT) == 1
    assert any("a number that did not continue" in line for line in spied.lines)
    assert outcome.violations == ()


@pytest.mark.long
def test_states_climb_for_as_long_as_it_lasts() -> None:
    spied = Spied(Fault("stray-state", 6.0, 2.0, ALL, (), 2.0), lasts=16.0)
    outcome = spied.run()
    numbers = [m.cycle.number for m in spied.received["goto"] if isinstance(m, RobotState)]
    assert max(numbers) > 400
    assert len(numbers) > 200
    assert outcome.violations == ()


@pytest.mark.parametrize(("which", "kind", "far"), [(0.0, Trajectory, 0), (1.0, Origin, 2)])
def test_a_latched_state_with_a_huge_counter_is_corrected_by_its_author(
    which: float, kind: type[Trajectory | Origin], far: int
) -> None:
    gone = [Fault("crash", 8.0, 0.5, (name,)) for name in ("encoder", "goto")]
    spied = Spied(Fault("huge-counter", 6.0, 1.0, ALL, (), which, float(far)), *gone, lasts=16.0)
    outcome = spied.run()
    received = [m.counter for m in spied.received["goto"] if isinstance(m, kind)]
    assert max(received) > BEYOND[far]
    known = {node.agent.memory.newest(kind) for node in spied.mesh.nodes if node.alive}
    assert len(known) == 1
    (newest,) = known
    assert newest is not None
    assert newest.counter < BEYOND[far]
    assert outcome.violations == ()


@pytest.mark.long(but=("0.005-huge-term-1.0",))
@pytest.mark.parametrize(("kind", "which"), [("huge-term", 1.0), ("flood", 0.0)])
@pytest.mark.parametrize("each", [0.005, 0.0149])
def test_a_flood_delays_no_stop_where_each_message_takes_long(
    kind: str, which: float, each: float
) -> None:
    slow = Fault("slow", 4.0, 2.0, ("robot",), (), each)
    outcome = Spied(slow, Fault(kind, 5.0, 1.3, ALL, (), which), lasts=8.0).run()
    assert outcome.violations == ()


@pytest.mark.long(but=("0.0-1",))
@pytest.mark.parametrize(("which", "claims"), [(0.0, 1), (1.0, RATCHET)])
def test_claims_with_huge_terms_arrive(which: float, claims: int) -> None:
    spied = Spied(Fault("huge-term", 6.0, 1.0, ALL, (), which), lasts=8.0)
    spied.run()
    for received in spied.received.values():
        terms = [claim.ballot.term for claim in strange(received, Claim)]
        assert len(terms) == claims
        assert terms == sorted(terms)
        assert (terms[-1] == LARGEST_COUNT) is (claims == 1)


@pytest.mark.long
def test_a_flood_arrives_and_moves_nothing() -> None:
    spied = Spied(Fault("flood", 6.0, 1.0, ALL))
    outcome = spied.run()
    assert len(strange(spied.received["goto"], Claim)) == FLOOD
    assert len(strange(spied.received["robot"], Command)) == FLOOD
    assert outcome.violations == ()


@pytest.mark.long(but=("2.0-0",))
@pytest.mark.parametrize(("which", "received"), [(0.0, 1), (1.0, 0), (2.0, 0)])
def test_a_huge_message_is_read_or_refused_and_the_robot_drives_on(
    which: float, received: int
) -> None:
    spied = Spied(Fault("huge-message", 6.0, 1.0, ALL, (), which))
    outcome = spied.run()
    sizes = [len(m.points) for m in spied.received["goto"] if isinstance(m, Obstacles)]
    assert sizes.count(MOST_POINTS) == received
    refused = any("on sonar/obstacles: not a Obstacles" in line for line in spied.lines)
    assert refused is (received == 0)
    assert outcome.violations == ()


@pytest.mark.long(but=("0.0-counters0-judged0",))
@pytest.mark.parametrize(
    ("which", "counters", "judged"),
    [
        (0.0, [1, 2], [1, 2]),
        (1.0, [1, 2, 1, 4], [1, 2, 3, 4]),  # a new press stops with the next counter
        (2.0, [1, 0, 2], [1, 2]),
        (3.0, [1, 2, 1], [1, 2]),  # the released press stays released
        (4.0, [JUMP, JUMP + 1], [JUMP, JUMP + 1]),
    ],
)
def test_a_stop_and_its_release_have_these_counters(
    which: float, counters: list[int], judged: list[int]
) -> None:
    """A person publishes the first ones; the robot agent makes the second ones of them."""
    published: list[Stop] = []

    def of_people(key: str, stop: Message, _now: float) -> None:
        assert isinstance(stop, Stop)
        if by_people(key.rpartition("/")[2]):  # agents restore a stop on keys of their own
            published.append(stop)

    spied = Spied(Fault("stop-and-release", 6.0, 3.0, ("robot",), (), which))
    spied.mesh.watch(of_people, Stop)
    spied.run()
    assert [stop.counter for stop, _ in groupby(published)] == counters
    own = [stop for stop, _ in groupby(spied.stops) if stop.by == INSTANCE]
    assert [(stop.counter, stop.stopped) for stop in own] == [
        (counter, index % 2 == 0) for index, counter in enumerate(judged)
    ]
    last = own[-1]
    assert {node.agent.memory.newest(Stop) for node in spied.mesh.nodes if node.alive} == {last}


@pytest.mark.long
def test_a_second_robot_agent_is_refused() -> None:
    spied = Spied(Fault("two-robot-agents", 6.0, 3.0, ("robot",)))
    outcome = spied.run()
    assert outcome.sights[Sight.SECOND_REFUSED.name] == 1
    assert outcome.violations == ()
    epochs = {m.cycle.epoch for m in spied.received["goto"] if isinstance(m, RobotState)}
    assert len(epochs) == 1


@pytest.mark.long
def test_a_second_robot_agent_is_there_for_a_while_and_is_not_taken_for_the_first() -> None:
    spied = Spied(Fault("two-robot-agents", 6.0, 3.0, ("robot",), (), 1.0))
    spied.run()
    (first, second) = (node for node in spied.mesh.nodes if node.name == "robot")
    assert first.device is not second.device
    assert (first.alive, second.alive) == (True, False)
    epochs = {m.cycle.epoch for m in spied.received["goto"] if isinstance(m, RobotState)}
    assert len(epochs) == 2
    state = spied.checker.record.owner.state
    assert state is not None
    assert state.cycle.epoch == first_epoch(spied)


def first_epoch(spied: Spied) -> int:
    return next(m.cycle.epoch for m in spied.received["goto"] if isinstance(m, RobotState))


def test_the_agents_that_know_the_pose_restart_one_after_the_other() -> None:
    order = ("encoder", "robot", "localization")
    spied = Spied(Fault("in-turn", 6.0, 3.0, order))
    there: list[tuple[int, ...]] = []
    spied._injector.schedule(spied.case.faults)
    for tenth in range(59, 95):
        spied.mesh.run(tenth / 10)
        alive = [node.name for node in spied.mesh.nodes if node.alive]
        now = tuple(map(alive.count, order))
        if not there or there[-1] != now:
            there.append(now)
    all_there = (1, 1, 1)
    assert there == [all_there, (0, 1, 1), all_there, (1, 0, 1), all_there, (1, 1, 0), all_there]


@pytest.mark.long
def test_the_workload_mends_nothing_on_the_quiet() -> None:
    """A lost pose stays lost, unless the society finds it again."""
    lost = Fault("robot-restart", 8.0, 0.8, ("robot",))
    workload = Workload(Case(3, "sc4", 60.0, (lost,), sensors="ideal"))
    off: list[float] = []
    truth: list[Truth] = []
    workload.mesh.watch(lambda _key, message, _now: truth.append(message), Truth)  # type: ignore[arg-type]

    def posed(_key: str, pose: Message, _now: float) -> None:
        assert isinstance(pose, Pose)
        off.append(hypot(pose.x - truth[-1].x, pose.y - truth[-1].y))

    workload.mesh.watch(posed, Pose)
    outcome = workload.run()
    assert outcome.violations == ()
    assert [node.name for node in workload.mesh.nodes].count("encoder") == 1
    steps = [abs(after - before) for before, after in pairwise(off)]
    assert sum(step > 0.1 for step in steps) <= 1  # at the restart, and never again


@pytest.mark.long
def test_a_mission_goes_on_with_another_interface_agent() -> None:
    gone = Fault("interface-restart", 8.0, 1.0, ("interface",))
    outcome = Workload(Case(1, "sc4", 14.0, (gone,))).run()
    assert End.FORGOTTEN.name not in outcome.ends
    assert outcome.violations == ()


@pytest.mark.long
def test_a_refused_agent_is_restarted_if_no_other_is_alive() -> None:
    """The second robot agent joins while the first is away, which then has to wait for it."""
    away = Fault("crash", 6.0, 2.0, ("robot",))
    second = Fault("two-robot-agents", 6.5, 4.0, ("robot",))
    spied = Spied(away, second, lasts=20.0)
    spied.run()
    first = [node for node in spied.mesh.nodes if node.name == "robot" and node.alive]
    assert len(first) == 1
    assert first[0].device is spied.rehearsal.robot
    assert first[0].driver.started
