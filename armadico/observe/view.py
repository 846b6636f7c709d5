"""The state of a society as seen by an observer (sans-IO): messages, tokens and cards in.

All observers share it. There is no directory on the mesh: liveliness tokens show which agents are
alive, cards describe them, an owner's acks name the agent that drives, a holder's claims its
action, and queried bids the other contenders' actions. Times are s of the observer's clock.
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
from armadico.core.membership import agent_of
from armadico.core.messages import (
    Ack,
    Award,
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
    MapGraph,
    MissionStatus,
    Pose,
    Trajectory,
    Truth,
)
from armadico.observe.ground_truth import contradicts

M = TypeVar("M", bound=Message)

FRESH_CYCLES: Final = 3  # a command obeyed longer ago no longer counts as obeyed
DIFFERS_M_S: Final = 0.05  # speeds that differ by less are not shown beside each other
RESTS: Final = 0.01  # m/s and rad/s: a slower robot stands
WINDOW_S: Final = 5.0  # period over which rates are computed

# A pose is corrected in each cycle; a busy observer may be late by this much.
UNCORRECTED_S: Final = 2.0

ASKS_S: Final = 2.0  # an observer that has not queried cards for this long queries none

# How many of the newest are kept:
GONE: Final = 100  # instances that are gone, with their cards
LINES: Final = 200  # log lines
EXCHANGES: Final = 100

AGAIN: Final = 3  # a truth that goes back so often in the window is of two simulators


def driver(ack: Ack) -> str | None:
    """The instance that the owner obeys in an ack's cycle; None if there is none."""
    at = ack.obeyed_cycle
    if ack.obeyed is None or at is None or at.epoch != ack.cycle.epoch:
        return None
    return ack.obeyed.instance if ack.cycle.number - at.number <= FRESH_CYCLES else None


def speed(state: RobotState) -> str:
    """The speed, and where it differs: the ordered and the admitted one, and why.

    While the robot accelerates it differs, too.
    """
    driven, ordered, admitted = state.v, state.ordered.v, state.admitted.v
    words = f"{driven:.2f} m/s"
    if not state.driver or max(abs(driven - ordered), abs(admitted - ordered)) <= DIFFERS_M_S:
        return words
    words += f" ({agent_of(state.driver)} orders {ordered:.2f} m/s"
    if abs(admitted - ordered) > DIFFERS_M_S:
        words += f", the robot agent admits {admitted:.2f}: {state.capped or 'no reason given'}"
    return f"{words})"


def battery(state: RobotState, level: BatteryLevel | None) -> str:
    """The battery as text: voltage, share left if it is known, and whether it is charging."""
    words = [f"{state.battery_v:.1f} V"]
    words += [] if level is None else [f"{100.0 * level.share:.0f} %"]
    return ", ".join([*words, *["charging"] * state.charging])


class Seen(NamedTuple):
    """An instance that is alive, and its card; None: not received yet."""

    name: str
    instance: str
    card: Card | None


class LogLine(NamedTuple):
    """A log line, its time of arrival (s) and its instance."""

    at: float
    instance: str
    log: Log


class Exchanged(NamedTuple):
    """A change of the instance that a resource obeys, and its time (s)."""

    at: float
    resource: str
    before: str | None  # None: no instance
    now: str | None
    claim: Claim | None  # of the instance obeyed now; None: not received


_LATEST: Final = (  # messages of which a view keeps the newest
    *(RobotState, Pose, Description, Correction, ByHand),
    *(MissionStatus, BatteryLevel, Trajectory, MapGraph),
)


@dataclass
class _Contested:
    """The state of one resource: its owner's newest ack and the claim with the largest ballot.

    Times are s; `period` is the time between acks.
    """

    ack: Ack | None = None
    acked_at: float = 0.0
    period: float = PERIOD
    driver: str | None = None  # as of that ack
    claim: Claim | None = None
    claimed_at: float = 0.0
    award: Award | None = None  # of an arbiter, the newest
    held_since: float = inf  # when this tenure was first claimed


