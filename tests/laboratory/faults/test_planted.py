"""Bugs planted into a society that keeps its promises: the checker catches one of each promise.

`test_checker` has the clauses of each rule.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from msgspec.structs import replace

from armadico.agents.localization.encoder import Encoder
from armadico.bridge import robot
from armadico.bridge.p2os.commands import Cmd, command
from armadico.bridge.p2os.session import Session
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.core.agent import Agent
from armadico.core.bidding import Bidding
from armadico.core.coordination import TRANSITIONS, Contender, Event, Owner, State, Verdict
from armadico.core.exchange import AT_ONCE, SmoothExchange
from armadico.core.kernel import Kernel
from armadico.core.latched import Memory
from armadico.core.messages import Latched, Message, RobotState, Stop
from armadico.core.resources import WHEELS, Resource
from armadico.mesh.virtual_device import Ports
from armadico.mobile.messages import Origin, Trajectory
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.plan import AGENTS, Case, Fault, Outcome, Variation
from armadico_tools.faults.planted import DEFECTS
from armadico_tools.faults.series import smallest
from armadico_tools.faults.shrink import AFTER_S
from armadico_tools.faults.variants import case_of
from armadico_tools.faults.workload import run, when_broken
from tests.once import Once

Plant = Callable[[pytest.MonkeyPatch], None]
BEHAVIOURS = ("goto", "avoid", "gothrough")
SEEDS = 16
"""Some bugs show only where utilities cross at the wrong moment."""


def case(
    *faults: Fault, scenario: str = "sc4", lasts: float = 25.0, seed: int = 1, planted: str = ""
) -> Case:
    """The seed is the first that is tried."""
    return Case(seed, scenario, lasts, faults, sensors="ideal", planted=planted)


def by_laser(planted: str) -> Case:
    """A laser shows a wall as it is; of a sonar's echo the whole cone has to be in the way."""
    return replace(case(scenario="sc3", lasts=30.0, planted=planted), robot="jackal")


# The bugs -----------------------------------------------------------------------------------------


def obeys_smaller_ballots(patch: pytest.MonkeyPatch) -> None:
    _owner_forgets(patch, Verdict.STALE_BALLOT)


def obeys_old_cycles(patch: pytest.MonkeyPatch) -> None:
    _owner_forgets(patch, Verdict.OLD_CYCLE)


def _owner_forgets(patch: pytest.MonkeyPatch, rule: Verdict) -> None:
    judged = Owner._verdict

    def verdict(self: Owner, *args: Any, **named: Any) -> Verdict:
        found = judged(self, *args, **named)
        return Verdict.OBEYED if found is rule else found

    patch.setattr(Owner, "_verdict", verdict)
    patch.setattr(Owner, "on_claim", lambda self, claim: False)


def never_yields(patch: pytest.MonkeyPatch) -> None:
    # Another table, not that one without a row: put back it would be the last, also in the docs.
    left = {row: to for row, to in TRANSITIONS.items() if row != (State.HOLDING, Event.OUTBID)}
    patch.setattr("armadico.core.coordination.TRANSITIONS", left)
    patch.setattr("armadico.core.coordination.UNOBEYED", 60)


def starts_from_no_echo(patch: pytest.MonkeyPatch) -> None:
    acked = Contender.acked
    patch.setattr(
        Contender, "acked", lambda self, ack, now: acked(self, replace(ack, largest=None), now)
    )


def orders_no_stop(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Resource, "silence", lambda self, period: 3.0)


def has_no_guard(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Ports, "_brake", lambda self, port: None)


def has_no_guard_and_no_watchdog(patch: pytest.MonkeyPatch) -> None:
    has_no_guard(patch)
    patch.setattr(Microcontroller, "_watchdog_tripped", lambda self: False)


def stops_without_a_ramp(patch: pytest.MonkeyPatch) -> None:
    stop = Session.stop

    def halt(self: Session) -> None:
        stop(self)
        self._out += command(Cmd.E_STOP)

    patch.setattr(Session, "stop", halt)


def takes_no_turn_in_a_new_epoch(patch: pytest.MonkeyPatch) -> None:
    def begins(self: Bidding, message: Any) -> bool:
        last, cycle = self._turned, message.cycle
        if last is not None and cycle.number <= last.number:
            return False
        self._turned = cycle
        return True

    patch.setattr(Bidding, "_begins_turn", begins)


def raises_when_an_agent_goes(patch: pytest.MonkeyPatch) -> None:
    def on_disappeared(self: Agent, name: str, instance: str) -> None:
        raise KeyError(name)

    patch.setattr(Agent, "on_disappeared", on_disappeared)


