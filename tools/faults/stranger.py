"""Faults that come from outside the society: somebody says what nobody of it would, or joins it.

What a stranger says to the agents arrives without being shown to those who watch; what people say,
the stop and its release, is shown.
"""

from __future__ import annotations

from functools import partial
from math import cos, sin, tau
from random import Random
from typing import Any, Final

from msgspec.structs import replace

from armadico.bridge.robot import Parameters, Robot
from armadico.coordination import TERM_JUMP
from armadico.discovery import SIMULATORS, find
from armadico.mesh.virtual_node import Node
from armadico.messages import (
    Ballot,
    Claim,
    Command,
    Cycle,
    Message,
    Obstacles,
    Point,
    RobotState,
    Stop,
)
from armadico.rehearsal import SIMULATOR, Rehearsal
from armadico.resources import WHEELS
from armadico.tools.faults.plan import EVERYBODY, Fault

STRANGE: Final = frozenset(
    {
        *("stop", "stop-and-release", "stray-state", "huge-term", "flood", "huge-message"),
        "two-robot-agents",
    }
)
"""The kinds that are made here."""

WHO: Final = "stranger-0123456789abcdef"
LARGEST_TERM: Final = 2**53 - 1
"""The largest that a message carries."""

RATCHET: Final = 40
"""Claims one after another, each as far ahead of the one before as is believed."""

FLOOD: Final = 2000
"""Claims, and as many commands, within a flood's time, a second at most."""

POINTS: Final = 20_000
FAR_M: Final = 40.0
"""So many points, so far away that nobody need steer for them."""

OLD_CYCLES: Final = 10


class Stranger:
    """Says it, and joins."""

    def __init__(self, rehearsal: Rehearsal) -> None:
        self.nodes: list[Node] = []  # processes that are none of the society's
        self._rehearsal = rehearsal
        self._mesh = rehearsal.mesh
        self._state: RobotState | None = None
        self._counter = 0  # of the stop, the largest that anybody has said
        self._term = 0
        self._second: dict[Fault, Node] = {}
        self._mesh.watch(self._hear, RobotState, Claim)

    def act(self, fault: Fault, *, begins: bool) -> None:
        """Begin a fault, or end it."""
        getattr(self, "_" + fault.kind.replace("-", "_"))(fault, begins)

    def _hear(self, _key: str, message: Message, _now: float) -> None:
        if isinstance(message, RobotState):
            self._state = message
            self._counter = max(self._counter, message.stop.counter)
        elif isinstance(message, Claim):
            self._term = max(self._term, message.ballot.term)

    def _arrives(self, message: Message, _a: Any = None, _b: Any = None) -> None:
        for name in EVERYBODY:
            self._mesh.arrive(message, name)

    # The stop ------------------------------------------------------------------------------------

    def _stop(self, fault: Fault, begins: bool) -> None:  # noqa: ARG002
        self._say_stop(stopped=begins)

    def _stop_and_release(self, fault: Fault, begins: bool) -> None:
        """Stop, and release at the end; 1: the stop's counter is smaller than one that is known.

        2: after a third of the time somebody releases by a counter that is too small.
        """
        if begins and fault.amount == 1.0:
            self._say_stop(stopped=True)
            self._say_stop(stopped=False)
            later = partial(self._say, Stop(max(self._counter - 1, 0), True, WHO))
            self._mesh.call_at(self._mesh.now + 0.2 * fault.lasts, later)
            return
        self._say_stop(stopped=begins)
        if begins and fault.amount == 2.0:
            later = partial(self._say, Stop(self._counter - 1, False, WHO))
            self._mesh.call_at(self._mesh.now + fault.lasts / 3, later)

    def _say_stop(self, *, stopped: bool) -> None:
        self._counter += 1
        self._say(Stop(self._counter, stopped, WHO))

    def _say(self, message: Message, _a: Any = None, _b: Any = None) -> None:
        self._mesh.publish(message)

    # Messages ------------------------------------------------------------------------------------

    def _stray_state(self, fault: Fault, begins: bool) -> None:
        """As of a robot that nobody knows, or of a recording that somebody plays."""
        if begins and self._state is not None:
            rng = Random(f"stray/{self._mesh.seed}/{fault.at}")
            cycle = Cycle(rng.getrandbits(63), rng.randrange(100_000))
            self._arrives(replace(self._state, cycle=cycle))

    def _huge_term(self, fault: Fault, begins: bool) -> None:
        """0: a claim with the largest term; 1: claims that climb; 2: a state that tells of one."""
        if not begins or self._state is None:
            return
        if fault.amount == 2.0:
            self._arrives(heard_of(self._state, _ballot(LARGEST_TERM)))
            return
        climb = [self._term + (step + 1) * TERM_JUMP for step in range(RATCHET)]
        for term in climb if fault.amount == 1.0 else [LARGEST_TERM]:
            self._arrives(self._claim(term))

    def _flood(self, fault: Fault, begins: bool) -> None:
        """Claims and commands, either with a ballot long beaten or with ever larger ones."""
        if not begins:
            return
        within = min(fault.lasts, 1.0)
        for index in range(FLOOD):
            at = self._mesh.now + within * index / FLOOD
            self._mesh.call_at(at, partial(self._flow, fault.amount), index)

    def _flow(self, climbs: float, index: int, _: Any) -> None:
        if self._state is None:
            return
        cycle = self._state.cycle
        old = Cycle(cycle.epoch, max(cycle.number - OLD_CYCLES, 0))
        term = self._term + index + 1 if climbs else 1
        self._arrives(self._claim(term))
        self._arrives(Command(old, _ballot(term), 0.1, 0.0))

    def _huge_message(self, fault: Fault, begins: bool) -> None:  # noqa: ARG002
        if begins and self._state is not None:
            angles = (tau * index / POINTS for index in range(POINTS))
            points = tuple(Point(FAR_M * cos(angle), FAR_M * sin(angle)) for angle in angles)
            self._arrives(Obstacles(self._state.cycle, None, None, None, None, points))

    def _claim(self, term: int) -> Claim:
        assert self._state is not None, "a robot agent has spoken"
        rest = WHEELS.neutral
        cycle = self._state.cycle
        return Claim(WHEELS.name, _ballot(term), cycle, 0.9, False, rest, rest)

    # Another robot -------------------------------------------------------------------------------

    def _two_robot_agents(self, fault: Fault, begins: bool) -> None:
        """One with a controller of its own, whose wheels nobody of this society sees."""
        if not begins:
            node = self._second.pop(fault)
            if node.alive:
                node.leave()
            return
        scenario, mesh = self._rehearsal.scenario, self._mesh
        number = 1000 + len(self.nodes)
        factory = find(SIMULATORS, SIMULATOR).load()
        device = factory(scenario, lambda name: mesh.stream(f"second/{name}"), _unseen)
        identity = mesh.identity(Robot.name, number)
        agent = Robot(identity, Parameters(port="memory:", profile=scenario.robot))
        node = mesh.add(agent, device)
        self.nodes.append(node)
        self._second[fault] = node


def _unseen(_truth: Message) -> None:
    """Nobody watches the other robot."""


def heard_of(state: RobotState, ballot: Ballot) -> RobotState:
    """The next cycle's word, which says that a ballot has been heard."""
    cycle = Cycle(state.cycle.epoch, state.cycle.number + 1)
    return replace(state, cycle=cycle, largest=ballot)


def _ballot(term: int) -> Ballot:
    return Ballot(term, 0.9, False, WHO)
