"""First come, first served: requests for the planner, and robots before a passage.

A passage is a resource between robots, as a task is (`tasks.py`). A robot enters by the permission
of one arbiter, a process of its own in any robot's society.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from msgspec import Meta

from armadico.agents.rivals import tasks
from armadico.agents.rivals.arbiter import Arbiter, Decision, Wish
from armadico.agents.rivals.proposer import Arbitrated
from armadico.agents.rivals.tasks import COUNTS, Bids, Contractor, FleetArbiter, Negotiated
from armadico.core import parameters
from armadico.core.agent import Identity
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.messages import Award, Cycle, Message
from armadico.core.resources import Resource
from armadico.mobile.messages import FleetAwards, FleetProposals
from armadico.mobile.resources import PLANNER

# The planner --------------------------------------------------------------------------------------


class QueueParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of the planner's queue."""

    fails_s: Annotated[float, Meta(gt=0, le=600)] = 5.0  # then a request goes to the queue's end


class Queue(Arbiter):
    """Serves requests for the planner in the order in which they came, whatever their utility.

    So does a service of ROS, such as the planner of `move_base` (`make_plan`). A request is over
    when its agent no longer makes it: the plan has come, or the agent has ended.
    """

    name = "queue"
    competes_for = (PLANNER,)
    critical_for = (PLANNER,)
    parameters = QueueParameters
    p: QueueParameters

    def __init__(self, identity: Identity, parameters: QueueParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._came: dict[int, float] = {}  # by the request's number
        self._turn = (0, 0.0)  # whose it is, and since when

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        numbers = {name: wish.action.id for name, wish in wishes.items()}
        self._came = {each: self._came.get(each, self.now) for each in numbers.values()}
        number, since = self._turn
        if number in self._came and self.now - since > self.p.fails_s:
            self._came[number] = self.now
        first = min(numbers, key=lambda name: (self._came[numbers[name]], name))
        if numbers[first] != number:
            self._turn = numbers[first], self.now
        return Decision(wishes[first].action, {first: 1.0})


QUEUE: Final = Arbitrated(
    Queue.name,
    resource=PLANNER,
    about="the planner: requests are served in the order in which they came",
)


# Passages between robots --------------------------------------------------------------------------

PASSAGE: Final = "passage-"  # the prefix of passages' names

PERIOD_S: Final = 0.5  # a cycle of passages, as the giveway agent has it


class Claimer(Contractor):
    """Enters by a fresh award only, and keeps the passage while it is inside.

    So a robot that hears no arbiter does not enter, and the arbiter may give away the passage of a
    robot that it has not heard for long and that was not inside.
    """

    def __init__(self, resource: Resource, instance: str, clock: CycleClock) -> None:
        super().__init__(resource, instance, clock, asks=False)
        self._inside = False
        self._bid_in: Cycle | None = None
        self._awarded_in: Cycle | None = None

    def bid(
        self, cycle: Cycle, bid: Bid | None, now: float, inputs: Cycle | None = None
    ) -> list[Message]:
        self._inside = bid is not None and bid.packed == self.resource.neutral
        if not self.share:
            self._mine = False  # the award has expired, and the arbiter is told so
        self._bid_in = cycle
        said = super().bid(cycle, bid, now, inputs)
        return [] if bid is None else said  # a map may have many passages

    def on_message(self, message: Message, now: float) -> list[Message]:
        assert isinstance(message, Award), "it receives nothing else"
        if self._bid_in is None or message.cycle < self._bid_in:
            return []  # by now the arbiter may know that the robot does not have it
        self._awarded_in = message.cycle
        return super().on_message(message, now)

    @property
    def share(self) -> float:
        at = self._awarded_in
        return float(self._mine and (self._inside or (at is not None and self._clock.fresh(at))))


class MutexParameters(tasks.Parameters, frozen=True, kw_only=True):
    """Parameters of an arbiter of passages."""

    silent_s: Annotated[float, Meta(ge=3, le=3600)] = 10.0  # a robot silent for longer has none


class Mutex(FleetArbiter):
    """Gives a passage to the robot that asked for it first, until that gives it back.

    So do the mutex groups of Open-RMF (`mutex_group_supervisor` of rmf_fleet_adapter): claims in
    the order of their times, and one that has not been renewed for 10 s is dropped. A robot that is
    inside goes first. A robot that has not been heard keeps what it had for `silent_s`. An arbiter
    that begins awards nothing for 3 s: by then it knows what the robots hold.
    """

    name = "mutex"
    awards = PASSAGE
    late = 0  # a robot ignores an award of a cycle before its bid, so another one would only wait
    parameters = MutexParameters
    p: MutexParameters

    def __init__(self, identity: Identity, parameters: MutexParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.keeps = round(self.p.silent_s / PERIOD_S)
        self._asked: dict[tuple[str, str], float] = {}  # by passage and robot, since when
        self._given: dict[str, tuple[str, Cycle]] = {}  # by passage: instance, when awarded last
        self._cycle_at = 0.0  # when the newest cycle began here

    def on_start(self) -> None:
        self.listen()

    def on_fleet_proposals(self, message: FleetProposals) -> None:
        """Ignore other maps and what was overtaken; forget all if no cycle has begun for long."""
        if self.now - self._cycle_at > self.p.silent_s:
            self.listen()
        before, known = self._round.cycle, self._round.since(self.keeps).get(message.robot)
        if before is not None and message.cycle.epoch != before.epoch:
            return
        if known and message.instance == known.instance and message.cycle < known.cycle:
            return
        asks = {each.resource for each in message.proposals if each.utility is not None}
        for passage, robot in [*self._asked]:
            if robot == message.robot and (known is None or passage not in asks):
                del self._asked[passage, robot]
        for passage in asks:
            self._asked.setdefault((passage, message.robot), self.now)
        super().on_fleet_proposals(message)
        if self._round.cycle != before:
            self._cycle_at = self.now

    def on_fleet_awards(self, message: FleetAwards) -> None:
        """Note what another arbiter awards, to go on from there."""
        super().on_fleet_awards(message)
        cycle = self._round.cycle
        if cycle is not None and message.cycle.epoch != cycle.epoch:
            return
        self._given |= {
            each.resource: (each.agents[0], message.cycle)
            for each in message.awards
            if each.agents and each.resource.startswith(PASSAGE)
        }

    def award(self, bids: Bids, holds: Mapping[str, str]) -> Mapping[str, str]:
        heard, recent = self._round.since(self.keeps), self._round.since(COUNTS)
        cycle, robots = self._round.cycle, {each.instance: name for name, each in heard.items()}
        assert cycle is not None, "of a cycle"
        # An award that its robot has not answered yet may have arrived.
        found = {
            passage: robots[to]
            for passage, (to, at) in self._given.items()
            if to in robots and heard[robots[to]].cycle <= at
        } | dict(holds)
        for passage, by in bids.items():
            if passage not in found and by:
                inside = {robot for robot in by if by[robot].action == (0.0,)}
                found[passage] = min(inside or by, key=lambda robot: self.rank(passage, robot))
        # Those not heard lately keep it without a renewal: their award expires before another's.
        renewed = {passage: robot for passage, robot in found.items() if robot in recent}
        self._given |= {p: (heard[robot].instance, cycle) for p, robot in renewed.items()}
        return renewed

    def rank(self, passage: str, robot: str) -> tuple[float, str]:
        """Return the place of a robot among those that wait: the smallest goes first."""
        return self._asked[passage, robot], robot

    def listen(self) -> None:
        super().listen()
        self._cycle_at, self._given = self.now, {}


class RightOfWay(Mutex):
    """Gives a passage to the robot of the smallest name among those that wait.

    A fixed priority of robots (M. Erdmann and T. Lozano-Perez, "On multiple moving objects",
    Algorithmica 1987). It takes no passage away from a robot.
    """

    name = "right-of-way"

    def rank(self, passage: str, robot: str) -> tuple[float, str]:  # noqa: ARG002
        return 0.0, robot


NARROW: Final = (
    "robots share passages in a fleet, where the map has some: armadico run FILE --robots 3; the"
    " hall of the scenario fleet has none"
)

MUTEX: Final = Negotiated(
    Mutex.name,
    "passages between robots: the robot that asked first, as Open-RMF's mutex groups",
    Claimer,
    PASSAGE,
    NARROW,
)
RIGHT_OF_WAY: Final = Negotiated(
    RightOfWay.name,
    "passages between robots: a fixed priority of robots, by their names",
    Claimer,
    PASSAGE,
    NARROW,
)
