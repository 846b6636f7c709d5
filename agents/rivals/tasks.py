"""Mechanisms for tasks between robots, each with the feature that its authors rely on.

A task is a resource between robots, as by ballots. Under `contract-net` and `central` each robot
proposes, and an arbiter of tasks, a process of its own in any robot's society, awards. Under
`alliance` no robot negotiates: each only publishes what it does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Final
from weakref import WeakKeyDictionary, WeakSet

from msgspec import Meta

from armadico.agents.rivals.proposer import Proposer
from armadico.agents.rivals.rounds import Round
from armadico.core import messages as m
from armadico.core import parameters
from armadico.core.agent import Agent, Identity
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.individual import Individual
from armadico.core.mechanisms import Mechanism
from armadico.core.messages import Award, Claim, Cycle, Message, Proposal
from armadico.core.resources import Resource
from armadico.mobile.messages import FleetAwards, FleetProposals

TASK: Final = "task-"  # the prefix of tasks' names

WHERE: Final = "robots share tasks in a fleet, as in armadico run fleet --robots 3"

WAIT_S: Final = 0.3  # longest wait for the proposals of a cycle, s

SILENT_S: Final = 3.0  # the timeout of a robot, and of an arbiter, three of the fleet's cycles

COUNTS: Final = 2
"""A robot whose newest proposals are older than this, in the fleet's cycles, holds no task any more
and gets none: it has been silent for `SILENT_S`."""

Bids = Mapping[str, Mapping[str, Proposal]]
"""By task and robot, the proposals of a cycle that have a utility."""


# A robot's side under an arbiter ------------------------------------------------------------------


class Contractor(Proposer):
    """Holds what it was awarded, also while the arbiter is silent, until it is done or revoked."""

    def __init__(self, resource: Resource, instance: str, clock: CycleClock, *, asks: bool) -> None:
        """`asks`: it bids only for what has been announced, by an award to no robot."""
        super().__init__(resource, instance, clock, "award")
        self._asks = asks
        self._mine = False
        self._announced: Cycle | None = None
        self._heeded: tuple[Cycle, str] | None = None  # the newest award's cycle, and its arbiter

    def bid(
        self, cycle: Cycle, bid: Bid | None, now: float, inputs: Cycle | None = None
    ) -> list[Message]:
        if bid is None:
            self._mine = False  # it gives the task back
        elif self._asks and not self._mine and not self._open:
            bid = None
        return super().bid(cycle, bid, now, inputs)

    def on_message(self, message: Message, now: float) -> list[Message]:  # noqa: ARG002
        assert isinstance(message, Award), "it receives nothing else"
        # Two arbiters may award in one cycle, as after a common start. All robots heed the same one
        # then, in whatever order the awards arrive; otherwise two could have the resource.
        by, heeded = message.instance, self._heeded
        if heeded is not None and message.cycle == heeded[0] and by > heeded[1]:
            return []
        self._heeded = message.cycle, by
        self._mine = self.instance in message.agents
        self._announced = None if message.agents else message.cycle
        return []

    @property
    def _open(self) -> bool:
        """Whether the task has been announced lately."""
        return self._announced is not None and self._clock.fresh(self._announced)

    @property
    def share(self) -> float:
        return float(self._mine)

    @property
    def speaker(self) -> str:
        return self.instance if self._mine else ""


# The arbiters -------------------------------------------------------------------------------------


class Parameters(parameters.Parameters, frozen=True, kw_only=True):
    """The robot in whose society the arbiter runs."""

    namespace: Annotated[str, Meta(min_length=1)] = "robot1"


class FleetArbiter(Agent, hooks=("award", "keeps", "listen")):
    """Awards resources between robots once per cycle, when all proposals are in or after 0.3 s.

    Of several only the one of the smallest name awards; the others stand by. It knows what the
    robots hold from their proposals, so one that takes over, or restarts, goes on.

    `awards` is how the names of its resources begin. `keeps`: a robot whose newest proposals are
    older than this, in cycles, holds nothing any more. `late`: bids of so many cycles before count.
    """

    awards: ClassVar[str] = TASK
    keeps: int = COUNTS
    late: ClassVar[int] = 1  # or a robot far away, whose bids come after `WAIT_S`, gets nothing

    receives: ClassVar[tuple[type[Message], ...]] = (FleetProposals, FleetAwards)
    provides: ClassVar[tuple[type[Message], ...]] = (FleetAwards,)
    parameters = Parameters
    launched_with = ("namespace",)
    p: Parameters

    def __init__(self, identity: Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.robot = self.p.namespace.rpartition("/")[2]
        self.key_names = {"robot": self.robot}
        self._round = Round[FleetProposals]()  # by robot
        self._decided: Cycle | None = None
        self._senior_at = float("-inf")  # when another arbiter that goes first awarded

    def award(self, bids: Bids, holds: Mapping[str, str]) -> Mapping[str, str]:
        """Return robots by resource; `holds` is which robot holds which. Some may be missing."""
        raise NotImplementedError("award(self, bids, holds) returns robots by task")

    def listen(self) -> None:
        """Forget what the robots hold, and stand by for as long as after another's awards."""
        self._round = Round[FleetProposals]()
        self._senior_at = self.now

    def on_fleet_awards(self, message: FleetAwards) -> None:
        """Stand by while an arbiter awards that goes first."""
        cycle = self._round.cycle
        if cycle is not None and message.cycle.epoch != cycle.epoch:
            return  # of other resources
        if (message.robot, message.instance) < (self.robot, self.instance):
            self._senior_at = self.now

    def on_fleet_proposals(self, message: FleetProposals) -> None:
        """Decide if the last robot's proposals of a cycle have come; else wait."""
        known = self._round.cycle is not None and self._round.cycle.epoch == message.cycle.epoch
        named = any(each.resource.startswith(self.awards) for each in message.proposals)
        if not known and not named:
            return  # of other resources
        if self._round.add(message.robot, message.cycle, message):
            self.wake_at(self.now + WAIT_S)
        if self._round.complete:
            self._decide()

    def on_wakeup(self) -> None:
        self._decide()

    def _decide(self) -> None:
        cycle, live = self._round.cycle, [*self._round.since(self.keeps).values()]
        if cycle is None or cycle == self._decided or self.now - self._senior_at < SILENT_S:
            return
        self._round.decided()
        self._decided = cycle
        holds = {task: each.robot for each in live for task in each.holds}
        bids: dict[str, dict[str, Proposal]] = {}
        for each in live:
            for proposal in each.proposals:
                bidders = bids.setdefault(proposal.resource, {})
                if proposal.utility is not None and cycle.number - each.cycle.number <= self.late:
                    bidders[each.robot] = proposal
        awarded = self.award(bids, holds)
        instances = {each.robot: each.instance for each in live}
        awards = tuple(
            Award(task, cycle, self.instance, *(((instances[to],), (1.0,)) if to else ((), ())))
            for task in sorted(bids)
            if (to := awarded.get(task, "")) or task not in holds
        )
        self.publish(FleetAwards(self.robot, self.instance, cycle, awards))


