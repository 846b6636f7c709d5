"""Contenders on the virtual mesh: messages per cycle, and cycles until a command is obeyed."""

from __future__ import annotations

from collections import Counter
from math import cos, pi
from typing import Any, ClassVar, Final

from armadico.core.agent import Agent, Identity
from armadico.core.coordination import Verdict
from armadico.core.cycles import PERIOD
from armadico.core.exchange import Bid
from armadico.core.messages import Ballot, Claim, Command, Message, RobotState
from armadico.core.resources import WHEELS
from armadico.mesh.virtual import VirtualMesh
from armadico.testing.society import RobotOwner
from armadico_tools.bench.figures import Figure, figure

CROWDS: Final = (3, 10, 50)
"""Numbers of contenders."""

SETTLE_CYCLES: Final = 20
ROUND_CYCLES: Final = 400
"""Cycles in which the best utility wanders once through all contenders."""

TURN_CYCLES: Final = 15
"""Cycles after which the best bid is another contender's."""


class Robot(RobotOwner):
    """Notes whose command was the first of its ballot that it obeyed."""

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.first_obeyed: dict[Ballot, int] = {}  # by ballot, the cycle of its first command

    def judged(self, command: Command, verdict: Verdict) -> None:
        """Note the cycle of a ballot's first obeyed command."""
        if verdict is Verdict.OBEYED:
            self.first_obeyed.setdefault(command.ballot, self.counter.number)


class Wanderer(Agent):
    """Its utility rises and falls once a round; the others' do so at other times."""

    reacts_to = RobotState
    needs = (RobotState,)
    competes_for = (WHEELS,)
    place: ClassVar[float] = 0.0  # within the round, from 0 to 1

    def bid(self, message: RobotState) -> Bid | None:
        """Always something; the nearer its place, the better."""
        phase = message.cycle.number / ROUND_CYCLES - self.place
        return Bid(0.5 + 0.4 * cos(2 * pi * phase), (0.5, 0.1 * self.place))


class TurnTaker(Agent):
    """Bids 0.9 when it is its turn, else 0.3."""

    reacts_to = RobotState
    needs = (RobotState,)
    competes_for = (WHEELS,)
    place: ClassVar[int] = 0

    def bid(self, message: RobotState) -> Bid | None:
        """One of `CROWDS[0]` takes its turn."""
        turn = message.cycle.number // TURN_CYCLES % CROWDS[0]
        return Bid(0.9 if turn == self.place else 0.3, (0.5, 0.2 * self.place))


def messages_per_cycle(quick: bool) -> list[Figure]:
    """Claims and commands in each cycle of a round, for each crowd."""
    rounds = 1 if quick else 3
    alone = _talk(1, rounds)
    return [
        figure(f"messages-per-cycle-{crowd}", "messages", _talk(crowd, rounds), alone)
        for crowd in CROWDS
    ]


def _talk(crowd: int, rounds: int) -> list[int]:
    """How many messages each cycle brought."""
    mesh = VirtualMesh(seed=crowd)
    counts: Counter[int] = Counter()
    mesh.watch(lambda _key, message, _now: counts.update([_number(message)]), Claim, Command)
    mesh.add(Robot(mesh.identity("robot")), admit=False)
    for index in range(crowd):
        _join(mesh, Wanderer, f"wanderer-{index}", index / crowd)
    cycles = range(SETTLE_CYCLES, SETTLE_CYCLES + rounds * ROUND_CYCLES)
    mesh.run((cycles.stop + 1) * PERIOD)
    return [counts[number] for number in cycles]


def _number(message: Message) -> int:
    assert isinstance(message, Claim | Command), "nothing else is watched"
    return message.cycle.number


def cycles_to_obeyed(quick: bool) -> list[Figure]:
    """Cycles from the one in which another bid is the best to its first obeyed command."""
    turns = 20 if quick else 100
    cycles = [number for seed in range(5) for number in _takeovers(seed, turns)]
    return [figure("cycles-to-obeyed", "cycles", cycles)]


def _takeovers(seed: int, turns: int) -> list[int]:
    mesh = VirtualMesh(seed)
    robot = Robot(mesh.identity("robot"))
    mesh.add(robot, admit=False)
    names = [f"turn-taker-{index}" for index in range(CROWDS[0])]
    for index, name in enumerate(names):
        _join(mesh, TurnTaker, name, index)
    mesh.run(((turns + 2) * TURN_CYCLES - 1) * PERIOD)
    obeyed = [(at, ballot.instance) for ballot, at in robot.first_obeyed.items()]
    cycles = []
    for turn in range(2, turns + 2):
        since, name = turn * TURN_CYCLES, names[turn % len(names)]
        first = next(at for at, who in obeyed if at >= since and who.startswith(name))
        cycles.append(first - since + 1)
    return cycles


def _join(mesh: VirtualMesh, kind: type[Agent], name: str, place: float) -> None:
    """A contender of its own class."""
    own = type(name.title(), (kind,), {"name": name, "place": place})
    mesh.add(own(mesh.identity(name)), admit=False)