def blends_nothing(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(SmoothExchange, "begin", lambda self, *args: AT_ONCE)


def takes_no_news_of_tokens(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Contender, "gone", lambda self, instance, now: [])


def latches_no_stop(patch: pytest.MonkeyPatch) -> None:
    take = Kernel._accept_latched

    def taken(self: Kernel, message: Latched) -> bool:
        if not (isinstance(self.agent, robot.Robot) and isinstance(message, Stop)):
            return take(self, message)
        if message.stopped:
            self.agent.rest(WHEELS)
        return False

    patch.setattr(Kernel, "_accept_latched", taken)


def stops_again_by_an_old_stop(patch: pytest.MonkeyPatch) -> None:
    """A late copy of a released stop stops the robot again."""
    update = Memory._update_stop

    def updated(self: Memory, stop: Stop, now: float) -> bool:
        self._presses.clear()
        return update(self, stop, now)

    patch.setattr(Memory, "_update_stop", updated)


def does_not_publish_the_stop(patch: pytest.MonkeyPatch) -> None:
    publish = Kernel.publish

    def published(self: Kernel, message: Message, **names: str) -> None:
        if not isinstance(message, Stop):
            publish(self, message, **names)

    patch.setattr(Kernel, "publish", published)


def ignores_restored_states(patch: pytest.MonkeyPatch) -> None:
    """Localization would mend the pose within a cycle."""
    patch.setattr(Encoder, "on_correction", lambda self, correction: None)


def remembers_no_origin(patch: pytest.MonkeyPatch) -> None:
    ignores_restored_states(patch)
    _forgets(patch, Origin)


def remembers_no_mission(patch: pytest.MonkeyPatch) -> None:
    _forgets(patch, Trajectory)


def _forgets(patch: pytest.MonkeyPatch, kind: type[Latched]) -> None:
    """No agent restores a latched state of a kind."""
    due = Memory.due

    def given(self: Memory, now: float) -> list[Latched]:
        return [message for message in due(self, now) if not isinstance(message, kind)]

    patch.setattr(Memory, "due", given)


def measures_turns_the_wrong_way(patch: pytest.MonkeyPatch) -> None:
    publish = robot.Robot.publish

    def published(self: robot.Robot, message: Message, **names: str) -> None:
        if isinstance(message, RobotState):
            message = replace(message, w=-message.w)
        publish(self, message, **names)

    patch.setattr(robot.Robot, "publish", published)


def nothing_else(_patch: pytest.MonkeyPatch) -> None:
    """The case itself has a defect planted (`Case.planted`)."""


@dataclass(frozen=True)
class Bug:
    """A bug, the promise that it breaks, and a case in which it does."""

    plant: Plant
    breaks: Promise
    case: Case


_CUT = Fault("partition", 8.0, 3.0, ("robot",), BEHAVIOURS)
_LATE = Fault("delay", 8.0, 4.0, BEHAVIOURS, ("robot",), 0.35, 0.3)
_SLOW = Fault("delay", 4.0, 5.0, AGENTS, AGENTS, 0.345)
_LONE = Fault("lone-restart", 15.69, 0.549, ("goto",))
_HANG = Fault("hang", 14.0, 9.0, ("robot",))
_AGAIN = Fault("robot-restart", 8.0, 0.5, ("robot",))
_GONE = Fault("crash", 8.0, 1.0, ("avoid",))
_KILLED = Fault("crash", 5.5, 1.0, ("avoid",))  # in scenario 3 it holds then, and goto bids
_STOP = Fault("stop", 8.0, 5.0, ("robot",))
_OLD_STOP = Fault("stop-and-release", 8.0, 5.0, ("robot",), (), 3.0)
_ENCODER = Fault("crash", 12.0, 1.0, ("encoder",))
_INTERFACE = Fault("interface-restart", 8.0, 1.0, ("interface",))
_IN_A_STOP = Fault("robot-restart", 10.0, 0.5, ("robot",))


def on_a_mission(planted: str) -> Case:
    return replace(case(scenario="surveillance", planted=planted), variant="mission")


def with_pauses(scenario: str, planted: str) -> Case:
    """To and fro for a while, with a stop; the robot rests after each mission.

    In `sc3` with seed 1 the sound robot is caught beside a column (docs/results-reliability.md).
    """
    seed = 2 if scenario == "sc3" else 1
    drive = case(_STOP, scenario=scenario, planted=planted, lasts=90.0, seed=seed)
    return replace(drive, variation=Variation(pause=6.0))


BUGS = (
    Bug(obeys_smaller_ballots, Promise.ONE_DRIVER, case(scenario="sc3", lasts=20.0)),
    Bug(obeys_old_cycles, Promise.FRESH, case(_LATE)),
    Bug(never_yields, Promise.ONE_HOLDER, case(scenario="sc3")),
    Bug(starts_from_no_echo, Promise.OBEYED, case(_SLOW, _LONE)),
    Bug(orders_no_stop, Promise.SILENCE, case(_CUT)),
    Bug(has_no_guard_and_no_watchdog, Promise.WATCHDOG, case(_HANG)),
    Bug(stops_without_a_ramp, Promise.SMOOTH, case(_CUT)),
    Bug(takes_no_turn_in_a_new_epoch, Promise.MOVES, case(_AGAIN)),
    Bug(blends_nothing, Promise.SMOOTH, case(scenario="rooms-a", seed=4)),
    Bug(takes_no_news_of_tokens, Promise.HANDOVER, case(_KILLED, scenario="sc3", lasts=12.0)),
    Bug(latches_no_stop, Promise.STOP, case(_STOP)),
    Bug(does_not_publish_the_stop, Promise.STOP, case(_STOP, _IN_A_STOP)),
    Bug(stops_again_by_an_old_stop, Promise.STOP, case(_OLD_STOP)),
    Bug(remembers_no_origin, Promise.POSE, case(_ENCODER)),
    Bug(remembers_no_mission, Promise.ARRIVES, case(_INTERFACE)),
    Bug(measures_turns_the_wrong_way, Promise.ODOMETRY, case(lasts=12.0)),
    Bug(raises_when_an_agent_goes, Promise.NO_ERROR, case(_GONE)),
    *(
        Bug(nothing_else, promise, with_pauses(scenario, name))
        for name, promise, scenario in (
            ("early", Promise.REACHED, "sc1"),
            ("fails", Promise.FAILED, "sc1"),
            ("refuses", Promise.FAILED, "sc1"),
            ("half-speed", Promise.SPEED, "sc1"),
            ("caps", Promise.SPEED, "sc4"),
            ("stands", Promise.STANDS, "sc1"),
            ("no-way", Promise.STANDS, "sc4"),
            ("lost", Promise.FOUND, "sc1"),
            ("blinks", Promise.FOUND, "sc4"),
            ("unsure", Promise.FOUND, "sc4"),
            ("flickers", Promise.STEADY, "sc1"),
            ("biased", Promise.SENSORS, "sc4"),
            ("slow-brake", Promise.BRAKES, "sc1"),
            ("lies", Promise.HONEST, "sc4"),
            ("no-reflex", Promise.COLLISION, "sc3"),
            ("late", Promise.ORDERED, "sc1"),
            ("jumps", Promise.POSE, "sc1"),
            ("scaled", Promise.ODOMETRY, "sc3"),
            ("endless", Promise.ARRIVES, "sc1"),
            ("straight", Promise.PATH, "sc4"),
            ("keeps", Promise.HELD, "sc1"),
            ("hides", Promise.SENSORS, "sc4"),
            ("mirrored", Promise.SENSORS, "rooms-b"),
            ("frozen", Promise.SENSORS, "rooms-b"),
            ("spins", Promise.ORDERED, "sc4"),
            ("doubled", Promise.BRAKES, "sc4"),
            ("shifted", Promise.POSE, "rooms-a"),
            ("aside", Promise.REACHED, "sc1"),
        )
    ),
    Bug(nothing_else, Promise.EARNED, by_laser("no-reflex")),
    Bug(nothing_else, Promise.REACHED, on_a_mission("skips")),
)


def promises(outcome: Outcome) -> set[str]:
    return {name for name, _, _ in outcome.violations}


@pytest.mark.long(but=("measures_turns_the_wrong_way",))
@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.case.planted or bug.plant.__name__)
def test_it_is_caught_and_without_it_nothing_is_broken(
    bug: Bug, monkeypatch: pytest.MonkeyPatch, once: Once
) -> None:
    bug.plant(monkeypatch)
    for more in range(SEEDS):
        caught = replace(bug.case, seed=bug.case.seed + more)
        at = when_broken(caught, bug.breaks)
        if at is not None:
            break
    assert at is not None, f"in none of {SEEDS} runs"
    monkeypatch.undo()
    sound = replace(caught, planted="")
    if not caught.planted:  # else many bugs have the same one
        sound = replace(sound, lasts=at + AFTER_S)
    name = hashlib.sha256(sound.dumps().encode()).hexdigest()
    assert once(f"sound-{name}", lambda: run(sound)).violations == ()