class ContractNet(FleetArbiter):
    """The manager announces tasks, robots bid for those, and the best bidder gets the contract.

    R. G. Smith, "The contract net protocol" (IEEE Trans. Computers, 1980): announcement, bid,
    award. A contract stays until it is done, given back, or its contractor is silent; it is not
    revised. A robot gets one contract per round, since its next bid depends on it.
    """

    name = "contract-net"

    def award(self, bids: Bids, holds: Mapping[str, str]) -> Mapping[str, str]:
        found: dict[str, str] = {}
        ranked = sorted(
            (-(proposal.utility or 0.0), task, robot)
            for task, by in bids.items()
            if task not in holds
            for robot, proposal in by.items()
        )
        for _, task, robot in ranked:
            if task not in found and robot not in found.values():
                found[task] = robot
        return found


class CentralParameters(Parameters, frozen=True, kw_only=True):
    """Parameters of the central allocator."""

    keeps_s: Annotated[float, Meta(ge=0, le=600)] = 5.0  # that an exchange of tasks must save


class Central(FleetArbiter):
    """One allocator gives each robot one task, in each cycle anew, at the least sum of arrivals.

    Iterated assignment, as B. P. Gerkey and M. J. Mataric name it ("A formal analysis and taxonomy
    of task allocation in multi-robot systems", IJRR 2004). Greedy, then exchanges of two robots'
    tasks, and with a free one, until none is better: no library for the exact optimum is installed.
    """

    name = "central"
    parameters = CentralParameters
    p: CentralParameters

    def award(self, bids: Bids, holds: Mapping[str, str]) -> Mapping[str, str]:
        costs = {
            (robot, task): _arrival_s(proposal) - self.p.keeps_s * (holds.get(task) == robot)
            for task, by in bids.items()
            for robot, proposal in by.items()
        }
        return {task: robot for robot, task in assigned(costs).items()} | dict.fromkeys(
            (task for task in holds if task not in bids), ""
        )


