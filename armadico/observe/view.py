"""A society as it looks from outside (sans-IO): messages, tokens and cards in, and the time.

Whoever watches reads this one. Nobody on the mesh keeps a list: liveliness tokens tell who is
alive, cards what they are, an owner's acks who drives, a holder's claims what it wants, and the
bids that are asked for what the others would do. Times are s by the clock of whoever watches.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import degrees, inf
from statistics import mean, pstdev
from typing import Final, NamedTuple, TypeVar, cast

from armadico.core.cycles import PERIOD
from armadico.core.messages import (
    Ack,
    BidHistory,
    BidRecord,
    Card,
    Claim,
    Description,
    Log,
    Message,
    MonitorReport,
    RobotState,
    Stop,
)
from armadico.core.services import QUIET_S, Kind, service_at, service_of
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.errand import Errands, Progress
from armadico.mobile.messages import (
    BatteryLevel,
    ByHand,
    Correction,
    MissionStatus,
    Pose,
    Trajectory,
    Truth,
)

M = TypeVar("M", bound=Message)

FRESH_CYCLES: Final = 3
"""A command obeyed longer ago than so many cycles is nobody's any more."""

GONE: Final = 100
"""Instances that are gone and whose cards are still known, the last ones."""

RESTS: Final = 0.01
"""m/s and rad/s: a robot that is slower stands."""

LINES: Final = 200
"""Log lines that are still known, the last ones."""

EXCHANGES: Final = 100
"""Exchanges that are still known, the last ones."""

WINDOW_S: Final = 5.0
"""Rates are those of so long."""


def agent_of(instance: str) -> str:
    """The agent's name in an instance's id."""
    return instance.rpartition("-")[0] or instance


def driver(ack: Ack) -> str | None:
    """The instance that a resource obeys in an ack's cycle, by its owner's word; None: nobody."""
    at = ack.obeyed_cycle
    if ack.obeyed is None or at is None or at.epoch != ack.cycle.epoch:
        return None
    return ack.obeyed.instance if ack.cycle.number - at.number <= FRESH_CYCLES else None


def battery(state: RobotState, level: BatteryLevel | None) -> str:
    """The voltage, what is left if anybody says so, and whether it is charged, for people."""
    words = [f"{state.battery_v:.1f} V"]
    words += [] if level is None else [f"{100.0 * level.share:.0f} %"]
    return ", ".join([*words, *["charging"] * state.charging])


class Seen(NamedTuple):
    """An instance that is alive, and its card; None: not shown yet."""

    name: str
    instance: str
    card: Card | None


class Said(NamedTuple):
    """A log line: when it came (s), and which instance's it is."""

    at: float
    instance: str
    log: Log


class Exchanged(NamedTuple):
    """When a resource began to obey another instance than before (s), or nobody: None."""

    at: float
    resource: str
    before: str | None
    now: str | None
    claim: Claim | None  # of the one that it obeys now, as far as it was heard


_KEPT: Final = (
    *(RobotState, Pose, Description, Correction, ByHand),
    *(MissionStatus, BatteryLevel, Trajectory),
)
"""Of these a view keeps the newest one as it came."""


@dataclass
class _Contested:
    """What is known of one resource: its owner's newest ack, and the claim of the largest ballot.

    Times are s; `period` is the time from ack to ack.
    """

    ack: Ack | None = None
    acked_at: float = 0.0
    period: float = PERIOD
    driver: str | None = None  # as of that ack
    claim: Claim | None = None
    claimed_at: float = 0.0
    held_since: float = inf  # when this tenure was first claimed