class View:
    """The state of one society, updated by `update`, `learn`, `token` and `router`."""

    def __init__(self) -> None:
        # When the first input arrived; None: none yet. What was not received since then is evidence
        # of that length only.
        self.began: float | None = None
        self.alive: dict[str, float] = {}  # instances with a liveliness token, and since when
        self.gone: dict[str, float] = {}  # instances whose token disappeared, and when
        # When the link to the robot's router was lost; None: the router can be reached.
        self.cut_since: float | None = None
        self.cards: dict[str, Card] = {}  # by instance, including instances that are gone
        # By instance and resource, the newest bid record and its time of arrival. The resource of
        # the newest bid is last.
        self.bids: dict[str, dict[str, tuple[BidRecord, float]]] = {}
        # The newest changes of the obeyed instance, newest last.
        self.exchanges: deque[Exchanged] = deque(maxlen=EXCHANGES)
        self.rates: dict[str, Rate] = {}  # by key, the rate of publication
        self.newest: dict[str, Message] = {}  # by key, the newest state
        # By instance, when it last answered a query for its card or bids.
        self.answered: dict[str, float] = {}
        # By instance, the clock of its machine minus the observer's, s, if it is known.
        self.ahead: dict[str, float] = {}
        self._asked_at: float | None = None  # the newest query for cards
        self._asking_since = 0.0  # without a pause until then
        self._bidding: dict[tuple[str, str], float] = {}  # since when without a pause
        self.logs: deque[LogLine] = deque(maxlen=LINES)  # the newest log lines, newest last
        self.reports: dict[str, MonitorReport] = {}  # by monitor, its newest report
        # By kind of message, the progress of errands.
        self.errands: dict[type[Message], tuple[Progress, ...]] = {}
        # The id of the robot's own simulator, if the observer knows it from elsewhere, as a run
        # that started it; empty: by the robot's description.
        self.simulator = ""
        self.truth: Truth | None = None  # the newest ground truth of the robot's own simulator
        self.rests_since: float | None = None  # when the robot came to rest; None: it moves
        # When the pose became too uncertain to drive; None: the robot is localized.
        self.lost_since: float | None = None
        # All simulators that publish in the namespace, and when they last did.
        self.simulators: dict[str, float] = {}
        self._contradicted: deque[float] = deque(maxlen=AGAIN)  # when the own truth went back
        self._latest: dict[type[Message], tuple[Message, float]] = {}  # with its time, s
        self._contested: dict[str, _Contested] = {}  # by resource

    @classmethod
    def of(cls, cards: Mapping[tuple[str, str], Card | None]) -> View:
        """A view of live agents, by (name, instance), with their cards; None: no card."""
        view = cls()
        for (_, instance), card in cards.items():
            view.token(instance, there=True, t=0.0)
            if card is not None:
                view.learn(card, 0.0)
        return view

    # Input ---------------------------------------------------------------------------------------

    def begin(self, t: float) -> None:
        """Record that the observation began; an input does so, too."""
        if self.began is None:
            self.began = t

    def ask(self, t: float) -> None:
        """Record that all cards are queried now, which an observer does each second, or not."""
        if self._asked_at is None or t - self._asked_at > ASKS_S:
            self._asking_since = t
        self._asked_at = t

    def router(self, *, there: bool, t: float) -> None:
        """Record whether the robot's router can be reached.

        While it cannot, the mesh reports no token as gone.
        """
        self.cut_since = None if there else t

    def token(self, instance: str, *, there: bool, t: float) -> bool:
        """Process a liveliness token that appeared or disappeared; False if nothing changed."""
        self.begin(t)
        if (instance in self.alive) == there:
            return False
        if there:
            self.alive[instance] = t
            self.gone.pop(instance, None)
            return True
        del self.alive[instance]
        self.gone[instance] = t
        for known in (self.cards, self.bids, self.answered, self.ahead):
            for gone in [each for each in known if each not in self.alive][:-GONE]:
                del known[gone]
        for gone in list(self.gone)[:-GONE]:
            del self.gone[gone]
        return True

    def update(self, key: str, message: Message | None, t: float) -> None:
        """Process a publication; the key has no namespace, None cannot be decoded."""
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
            self.logs.append(LogLine(t, key.rpartition("/")[2], message))
        self.learn(message, t)

    def learn(self, message: Message, t: float) -> None:
        """Process a message, published or a reply."""
        self.begin(t)
        if isinstance(message, _LATEST):
            self._latest[type(message)] = message, t
        match message:
            case RobotState() | Pose() | Description():
                self._on_robot(message, t)
            case Errands():
                self.errands[type(message)] = message.errands
            case Truth():
                self._on_truth(message, t)
            case _:
                self._on_agent(message, t)

    def _on_agent(self, message: Message, t: float) -> None:
        match message:
            case Ack():
                self._on_ack(message, t)
            case Award():
                contested = self._contested.setdefault(message.resource, _Contested())
                if contested.driver in (None, message.instance) or contested.award is None:
                    contested.award = message
            case Claim():
                self._on_claim(message, t)
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
                for name, (bid, _) in known.items():
                    if bid.utility:
                        self._bidding.setdefault((message.instance, name), t)
                    else:
                        self._bidding.pop((message.instance, name), None)

    # The newest messages -------------------------------------------------------------------------

    @property
    def state(self) -> RobotState | None:
        return self._newest_of(RobotState)

    @property
    def state_at(self) -> float | None:
        """When the newest robot state arrived, s."""
        return self._latest[RobotState][1] if RobotState in self._latest else None

    @property
    def pose(self) -> Pose | None:
        return self._newest_of(Pose)

    @property
    def pose_at(self) -> float | None:
        """When the newest pose arrived, s."""
        return self._latest[Pose][1] if Pose in self._latest else None

    @property
    def description(self) -> Description | None:
        return self._newest_of(Description)

    @property
    def mission(self) -> MissionStatus | None:
        return self._newest_of(MissionStatus)

    @property
    def level(self) -> BatteryLevel | None:
        return self._newest_of(BatteryLevel)

    @property
    def trajectory(self) -> Trajectory | None:
        return self._newest_of(Trajectory)

    @property
    def acks(self) -> dict[str, Ack]:
        return {name: each.ack for name, each in self._contested.items() if each.ack is not None}

    # Derived state -------------------------------------------------------------------------------

    @property
    def tasks(self) -> str:
        """The active mission of several tasks, with its progress; empty if there is none."""
        active = next((each for each in self.missions if each.active), None)
        return "" if active is None else f"{active.name}: {active.summary}"

    @property
    def missions(self) -> list[Progress]:
        """All known missions of several tasks."""
        known = (each for of_kind in self.errands.values() for each in of_kind)
        return [each for each in known if each.steps is not None]

    @property
    def names(self) -> set[str]:
        """The names of the live agents."""
        return {agent_of(instance) for instance in self.alive}

    @property
    def agents(self) -> list[Seen]:
        """The live instances, sorted by name."""
        return sorted(Seen(agent_of(each), each, self.cards.get(each)) for each in self.alive)

    @property
    def world(self) -> str:
        """The name of the map on the cards of live agents, if all have the same; else ""."""
        worlds = {card.world for _, _, card in self.agents if card is not None and card.world}
        return worlds.pop() if len(worlds) == 1 else ""

    @property
    def complete(self) -> bool:
        """Whether any agent is alive and the cards of all live agents are known."""
        return bool(self.alive) and self.alive.keys() <= self.cards.keys()

    @property
    def claimed(self) -> list[str]:
        """The resources of which an ack or a claim was received."""
        return sorted(self._contested)

    @property
    def resources(self) -> list[str]:
        """`claimed`, and the resources that cards own or compete for."""
        offered = {name for card in self.cards.values() for name in (*card.resources, *card.owns)}
        return sorted(offered.union(self.claimed))

    @property
    def doubled(self) -> dict[str, list[str]]:
        """By key, the instances that provide the same state: a conflict if there are several."""
        by_key: dict[str, list[str]] = {}
        for _, instance, card in self.agents:
            for key in card.provides if card else ():
                service = service_at(key)
                if service is not None and service.kind is Kind.STATE:
                    by_key.setdefault(key, []).append(instance)
        return {key: instances for key, instances in by_key.items() if len(instances) > 1}

    @property
    def controller(self) -> str:
        """The name that the robot's controller reports; empty if it is not known."""
        return "" if self.description is None else self.description.controller

    def _own(self, simulator: str) -> bool:
        """Whether a simulator is the robot's own; one without an id never is."""
        described = "" if self.description is None else self.description.of_truth
        return simulator == (self.simulator or described) != ""

    def strangers(self, now: float) -> list[str]:
        """Simulators that publish in the namespace but are not the robot's.

        If the robot is not described yet, a single simulator is no stranger. The robot's own id is
        among them if two simulators have it.
        """
        active = [each for each, at in self.simulators.items() if now - at <= WINDOW_S]
        again = self._contradicted
        twice = len(again) == AGAIN and now - again[0] <= WINDOW_S
        others = sorted(each for each in active if twice or not self._own(each))
        return others if self.description is not None or len(others) > 1 else []

    @property
    def stop(self) -> Stop:
        """The stop in the newest robot state; `stopped` also checks that the state is fresh."""
        return Stop() if self.state is None else self.state.stop

    @property
    def battery(self) -> str:
        """The battery as text; empty if it is not known."""
        return "" if self.state is None else battery(self.state, self.level)

    def confidence(self, now: float) -> float | None:
        """The confidence of the localization, 0 to 1; None without a fresh correction."""
        correction = self._recent(Correction, now)
        return None if correction is None else correction.confidence

    def uncorrected_s(self, now: float) -> float | None:
        """For how long the pose is of the wheels alone, s, as far as this view has seen.

        None: it is corrected, or it has no error that could be corrected, or none is estimated.
        """
        pose = self.pose
        if pose is None or self.began is None or not any(pose.covariance):
            return None
        alone_s = now - self._latest.get(Correction, (None, self.began))[1]
        return alone_s if alone_s > UNCORRECTED_S else None

    def off_map(self, now: float) -> bool:
        """Whether the map does not show the place of the robot, which is not lost."""
        correction = self._recent(Correction, now)
        return correction is not None and correction.off_map

    def pose_text(self, now: float) -> str:
        """The uncertainty of the pose as text; empty if it is not known."""
        pose = self.pose
        if pose is None or not pose.covariance:
            return ""
        off = f"+-{pose.deviation:.2f} m"
        if self.off_map(now):
            return f"off the map, {off}, +-{degrees(pose.heading_deviation):.0f} deg"
        if self.lost_since is not None:
            return f"LOST for {max(0.0, now - self.lost_since):.0f} s, {off}"
        sure, alone_s = self.confidence(now), self.uncorrected_s(now)
        words = [off, f"+-{degrees(pose.heading_deviation):.0f} deg"]
        if alone_s is not None:
            longer = "" if Correction in self._latest else " or longer"
            words.append(f"by the wheels alone for {alone_s:.0f} s{longer}")
        return ", ".join([*words, *([] if sure is None else [f"confidence {sure:.2f}"])])

    def graph(self, now: float) -> MapGraph | None:
        """The graph of the map that is made meanwhile; None if there is no fresh one."""
        return self._recent(MapGraph, now)

    def bid(self, instance: str, resource: str = "") -> BidRecord | None:
        """An instance's newest bid record for a resource, or for any if `resource` is empty."""
        known = self.bids.get(instance, {})
        found = known.get(resource) if resource else next(reversed(known.values()), None)
        return None if found is None else found[0]

    def bids_for(self, instance: str, resource: str, now: float) -> float:
        """For how long an instance is known to have bid for a resource without a pause, s."""
        return now - self._bidding.get((instance, resource), now)

    def mission_silent_s(self, now: float) -> float | None:
        """For how long no mission status has come, s; None while it is fresh or there was none."""
        if self.mission is None or self._recent(MissionStatus, now) is not None:
            return None
        return now - self._latest[MissionStatus][1]

    def unanswered_s(self, instance: str, now: float) -> float:
        """For how long a live instance has been queried and has not answered, s."""
        if self._asked_at is None:
            return 0.0
        last = self.answered.get(instance, float("-inf"))
        return min(now, self._asked_at + ASKS_S) - max(
            last, self.alive[instance], self._asking_since
        )

    def age(self, now: float) -> float:
        """For how long the society has been observed, s."""
        return 0.0 if self.began is None else now - self.began

    def state_is_fresh(self, now: float) -> bool:
        """Whether the newest robot state is fresh."""
        return (
            self.state_at is not None
            and now - self.state_at <= service_of(RobotState).stale_after_s
        )

    def stopped(self, now: float) -> bool | None:
        """Whether the stop is latched; None if the newest robot state is not fresh."""
        return self.stop.stopped if self.state_is_fresh(now) else None

    def hand(self, now: float) -> ByHand | None:
        """The fresh state of an agent through which a person drives; None if there is none."""
        kinds = [kind for kind in self._latest if issubclass(kind, ByHand)]
        return next((found for kind in kinds if (found := self._recent(kind, now))), None)

    def driver(self, resource: str, now: float) -> str | None:
        """The instance that a resource obeys now, by its owner's acks; None if there is none.

        An owner whose acks have stopped obeys no command.
        """
        known = self._contested.get(resource)
        if known is None or known.ack is None or now - known.acked_at > _quiet_s(known):
            return None
        return driver(known.ack)

    def lead(self, resource: str, now: float) -> str | None:
        """The instance whose bid a resource follows: the driver, or the one that it awards most."""
        driven = self.driver(resource, now)
        known = self._contested.get(resource)
        award = None if known is None else known.award
        if award is None or award.instance != driven or not award.agents:
            return driven
        return max(zip(award.shares, award.agents, strict=False), default=(0.0, driven))[1]

    def last_driver(self, resource: str) -> str:
        """The instance that a resource obeys or obeyed last; empty after a release."""
        known = self._contested.get(resource)
        obeyed = None if known is None or known.ack is None else known.ack.obeyed
        return "" if obeyed is None else obeyed.instance

    def claim(self, resource: str, now: float) -> Claim | None:
        """The valid claim: that of the largest ballot, until it expires or is released."""
        known = self._contested.get(resource)
        if known is None or known.claim is None or known.claim.utility is None:
            return None
        return known.claim if now - known.claimed_at <= _quiet_s(known) else None

    def held_since(self, resource: str) -> float:
        """When the newest tenure was first claimed, s; infinite if there was no claim."""
        known = self._contested.get(resource)
        return inf if known is None else known.held_since

    # Inside --------------------------------------------------------------------------------------

    def _newest_of(self, kind: type[M]) -> M | None:
        return cast("M | None", self._latest.get(kind, (None, 0.0))[0])

    def _recent(self, kind: type[M], now: float) -> M | None:
        """The newest message of a kind, if it is fresh."""
        at = self._latest.get(kind, (None, 0.0))[1]
        return self._newest_of(kind) if now - at <= service_of(kind).stale_after_s else None

    def _on_robot(self, message: RobotState | Pose | Description, t: float) -> None:
        match message:
            case RobotState():
                rests = max(abs(message.v), abs(message.w)) <= RESTS
                self.rests_since = _since(self.rests_since, t) if rests else None
            case Pose():
                lost = message.deviation > LOST_M
                self.lost_since = _since(self.lost_since, t) if lost else None
            case Description() if self.truth is not None and not self._own(self.truth.simulator):
                self.truth = None

    def _on_truth(self, truth: Truth, t: float) -> None:
        self.simulators[truth.simulator] = t
        if self._own(truth.simulator):
            if self.truth is not None and contradicts(self.truth, truth):
                self._contradicted.append(t)
            self.truth = truth

    def _on_ack(self, ack: Ack, t: float) -> None:
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

    def _on_claim(self, claim: Claim, t: float) -> None:
        known = self._contested.setdefault(claim.resource, _Contested())
        before = known.claim
        silent = t - known.claimed_at > _quiet_s(known)
        if before is None or silent or claim.ballot >= before.ballot:
            if before is None or claim.ballot != before.ballot:
                known.held_since = t
            known.claim, known.claimed_at = claim, t