def assigned(costs: Mapping[tuple[str, str], float]) -> dict[str, str]:
    """Return a task for each robot: as many as can be, at a low sum of costs.

    `costs` are by robot and task. The cheapest pairs first, then exchanges while one lowers the
    sum: of two robots' tasks, or of a robot's task with a free one.
    """
    found: dict[str, str] = {}
    for _, (robot, task) in sorted((cost, pair) for pair, cost in costs.items()):
        if robot not in found and task not in found.values():
            found[robot] = task
    tasks = sorted({task for _, task in costs})
    none = float("inf")
    better = True
    while better:
        better = False
        for robot in sorted(found):
            for task in tasks:
                other = next((r for r, t in found.items() if t == task), "")
                mine = found[robot]
                if task == mine:
                    continue
                before = costs[robot, mine]
                after = costs.get((robot, task), none)
                if other:
                    before += costs[other, task]
                    after += costs.get((other, mine), none)
                if after < before - 1e-9:
                    found[robot] = task
                    if other:
                        found[other] = mine
                    better = True
    return found


def _arrival_s(proposal: Proposal) -> float:
    action = proposal.action
    assert not isinstance(action, bytes), "a task's action has numbers"
    return action[0]


# Motivation ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drives:
    """The parameters of motivation, s; impatience reaches the threshold 1 after these times."""

    fast: float = 0.2  # times the time of arrival, where no robot does the task
    slow_s: float = 120.0  # while another robot does it
    allowed_s: float = 60.0  # for which another robot may do it; then impatience is fast
    yields_s: float = 60.0  # after which a robot leaves a task that another one does, too
    gives_up_s: float = 120.0  # after which it leaves a task in any case
    silent_s: float = SILENT_S  # of a robot, from when on it counts as not doing it