class View:
    """What is known of one society; `take`, `learn` and `token` bring it up to date.

    Attributes:
        alive: The instances whose tokens are there, and since when.
        gone: Those whose tokens went, and when.
        cut_since: When the link to the robot's router was lost; None: the router can be reached.
        cards: By instance, of those that are gone too.
        bids: By instance and resource, the newest record of a bid, or of why there was none, and
            when it came; of the resources the one that was bid for last is the last.
        exchanges: The newest times that a resource obeyed another one than before, the last one
            last.
        rates: By key, how often something is published on it.
        newest: By key, the newest state that was published on it.
        answered: When an instance last did, asked for its card or bids.
        logs: The newest log lines, the last one last.
        reports: By monitor, what it last said.
        errands: By the message that tells of them, how they stand.
        truth: The newest of the robot's own simulator.
        rests_since: When the robot came to rest; None: it moves.
        lost_since: When its pose became one that nobody drives by; None: it is not.
        simulators: All that speak in the namespace, and when they last did.
    """

    def __init__(self) -> None:
        self.alive: dict[str, float] = {}
        self.gone: dict[str, float] = {}
        self.cut_since: float | None = None
        self.cards: dict[str, Card] = {}
        self.bids: dict[str, dict[str, tuple[BidRecord, float]]] = {}
        self.exchanges: deque[Exchanged] = deque(maxlen=EXCHANGES)
        self.rates: dict[str, Rate] = {}
        self.newest: dict[str, Message] = {}
        self.answered: dict[str, float] = {}
        self.logs: deque[Said] = deque(maxlen=LINES)
        self.reports: dict[str, MonitorReport] = {}
        self.errands: dict[type[Message], tuple[Progress, ...]] = {}
        self.truth: Truth | None = None
        self.rests_since: float | None = None
        self.lost_since: float | None = None
        self.simulators: dict[str, float] = {}
        self._latest: dict[type[Message], tuple[Message, float]] = {}  # with its time, s
        self._contested: dict[str, _Contested] = {}  # by resource

    @classmethod
    def of(cls, cards: Mapping[tuple[str, str], Card | None]) -> View:
        """Those that are alive, by (name, instance), with their cards; None: it shows none."""
        view = cls()
        for (_, instance), card in cards.items():
            view.token(instance, there=True, t=0.0)
            if card is not None:
                view.learn(card, 0.0)
        return view

    # What comes in -------------------------------------------------------------------------------

    def router(self, *, there: bool, t: float) -> None:
        """The robot's router can be reached, or cannot: then no token is reported as gone."""
        self.cut_since = None if there else t

    def token(self, instance: str, *, there: bool, t: float) -> bool:
        """A liveliness token came or went; False if that was known."""
        if (instance in self.alive) == there:
            return False
        if there:
            self.alive[instance] = t
            self.gone.pop(instance, None)
            return True
        del self.alive[instance]
        self.gone[instance] = t
        for known in (self.cards, self.bids, self.answered):
            for gone in [each for each in known if each not in self.alive][:-GONE]:
                del known[gone]
        for gone in list(self.gone)[:-GONE]:
            del self.gone[gone]
        return True

    def update(self, key: str, message: Message | None, t: float) -> None:
        """Something was published on a key, without the namespace; None: it cannot be read."""
        rate = self.rates.get(key)
        if rate is None:
            service = service_at(key)
            rate = self.rates[key] = Rate(None if service is None else service.deadline_s)
        rate.add(t)
        if message is None:
            return
        if hasattr(message, "cycle") and rate.deadline_s is not None:
            self.newest[key] = message
        if isinstance(message, Log):
            self.logs.append(Said(t, key.rpartition("/")[2], message))
        self.learn(message, t)

    def learn(self, message: Message, t: float) -> None:
        """Take a message, published or given in answer."""
        if isinstance(message, _KEPT):
            self._latest[type(message)] = message, t
        match message:
            case RobotState() | Pose() | Description():
                self._learn_of_robot(message, t)
            case Errands():
                self.errands[type(message)] = message.errands
            case Truth():
                self._take_truth(message, t)
            case _:
                self._learn_of_agents(message, t)

    def _learn_of_agents(self, message: Message, t: float) -> None:
        match message:
            case Ack():
                self._take_ack(message, t)
            case Claim():
                self._take_claim(message, t)
            case Card():
                self.cards[message.instance] = message
                self.answered[message.instance] = t
            case MonitorReport():
                self.reports[message.instance] = message
            case BidHistory():
                self.answered[message.instance] = t
                known = self.bids.setdefault(message.instance, {})
                for bid in message.bids:
                    known.pop(bid.resource, None)
                    known[bid.resource] = bid, t

    # The newest messages -------------------------------------------------------------------------

    @property
    def state(self) -> RobotState | None:
        """The robot agent's."""
        return self._newest_of(RobotState)

    @property
    def heard_at(self) -> float | None:
        """When that came, s."""
        return self._latest[RobotState][1] if RobotState in self._latest else None

    @property
    def pose(self) -> Pose | None:
        """Where the robot is by its own estimate."""
        return self._newest_of(Pose)

    @property
    def description(self) -> Description | None:
        """What the robot is."""
        return self._newest_of(Description)

    @property
    def mission(self) -> MissionStatus | None:
        """How the drive to the goal stands."""
        return self._newest_of(MissionStatus)

    @property
    def level(self) -> BatteryLevel | None:
        """The battery sensor agent's."""
        return self._newest_of(BatteryLevel)

    @property
    def trajectory(self) -> Trajectory | None:
        """The path that is driven."""
        return self._newest_of(Trajectory)

    @property
    def acks(self) -> dict[str, Ack]:
        """By resource, its owner's."""
        return {name: each.ack for name, each in self._contested.items() if each.ack is not None}

    # How things stand ----------------------------------------------------------------------------

    @property
    def tasks(self) -> str:
        """The mission of several tasks that is done now, and how far it is; empty: none is."""
        active = next((each for each in self.missions if each.active), None)
        return "" if active is None else f"{active.name}: {active.summary}"

    @property
    def missions(self) -> list[Progress]:
        """The missions of several tasks that are known."""
        known = (each for of_kind in self.errands.values() for each in of_kind)
        return [each for each in known if each.steps is not None]

    @property
    def names(self) -> set[str]:
        """The agents that are alive."""
        return {agent_of(instance) for instance in self.alive}

    @property
    def agents(self) -> list[Seen]:
        """The instances that are alive, by name."""
        return sorted(Seen(agent_of(each), each, self.cards.get(each)) for each in self.alive)

    @property
    def complete(self) -> bool:
        """Whether somebody is alive, and everybody has shown a card."""
        return bool(self.alive) and self.alive.keys() <= self.cards.keys()

    @property
    def claimed(self) -> list[str]:
        """The resources that are claimed or owned, as far as was received."""
        return sorted(self._contested)

    @property
    def resources(self) -> list[str]:
        """Those, and what an agent's card offers or competes for."""
        offered = {name for card in self.cards.values() for name in (*card.resources, *card.owns)}
        return sorted(offered.union(self.claimed))

    @property
    def doubled(self) -> dict[str, list[str]]:
        """The states that several instances offer to publish: who receives both is misled."""
        by_key: dict[str, list[str]] = {}
        for _, instance, card in self.agents:
            for key in card.provides if card else ():
                service = service_at(key)
                if service is not None and service.kind is Kind.STATE:
                    by_key.setdefault(key, []).append(instance)
        return {key: whose for key, whose in by_key.items() if len(whose) > 1}

    @property
    def controller(self) -> str:
        """The robot's controller, as it names itself; empty if that is not known."""
        return "" if self.description is None else self.description.controller

    def _own(self, simulator: str) -> bool:
        """Whether a simulator is the robot's. One without a name is nobody's."""
        return simulator == self.controller != ""

    def strangers(self, now: float) -> list[str]:
        """Simulators that speak in the namespace, and none of which is the robot's.

        Where no robot is described, several of them are strangers to one another.
        """
        spoken = [each for each, at in self.simulators.items() if now - at <= WINDOW_S]
        others = sorted(each for each in spoken if not self._own(each))
        return others if self.description is not None or len(others) > 1 else []

    @property
    def stop(self) -> Stop:
        """The stop as the robot agent last had it; whether it still has it, `stopped` tells."""
        return Stop() if self.state is None else self.state.stop

    @property
    def battery(self) -> str:
        """The robot's, for people; empty: nobody says."""
        return "" if self.state is None else battery(self.state, self.level)

    def confidence(self, now: float) -> float | None:
        """How sure it is of the pose by the map, 0 to 1; None: nobody says so now."""
        said = self._of_late(Correction, now)
        return None if said is None else said.confidence

    def whereabouts(self, now: float) -> str:
        """How well the pose is known, for people; empty: nobody says."""
        pose = self.pose
        if pose is None or not pose.covariance:
            return ""
        off = f"+-{pose.deviation:.2f} m"
        if self.lost_since is not None:
            return f"LOST for {max(0.0, now - self.lost_since):.0f} s, {off}"
        sure = self.confidence(now)
        words = [off, f"+-{degrees(pose.heading_deviation):.0f} deg"]
        return ", ".join([*words, *([] if sure is None else [f"confidence {sure:.2f}"])])

    def contenders(self, resource: str) -> list[str]:
        """The agents that are alive and compete for a resource, by name."""
        return [a.name for a in self.agents if a.card and resource in a.card.resources]

    def bid(self, instance: str, resource: str = "") -> BidRecord | None:
        """An instance's newest bid for one resource, or any; or its reason for none; if asked."""
        known = self.bids.get(instance, {})
        found = known.get(resource) if resource else next(reversed(known.values()), None)
        return None if found is None else found[0]

    def hears_robot(self, now: float) -> bool:
        """Whether the robot agent's newest state tells of now."""
        return self.heard_at is not None and now - self.heard_at <= service_of(RobotState).tells_s

    def stopped(self, now: float) -> bool | None:
        """Whether the stop is latched, by the robot agent's own word; None: it says nothing now."""
        return self.stop.stopped if self.hears_robot(now) else None

    def hand(self, now: float) -> ByHand | None:
        """The state of an agent by which a person drives; None: none tells of now."""
        kinds = [kind for kind in self._latest if issubclass(kind, ByHand)]
        return next((found for kind in kinds if (found := self._of_late(kind, now))), None)

    def driver(self, resource: str, now: float) -> str | None:
        """The instance that a resource obeys now, as far as its owner's acks tell; None: nobody.

        An owner that is silent obeys no command: what it drove it stops.
        """
        known = self._contested.get(resource)
        if known is None or known.ack is None or now - known.acked_at > _quiet_s(known):
            return None
        return driver(known.ack)

    def last_driver(self, resource: str) -> str:
        """The instance that a resource obeys, or obeyed last; empty: nobody since a release."""
        known = self._contested.get(resource)
        obeyed = None if known is None or known.ack is None else known.ack.obeyed
        return "" if obeyed is None else obeyed.instance

    def claim(self, resource: str, now: float) -> Claim | None:
        """The claim that stands: of the largest ballot, until it is silent or released."""
        known = self._contested.get(resource)
        if known is None or known.claim is None or known.claim.utility is None:
            return None
        return known.claim if now - known.claimed_at <= _quiet_s(known) else None

    def held_since(self, resource: str) -> float:
        """When the newest tenure was first claimed, s; infinite if nobody has claimed it."""
        known = self._contested.get(resource)
        return inf if known is None else known.held_since

    # Inside --------------------------------------------------------------------------------------

    def _newest_of(self, kind: type[M]) -> M | None:
        return cast("M | None", self._latest.get(kind, (None, 0.0))[0])

    def _of_late(self, kind: type[M], now: float) -> M | None:
        """The same, unless it is too old to tell of now."""
        at = self._latest.get(kind, (None, 0.0))[1]
        return self._newest_of(kind) if now - at <= service_of(kind).tells_s else None

    def _learn_of_robot(self, said: RobotState | Pose | Description, t: float) -> None:
        """Since when it rests, since when it is lost, and whose the truth is."""
        match said:
            case RobotState():
                rests = max(abs(said.v), abs(said.w)) <= RESTS
                self.rests_since = _since(self.rests_since, t) if rests else None
            case Pose():
                lost = said.deviation > LOST_M
                self.lost_since = _since(self.lost_since, t) if lost else None
            case Description() if self.truth is not None and not self._own(self.truth.simulator):
                self.truth = None

    def _take_truth(self, truth: Truth, t: float) -> None:
        self.simulators[truth.simulator] = t
        if self._own(truth.simulator):
            self.truth = truth

    def _take_ack(self, ack: Ack, t: float) -> None:
        known = self._contested.setdefault(ack.resource, _Contested())
        before, period = known.ack, PERIOD
        if before is not None and before.cycle.epoch == ack.cycle.epoch:
            period, cycles = known.period, ack.cycle.number - before.cycle.number
            if cycles > 0:
                period = (t - known.acked_at) / cycles
        known.ack, known.acked_at, known.period = ack, t, period
        now, last = driver(ack), known.driver
        if now != last:
            known.driver = now
            claim = self.claim(ack.resource, t)
            ours = claim if claim is not None and claim.ballot.instance == now else None
            self.exchanges.append(Exchanged(t, ack.resource, last, now, ours))

    def _take_claim(self, claim: Claim, t: float) -> None:
        known = self._contested.setdefault(claim.resource, _Contested())
        before = known.claim
        silent = t - known.claimed_at > _quiet_s(known)
        if before is None or silent or claim.ballot >= before.ballot:
            if before is None or claim.ballot != before.ballot:
                known.held_since = t
            known.claim, known.claimed_at = claim, t


