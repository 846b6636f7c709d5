"""An observer of what is said in a society of real processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

from armadico.core.messages import (
    Ack,
    Ask,
    Ballot,
    BidHistory,
    BidRecord,
    Claim,
    Command,
    Description,
    Log,
    Message,
    RobotState,
    decode,
)
from armadico.core.resources import WHEELS
from armadico.core.services import BIDS
from armadico.launch.client import Client
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.mobile.messages import Pose, Truth
from armadico.observe.view import View

SOON = 40.0
"""s; a deadline, not an expectation."""


class Observer:
    """Keeps what is said, as it comes."""

    def __init__(self, mesh: ZenohMesh) -> None:
        self.client = Client(mesh)
        self.view = View()
        self.states: list[RobotState] = []
        self.acks: list[Ack] = []
        self.truths: list[Truth] = []
        self.commands: list[Command] = []
        self.logs: list[str] = []
        kinds = (RobotState, Description, Ack, Truth, Pose, Command, Claim, Log)
        self.client.listen(*kinds, then=self._keep)

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for something to be so. AssertionError with the last state if it does not come."""
        if not self.client.wait_for(condition, SOON):
            last = [*self.states[-1:], *self.acks[-1:]]
            said = "\n  ".join(self.logs[-10:])
            there = f"alive: {', '.join(sorted(self.names))}"
            raise AssertionError(f"not within {SOON:.0f} s: {what}\n {last}\n {there}\n  {said}")

    @property
    def state(self) -> RobotState:
        return self.states[-1]

    @property
    def names(self) -> set[str]:
        """The names of the agents whose tokens are there."""
        return {name for name, _ in self.client.alive}

    @property
    def holder(self) -> str:
        """The instance that was obeyed last; nobody since a release."""
        return self.view.last_driver(WHEELS.name)

    def obeyed_lately(self) -> bool:
        return self.view.driver(WHEELS.name, time.monotonic()) is not None

    def driving(self) -> bool:
        """Whether the robot is on its way, by the truth, and somebody is obeyed."""
        truth = self.view.truth
        return truth is not None and truth.v > 0.2 and self.obeyed_lately()

    def at_rest(self) -> bool:
        return abs(self.truths[-1].v) < 0.01 and abs(self.truths[-1].w) < 0.01

    def cycles(self, count: int) -> None:
        """Let so many cycles pass."""
        last = self.state.cycle.number + count
        self.until(lambda: self.state.cycle.number >= last, f"cycle {last}")

    def truths_pass(self, count: int) -> None:
        """Let so many cycles of the simulator pass."""
        last = len(self.truths) + count
        self.until(lambda: len(self.truths) >= last, f"{count} cycles")

    def pid_of(self, name: str, instance: str) -> int:
        """The process of an instance, by its card."""
        card = self.client.card(name, instance)
        assert card is not None, "it answers"
        return card.pid

    def drives_on(self, cycles: int = 8) -> None:
        """Somebody is obeyed for cycles that come after this call, and the robot moves."""
        first = self.state.cycle

        def on() -> bool:
            at = self.acks[-1].obeyed_cycle
            behind = at is not None and (
                at.epoch != first.epoch or at.number >= first.number + cycles
            )
            return behind and self.driving()

        self.until(on, "somebody is obeyed and the robot moves")

    def bids(self, name: str, instance: str) -> tuple[BidRecord, ...]:
        """What an agent tells of its recent bids; none if it does not answer."""
        key = BIDS.key_for(name=name, instance=instance)
        replies: list[bytes] = []
        over: list[bool] = []
        mesh = self.client.mesh
        mesh.query(key, Ask(), 2.0, lambda _, data: replies.append(data), lambda: over.append(True))
        self.until(lambda: over, "the answer")
        return decode(replies[0], BidHistory).bids if replies else ()

    def _keep(self, message: Message, now: float) -> None:
        self.view.learn(message, now)
        match message:
            case RobotState():
                self.states.append(message)
            case Ack():
                self.acks.append(message)
            case Truth():
                self.truths.append(message)
            case Command():
                self.commands.append(message)
            case Log():
                self.logs.append(message.text)


def ballots_never_go_down(acks: list[Ack]) -> None:
    """What is refused by, and what is obeyed, only grows within an epoch; nor do cycles.

    After a release nobody is obeyed, until somebody with a larger ballot is.
    """
    for before, after in pairwise(acks):
        fell = after.cycle <= before.cycle or _rank(after.largest) < _rank(before.largest)
        assert before.cycle.epoch != after.cycle.epoch or not fell, f"{before}\n{after}"
    for before, after in pairwise(ack for ack in acks if ack.obeyed is not None):
        fell = _rank(after.obeyed) < _rank(before.obeyed)
        assert before.cycle.epoch != after.cycle.epoch or not fell, f"{before}\n{after}"


def _rank(ballot: Ballot | None) -> tuple[int, float, bool, str]:
    if ballot is None:
        return (-1, 0.0, False, "")
    return (ballot.term, ballot.utility, ballot.critical, ballot.instance)


def mesh_of(namespace: str) -> ZenohMesh:
    """A session as a tool has it."""
    return ZenohMesh(namespace, topology(), starts=True)