class Motivated:
    """A robot's motivation to do one task: impatience and acquiescence, without negotiation.

    L. E. Parker, "ALLIANCE: an architecture for fault tolerant multirobot cooperation" (IEEE
    Trans. Robotics and Automation, 1998). The motivation grows by the impatience while the task is
    open, no other task of the robot is active, and the robot acquiesces not. It begins anew once
    when another robot takes on the task. From 1 on the robot does the task, and publishes it.
    """

    receives: Final[tuple[type[Message], ...]] = ()
    holding: Final = False
    wakeup: Final[float | None] = None

    def __init__(
        self, resource: Resource, instance: str, drives: Drives, active: WeakSet[Motivated]
    ) -> None:
        """`active` has the robot's active tasks, shared by all its tasks."""
        self.resource, self.instance = resource, instance
        self.ack: m.Ack | None = None
        self.motivation = 0.0
        self._drives, self._all = drives, active
        self._others: dict[str, tuple[float, float]] = {}  # by instance, since when; last heard
        self._known: set[str] = set()  # those that have reset the impatience
        self._since = self._at = 0.0  # active since; last bid

    def bid(
        self,
        cycle: Cycle,
        bid: Bid | None,
        now: float,
        inputs: Cycle | None = None,  # noqa: ARG002
    ) -> list[Message]:
        passed, self._at = now - self._at, now
        active = self in self._all
        if bid is None or (active and self._acquiesces(now)):
            self._all.discard(self)
            self.motivation = 0.0
            return [Claim(self.resource.name, self._ballot, cycle, None)] if active else []
        if not active:
            self._grow(bid, passed, now)
            if self.motivation < 1.0:
                return []
            self._all.add(self)
            self._since = now
        action = bid.packed
        return [Claim(self.resource.name, self._ballot, cycle, bid.utility, False, action, action)]

    def on_claim(self, claim: Claim, now: float) -> list[Message]:
        other = claim.ballot.instance
        if claim.utility is None:
            self._others.pop(other, None)
            return []
        since, _ = self._others.get(other, (now, now))
        self._others[other] = since, now
        if other not in self._known and self not in self._all:
            self._known.add(other)
            self.motivation = 0.0
        return []

    def _grow(self, bid: Bid, passed: float, now: float) -> None:
        if self._all:  # activity suppression: another of its tasks is active
            self.motivation = 0.0
            return
        drives, doing = self._drives, self._doing(now)
        there_s = bid.packed[0]
        assert isinstance(there_s, float), "a task's action has numbers"
        waits = any(now - since < drives.allowed_s for since in doing)
        until_s = drives.slow_s if waits else max(drives.fast * there_s, 1e-3)
        self.motivation += min(passed, 2.0 * (self.resource.period_s or 1.0)) / until_s

    def _acquiesces(self, now: float) -> bool:
        active_s = now - self._since
        other = bool(self._doing(now)) and active_s > self._drives.yields_s
        return other or active_s > self._drives.gives_up_s

    def _doing(self, now: float) -> list[float]:
        """Since when other robots do the task."""
        since = now - self._drives.silent_s
        return [begun for begun, last in self._others.values() if last >= since]

    @property
    def _ballot(self) -> m.Ballot:
        return m.Ballot(1, 0.0, False, self.instance)

    def on_message(self, message: Message, now: float) -> list[Message]:  # noqa: ARG002
        return []

    def acked(self, ack: m.Ack, now: float) -> list[Message]:  # noqa: ARG002
        self.ack = ack
        return []

    def gone(self, instance: str, now: float) -> list[Message]:  # noqa: ARG002
        self._others.pop(instance, None)
        return []

    def returned(self, now: float) -> None:
        """Nothing is kept by cycles."""

    def tick(self, now: float) -> list[Message]:  # noqa: ARG002
        return []

    @property
    def owned(self) -> bool:
        return True

    @property
    def share(self) -> float:
        return float(self in self._all)

    @property
    def speaker(self) -> str:
        return self.instance if self in self._all else ""


# As entry points name them ------------------------------------------------------------------------


@dataclass(frozen=True)
class Negotiated:
    """A coordination of resources between robots by one arbiter."""

    arbiter: str
    about: str  # what decides, for people
    side: Callable[[Resource, str, CycleClock], Mechanism]  # a robot's, of an instance
    resource: str = TASK
    where: str = WHERE  # something competes for them

    def contender(
        self, resource: Resource, agent: Individual, clock: CycleClock
    ) -> Mechanism | None:
        """Return a robot's side of a resource; None for other resources."""
        if not resource.name.startswith(self.resource):
            return None
        return self.side(resource, agent.instance, clock)


class ByMotivation:
    """The coordination of tasks between robots by motivation, without an arbiter."""

    arbiter: Final = ""
    about: Final = "tasks between robots: impatience and acquiescence, and no negotiation"
    resource: Final = TASK
    where: Final = WHERE

    def __init__(self, drives: Drives) -> None:
        self._drives = drives
        self._active: WeakKeyDictionary[Any, WeakSet[Motivated]] = WeakKeyDictionary()

    def contender(
        self,
        resource: Resource,
        agent: Individual,
        clock: CycleClock,
    ) -> Mechanism | None:
        """Return the motivation for a task; None for other resources."""
        if not resource.name.startswith(TASK):
            return None
        # One set for the tasks of a list, which have one clock.
        active = self._active.setdefault(clock, WeakSet())
        return Motivated(resource, agent.instance, self._drives, active)


CONTRACT_NET: Final = Negotiated(
    ContractNet.name,
    "tasks between robots: a manager announces, robots bid, the best gets the contract",
    partial(Contractor, asks=True),
)
CENTRAL: Final = Negotiated(
    Central.name,
    "tasks between robots: one allocator gives each robot one task, in each cycle anew",
    partial(Contractor, asks=False),
)
ALLIANCE: Final = ByMotivation(Drives())
