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
from math import degrees
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


_NEWEST: Final[dict[type[Message], str]] = {
    MissionStatus: "mission",
    BatteryLevel: "level",
    Trajectory: "trajectory",
}
"""What is known of a society just as it was last said."""


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
        heard_at: When the robot agent's newest state came; None: none has.
        acks: By resource, its owner's newest word.
        rates: By key, how often something is published on it.
        newest: By key, the newest state that was published on it.
        answered: When an instance last did, asked for its card or bids.
        logs: The newest log lines, the last one last.
        reports: By monitor, what it last said.
        level: What the battery sensor agent last said.
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
        self.acks: dict[str, Ack] = {}
        self.rates: dict[str, Rate] = {}
        self.newest: dict[str, Message] = {}
        self.answered: dict[str, float] = {}
        self.logs: deque[Said] = deque(maxlen=LINES)
        self.reports: dict[str, MonitorReport] = {}
        self.state: RobotState | None = None
        self.pose: Pose | None = None
        self.lost_since: float | None = None
        self.truth: Truth | None = None
        self.simulators: dict[str, float] = {}
        self.description: Description | None = None
        self.mission: MissionStatus | None = None
        self.errands: dict[type[Message], tuple[Progress, ...]] = {}
        self.level: BatteryLevel | None = None
        self.trajectory: Trajectory | None = None
        self.heard_at: float | None = None
        self._drivers: dict[str, str | None] = {}  # by resource, as of its newest ack
        self._lately: dict[type[Message], tuple[Message, float]] = {}
        self._claims: dict[str, tuple[Claim, float, float]] = {}  # when, and its tenure's first
        self.rests_since: float | None = None
        self._acked: dict[str, tuple[float, float]] = {}  # when, and from ack to ack, s

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

    def take(self, key: str, message: Message | None, t: float) -> None:
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
        match message:
            case MissionStatus() | BatteryLevel() | Trajectory():
                setattr(self, _NEWEST[type(message)], message)
            case RobotState() | Pose():
                self._take_place(message, t)
            case Correction() | ByHand():
                self._lately[type(message)] = message, t
            case Errands():
                self.errands[type(message)] = message.errands
            case Description():
                self.description = message
                if self.truth is not None and not self._own(self.truth.simulator):
                    self.truth = None
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
        return sorted(self._claims.keys() | self.acks.keys())

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
        kinds = [kind for kind in self._lately if issubclass(kind, ByHand)]
        return next((found for kind in kinds if (found := self._of_late(kind, now))), None)

    def driver(self, resource: str, now: float) -> str | None:
        """The instance that a resource obeys now, as far as its owner's acks tell; None: nobody.

        An owner that is silent obeys no command: what it drove it stops.
        """
        ack = self.acks.get(resource)
        if ack is None or now - self._acked[resource][0] > self._quiet_s(resource):
            return None
        return driver(ack)

    def last_driver(self, resource: str) -> str:
        """The instance that a resource obeys, or obeyed last; empty: nobody since a release."""
        ack = self.acks.get(resource)
        return "" if ack is None or ack.obeyed is None else ack.obeyed.instance

    def claim(self, resource: str, now: float) -> Claim | None:
        """The claim that stands: of the largest ballot, until it is silent or released."""
        claim, at, _ = self._claims.get(resource, (None, 0.0, 0.0))
        if claim is None or claim.utility is None or now - at > self._quiet_s(resource):
            return None
        return claim

    def held_since(self, resource: str) -> float:
        """When the newest tenure was first claimed, s; infinite if nobody has claimed it."""
        return self._claims[resource][2] if resource in self._claims else float("inf")

    # Inside --------------------------------------------------------------------------------------

    def _of_late(self, kind: type[M], now: float) -> M | None:
        said, at = self._lately.get(kind, (None, 0.0))
        return cast("M | None", said) if now - at <= service_of(kind).tells_s else None

    def _take_place(self, said: RobotState | Pose, t: float) -> None:
        """Since when it rests, and since when it is lost."""
        if isinstance(said, RobotState):
            self.heard_at = t
            self.state, rests = said, max(abs(said.v), abs(said.w)) <= RESTS
            self.rests_since = _since(self.rests_since, t) if rests else None
        else:
            self.pose, lost = said, said.deviation > LOST_M
            self.lost_since = _since(self.lost_since, t) if lost else None

    def _take_truth(self, truth: Truth, t: float) -> None:
        self.simulators[truth.simulator] = t
        if self._own(truth.simulator):
            self.truth = truth

    def _take_ack(self, ack: Ack, t: float) -> None:
        before, period = self.acks.get(ack.resource), PERIOD
        if before is not None and before.cycle.epoch == ack.cycle.epoch:
            at, period = self._acked[ack.resource]
            if ack.cycle.number > before.cycle.number:
                period = (t - at) / (ack.cycle.number - before.cycle.number)
        self.acks[ack.resource], self._acked[ack.resource] = ack, (t, period)
        now, last = driver(ack), self._drivers.get(ack.resource)
        if now != last:
            self._drivers[ack.resource] = now
            claim = self.claim(ack.resource, t)
            ours = claim if claim is not None and claim.ballot.instance == now else None
            self.exchanges.append(Exchanged(t, ack.resource, last, now, ours))

    def _take_claim(self, claim: Claim, t: float) -> None:
        known, at, first = self._claims.get(claim.resource, (None, t, t))
        silent = t - at > self._quiet_s(claim.resource)
        if known is None or silent or claim.ballot >= known.ballot:
            same = known is not None and claim.ballot == known.ballot
            self._claims[claim.resource] = (claim, t, first if same else t)

    def _quiet_s(self, resource: str) -> float:
        """A resource whose cycles are long is spoken of seldom."""
        _, period = self._acked.get(resource, (0.0, PERIOD))
        return max(QUIET_S, FRESH_CYCLES * period)


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
        self.look(at)
        self.count += 1
        if self.last is None or at - self.last > max(self.deadline_s or 0.0, QUIET_S):
            self.since = at
        self.last, self._late = at, False
        self._arrivals.append(at)

    def look(self, now: float) -> None:
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
        self.look(now)
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
