"""Faults from outside the society: a stranger publishes invalid messages, or joins.

A stranger's messages arrive unseen by watchers. Those of people, the stop and its release, are
seen.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import cos, sin, tau
from random import Random
from typing import Final

import cbor2
from msgspec.structs import replace

from armadico.bridge.kind import simulated
from armadico.bridge.robot import Parameters, Robot
from armadico.core.messages import (
    COUNTS,
    JUMP,
    LARGEST_COUNT,
    LARGEST_PAYLOAD,
    Ack,
    Ballot,
    Claim,
    Command,
    Cycle,
    Latched,
    Message,
    Point,
    RobotState,
    Stop,
    encode,
)
from armadico.core.resources import WHEELS
from armadico.core.services import service_of
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import Node
from armadico.mobile.messages import Origin, Trajectory
from armadico.mobile.obstacles import Obstacles
from armadico_tools.faults.fault_types import STRANGE_UTILITY
from armadico_tools.faults.plan import Fault

INSTANCE: Final = "stranger-0123456789abcdef"
RATCHET: Final = 40
"""Successive claims, each as far ahead of the last as is accepted."""

FLOOD: Final = 2000
"""Claims, and as many commands, within a flood's duration, a second at most."""

POINTS: Final = 20_000  # of a message that is too large
MOST_POINTS: Final = 2048  # of the largest message that is accepted
FAR_M: Final = 40.0
"""Distance of those points, so that no agent needs to avoid them."""

OLD_CYCLES: Final = 10

CLIMB_S: Final = 0.02
"""Period of rising states."""

CLIMB: Final = 4
"""Cycles between rising states."""

AGAIN_S: Final = 0.3
"""Period of publishing a release, s."""