def test_every_promise_has_a_bug_that_breaks_it() -> None:
    assert {bug.breaks for bug in BUGS} == {*Promise}


@pytest.mark.long
def test_an_honest_robot_agent_lets_no_unearned_speed_through_of_a_liar(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    without_gate = run(by_laser("no-reflex"))
    assert Promise.EARNED.name in promises(without_gate)
    both = DEFECTS["no-reflex"]
    liar_alone = both._replace(plants={"goto": both.plants["goto"]})
    monkeypatch.setitem(DEFECTS, "no-reflex", liar_alone)
    honest = run(by_laser("no-reflex"))
    assert Promise.HONEST.name in promises(honest)  # it lies, and is refused
    assert not promises(honest) & {Promise.EARNED.name, Promise.COLLISION.name}


@pytest.mark.long
def test_what_a_bug_breaks_is_shrunk_to_the_faults_that_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    obeys_old_cycles(monkeypatch)
    outcome = next(
        found
        for seed in range(30)
        if Promise.FRESH.name in promises(found := run(case_of(seed, 40.0, variant="sonar")))
        and found.violations[0][0] == Promise.FRESH.name
        and len(found.case.faults) >= 4
    )
    small, promise = smallest(outcome, 60)
    assert promise == Promise.FRESH.name
    assert 1 <= len(small.faults) <= 2
    assert small.lasts <= outcome.violations[0][1] + 1.0
    assert Promise.FRESH.name in promises(run(small))
    monkeypatch.undo()
    assert run(small).violations == ()