def _quiet_s(known: _Contested) -> float:
    """A resource whose cycles are long is spoken of seldom."""
    return max(QUIET_S, FRESH_CYCLES * known.period)


def _since(known: float | None, t: float) -> float:
    return t if known is None else known


# How often ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Spread:
    """How far apart messages came, s."""

    least: float
    most: float
    mean: float
    deviation: float


class Rate:
    """How often something comes, over the last `WINDOW_S`. Times are s."""

    def __init__(self, deadline_s: float | None = None) -> None:
        """Count; a gap longer than the deadline is a missed one."""
        self.count = 0
        self.missed = 0
        self.last: float | None = None
        self.since = 0.0  # when it came after the last silence, or first
        self.deadline_s = deadline_s
        self._late = False  # the gap that is still open has been counted
        self._arrivals: deque[float] = deque()

    def add(self, at: float) -> None:
        self.expire(at)
        self.count += 1
        if self.last is None or at - self.last > max(self.deadline_s or 0.0, QUIET_S):
            self.since = at
        self.last, self._late = at, False
        self._arrivals.append(at)

    def expire(self, now: float) -> None:
        """Forget what is past, and notice a deadline that has been missed."""
        while self._arrivals and now - self._arrivals[0] > WINDOW_S:
            self._arrivals.popleft()
        if self.deadline_s is None or self.last is None or self._late:
            return
        if now - self.last > self.deadline_s:
            self._late = True
            self.missed += 1

    def hz(self, now: float) -> float | None:
        """Messages a second; None before there are two. Silence counts as soon as it is long."""
        self.expire(now)
        if len(self._arrivals) < 2:
            return None if self.count < 2 else 0.0
        gaps = len(self._arrivals) - 1
        span = self._arrivals[-1] - self._arrivals[0]
        silence = now - self._arrivals[-1]
        if silence > 2 * span / gaps:
            span += silence
        return gaps / max(span, 1e-9)

    def spread(self) -> Spread | None:
        """The gaps in the window; None before there is one."""
        gaps = [b - a for a, b in pairwise(self._arrivals)]
        return Spread(min(gaps), max(gaps), mean(gaps), pstdev(gaps)) if gaps else None