BEYOND: Final = (JUMP, 3 * JUMP, LARGEST_COUNT // 2)
"""Counters of latched states beyond the known one: the largest that is accepted, and larger."""


class Stranger:
    """Publishes a fault's messages, and joins."""

    def __init__(self, rehearsal: Rehearsal) -> None:
        self.nodes: list[Node] = []  # processes outside the society
        self._rehearsal = rehearsal
        self._mesh = rehearsal.mesh
        self._state: RobotState | None = None
        self._latched: dict[type[Latched], tuple[str, Trajectory | Origin]] = {}
        self._counter = 0  # the largest of a published stop
        self._press = 0  # the press of that stop
        self._presses = Random(f"presses/{self._mesh.seed}")
        self._term = 0
        self._second: dict[Fault, Node] = {}
        self._mesh.watch(self._on_message, RobotState, Claim, Trajectory, Origin)
        self.acts: dict[str, Callable[[Fault, bool], None]] = {
            "stop": self._stop,
            "stop-and-release": self._stop_and_release,
            "stray-state": self._stray_state,
            "huge-term": self._huge_term,
            "huge-counter": self._huge_counter,
            "flood": self._flood,
            "huge-message": self._huge_message,
            "two-robot-agents": self._two_robot_agents,
        }

    def _on_message(self, key: str, message: Message, _now: float) -> None:
        if isinstance(message, RobotState):
            self._state = message
            if message.stop.counter >= self._counter:
                self._counter, self._press = message.stop.counter, message.stop.press
        elif isinstance(message, Claim):
            self._term = max(self._term, message.ballot.term)
        elif isinstance(message, Trajectory | Origin):
            self._latched[type(message)] = key, message

    def _deliver(self, message: Message, _a: object = None, _b: object = None) -> None:
        self._deliver_on(_key(message), message)

    def _deliver_on(self, key: str, message: Message) -> None:
        for name in dict.fromkeys(node.name for node in self._mesh.nodes):
            self._mesh.arrive(message, name, key)

    # The stop ------------------------------------------------------------------------------------

    def _stop(self, _fault: Fault, begins: bool) -> None:
        self._publish_stop(stopped=begins)

    def _stop_and_release(self, fault: Fault, begins: bool) -> None:
        """Stop, and release at the end, by the fault's amount.

        1: the stop has a smaller counter than a known one. 2: after a third of the time there is a
        release with too small a counter. 3: a stop is released at once, and repeated later without
        effect. 4: the counter is as far ahead of the known one as is accepted.
        """
        now, lasts, variant = self._mesh.now, fault.lasts, fault.amount
        if not begins:
            if variant != 3.0:
                self._publish_stop(stopped=False)
            return
        if variant == 4.0:
            self._counter += JUMP - 1
        self._publish_stop(stopped=True)
        first = Stop(self._counter, True, INSTANCE, self._press)
        if variant in (1.0, 3.0):
            self._publish_stop(stopped=False)
        if variant == 1.0:
            small = Stop(max(self._counter - 1, 0), True, INSTANCE, self._presses.getrandbits(63))
            self._mesh.call_at(now + 0.2 * lasts, partial(self._publish, small))
        elif variant == 2.0:
            small = Stop(self._counter - 1, False, INSTANCE, self._presses.getrandbits(63))
            self._mesh.call_at(now + lasts / 3, partial(self._publish, small))
        elif variant == 3.0:
            self._mesh.call_at(now + 0.2 * lasts, partial(self._publish, first))

    def _publish_stop(self, *, stopped: bool) -> None:
        """Publish a new stop, or the release of the newest."""
        self._counter += 1
        if stopped:
            self._press = self._presses.getrandbits(63)
        message = Stop(self._counter, stopped, INSTANCE, self._press)
        self._publish(message)
        if not stopped:
            self._mesh.call_at(self._mesh.now + AGAIN_S, self._publish_again, message)

    def _publish_again(self, release: Stop, _: object = None) -> None:
        """Publish a release until the robot agent has it, as programs do."""
        if self._state is None or self._state.stop.press != release.press:
            return
        if self._state.stop.stopped:
            self._publish(release)
            self._mesh.call_at(self._mesh.now + AGAIN_S, self._publish_again, release)

    def _publish(self, message: Message, _a: object = None, _b: object = None) -> None:
        self._mesh.publish(message)

    # Messages ------------------------------------------------------------------------------------

    def _stray_state(self, fault: Fault, begins: bool) -> None:
        """Deliver states of another robot or recording (0), or of the present epoch.

        1: one as far ahead as possible. 2: rising ones while the fault lasts.
        """
        state = self._state
        if not begins or state is None:
            return
        rng = Random(f"stray/{self._mesh.seed}/{fault.at}")
        if fault.amount == 0.0:
            cycle = Cycle(rng.getrandbits(63), rng.randrange(100_000))
            self._deliver(replace(state, cycle=cycle))
        elif fault.amount == 1.0:
            self._deliver(replace(state, cycle=Cycle(state.cycle.epoch, LARGEST_COUNT)))
        else:
            for step in range(1, int(fault.lasts / CLIMB_S) + 1):
                cycle = Cycle(state.cycle.epoch, state.cycle.number + CLIMB * step)
                at = self._mesh.now + CLIMB_S * (step - 1)
                self._mesh.call_at(at, self._deliver, replace(state, cycle=cycle))

    def _huge_counter(self, fault: Fault, begins: bool) -> None:
        """Deliver the mission (0) or the pose's origin (1) with a counter far beyond.

        On its author's key: on that of a stranger, which shows no token, nobody would read it.
        """
        known = self._latched.get(Origin if fault.amount else Trajectory)
        if begins and known is not None:
            key, state = known
            counter = (state.counter + BEYOND[int(fault.spread)]) % COUNTS
            self._deliver_on(key, replace(state, counter=counter))

    def _huge_term(self, fault: Fault, begins: bool) -> None:
        """Deliver a claim with the largest term (0), rising claims (1), or an ack (2)."""
        if not begins or self._state is None:
            return
        if fault.amount == 2.0:
            self._deliver(ack_of(self._state, LARGEST_COUNT))
            return
        climb = [self._term + (step + 1) * JUMP for step in range(RATCHET)]
        for term in climb if fault.amount == 1.0 else [LARGEST_COUNT]:
            self._deliver(self._claim(term))

    def _flood(self, fault: Fault, begins: bool) -> None:
        """Deliver claims and commands, with a beaten ballot or ever larger ones."""
        if not begins:
            return
        within = min(fault.lasts, 1.0)
        for index in range(FLOOD):
            at = self._mesh.now + within * index / FLOOD
            self._mesh.call_at(at, partial(self._flow, fault.amount), index)

    def _flow(self, climbs: float, index: int, _: object) -> None:
        if self._state is None:
            return
        cycle = self._state.cycle
        old = Cycle(cycle.epoch, max(cycle.number - OLD_CYCLES, 0))
        term = self._term + index + 1 if climbs else 1
        self._deliver(self._claim(term))
        self._deliver(Command(WHEELS.name, old, _ballot(term), (0.1, 0.0)))

    def _huge_message(self, fault: Fault, begins: bool) -> None:
        """Publish the largest valid message (0), a larger one (1), or tags slow to decode (2)."""
        if not begins or self._state is None:
            return
        cycle, key = self._state.cycle, service_of(Obstacles).key_for(name="sonar")
        if fault.amount == 0.0:
            data = encode(Obstacles(cycle, None, None, None, None, _ring(MOST_POINTS)))
        elif fault.amount == 1.0:
            points = [[point.x, point.y] for point in _ring(POINTS)]
            data = cbor2.dumps([[cycle.epoch, cycle.number], None, None, None, None, points])
        else:
            digits = LARGEST_PAYLOAD - 100
            # A decimal fraction with a mantissa of so many bytes.
            fraction = b"\xc4\x82\x3a\x00\x0f\x42\x3f\xc2\x5a" + digits.to_bytes(4, "big")
            data = fraction + digits * b"\xff"
        self._mesh.publish_bytes(data, key)

    def _claim(self, term: int) -> Claim:
        assert self._state is not None, "a robot agent has published"
        rest = WHEELS.neutral
        cycle = self._state.cycle
        return Claim(WHEELS.name, _ballot(term), cycle, STRANGE_UTILITY, False, rest, rest)

    # Another robot -------------------------------------------------------------------------------

    def _two_robot_agents(self, fault: Fault, begins: bool) -> None:
        """Add a robot agent with a separate controller, whose wheels no agent here observes.

        1: it skips admission, as if it had joined while the network was partitioned.
        """
        if not begins:
            node = self._second.pop(fault)
            if node.alive:
                node.leave()
            return
        scenario, mesh = self._rehearsal.scenario, self._mesh
        number = 1000 + len(self.nodes)
        device = simulated(scenario, lambda name: mesh.stream(f"second/{name}"))
        identity = mesh.identity(Robot.name, number)
        agent = Robot(identity, Parameters(port="memory:", profile=scenario.robot))
        node = mesh.add(agent, device, admit=fault.amount != 1.0)
        self.nodes.append(node)
        self._second[fault] = node


def ack_of(state: RobotState, term: int) -> Ack:
    """The next cycle's ack, with a term that was received."""
    cycle = Cycle(state.cycle.epoch, state.cycle.number + 1)
    return Ack(WHEELS.name, cycle, _ballot(term))


def _key(message: Message) -> str:
    """The key of a stranger's message."""
    if isinstance(message, Claim):
        return WHEELS.utility_key_of(INSTANCE)
    if isinstance(message, Command):
        return WHEELS.command_key_of(INSTANCE)
    if isinstance(message, Ack):
        return WHEELS.ack_key
    return service_of(type(message)).key_for(instance=INSTANCE, name="sonar")


def _ring(count: int) -> tuple[Point, ...]:
    angles = (tau * index / count for index in range(count))
    return tuple(Point(FAR_M * cos(angle), FAR_M * sin(angle)) for angle in angles)


def _ballot(term: int) -> Ballot:
    return Ballot(term, STRANGE_UTILITY, False, INSTANCE)