def _quiet_s(known: _Contested) -> float:
    # Messages about a resource with long cycles are rare.
    return max(QUIET_S, FRESH_CYCLES * known.period)


def _since(known: float | None, t: float) -> float:
    return t if known is None else known


# Rates --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Spread:
    """Intervals between messages, s."""

    least: float
    most: float
    mean: float
    deviation: float


class Rate:
    """The rate of messages over the last `WINDOW_S`. Times are s."""

    def __init__(self, deadline_s: float | None = None) -> None:
        """Start; an interval longer than the deadline counts as missed."""
        self.count = 0
        self.missed = 0
        self.last: float | None = None
        self.since = 0.0  # the first message after the last timeout, or the first of all
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
        """Drop arrivals outside the window, and count a missed deadline."""
        while self._arrivals and now - self._arrivals[0] > WINDOW_S:
            self._arrivals.popleft()
        if self.deadline_s is None or self.last is None or self._late:
            return
        if now - self.last > self.deadline_s:
            self._late = True
            self.missed += 1

    def hz(self, now: float) -> float | None:
        """Messages per second; None before the second message.

        A pause of more than two mean intervals lowers the rate immediately.
        """
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
        """The intervals in the window; None before there is one."""
        gaps = [b - a for a, b in pairwise(self._arrivals)]
        return Spread(min(gaps), max(gaps), mean(gaps), pstdev(gaps)) if gaps else None
