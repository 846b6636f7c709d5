"""What was observed of a society, and what follows from it: one record for every back end.

Every observation can be made from outside the processes: what is published on the mesh, what the
robot agent writes to the controller, and which faults the injector makes. The virtual network, real
processes and recordings all yield them, in the order of time. `Record` keeps what the promises and
the figures of trials need: which faults are on, the cycle, the claims, the bids, what is obeyed.
`at` is always in seconds, by one clock of the observer.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from math import hypot, inf
from typing import Final, NamedTuple, TypeVar

from msgspec import Struct

from armadico.config.loading import find, load_entry
from armadico.config.profile import SensorProfile, load_profile
from armadico.config.scenarios import Scenario
from armadico.core.cycles import PERIOD
from armadico.core.messages import (
    Ack,
    Ballot,
    BidRecord,
    Claim,
    Command,
    Cycle,
    Log,
    Message,
    RobotState,
)
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Truth
from armadico.observe.view import agent_of, driver
from armadico_tools.faults.fault_types import (
    AGAIN_S,
    FORGETS,
    KINDS,
    WEDGED_M,
    WEDGED_S,
    Promise,
    voided,
)

T = TypeVar("T")

Timed = deque[tuple[float, T]]
"""What is kept, each with the time from which it counts."""

# Observations -----------------------------------------------------------------------------------


class Observation(Struct, frozen=True):
    """One thing, and when it was seen."""

    at: float


class Said(Observation, frozen=True):
    """A message of an agent, a person or the simulator."""

    message: Message


def of_the_wheels(message: Message) -> bool:
    """Whether a message is not about another resource: the promises are about the wheels."""
    return getattr(message, "resource", WHEELS.name) == WHEELS.name


class Ordered(Observation, frozen=True):
    """Speeds that the robot agent wrote to the controller, m/s and rad/s."""

    v: float
    w: float


class Faulted(Observation, frozen=True):
    """A fault begins or ends; `kind` is one of `fault_types.KINDS`, `whom` names agents.

    `to` names the receivers, for faults of the network; `amount` is the kind's own number
    (`plan.DRAWS`). An unknown amount counts as the worst.
    """

    kind: str
    whom: tuple[str, ...]
    began: bool
    to: tuple[str, ...] = ()
    amount: float = inf


class Passed(Observation, frozen=True):
    """Only time has passed: for the end, and wherever nothing else is observed for long."""


class Obeyed(Observation, frozen=True):
    """The robot agent obeys a command. Without it the `Ack` has to do."""

    ballot: Ballot
    cycle: Cycle


class Refused(Observation, frozen=True):
    """The robot agent refuses a command; `why` is the verdict's name."""

    ballot: Ballot
    why: str


class Missed(Observation, frozen=True):
    """An agent takes a live one for gone, by a lease that ran out."""

    instance: str


class Denied(Observation, frozen=True):
    """An instance may not join, or stay; `why` is for people."""

    instance: str
    why: str


class Astray(Observation, frozen=True):
    """An agent takes another robot for this one, and publishes poses of that."""


class Bids(Observation, frozen=True):
    """The last bid of an instance, or why it does not bid; `age` is how long ago that was, s."""

    instance: str
    record: BidRecord
    age: float = 0.0


class Came(Observation, frozen=True):
    """The liveliness token of an instance appeared."""

    instance: str


class Left(Observation, frozen=True):
    """An instance is gone, and so are its bids."""

    instance: str


# What follows from them -------------------------------------------------------------------------

MOVING_M_S = 0.02
MOVING_RAD_S = 0.05
"""Faster than this is moving: above the noise of encoders at rest."""

SIGMAS = 3.0
"""A pose is wrong and unsaid that is off by more than so many of its standard deviations,"""

ALLOWED_M, ALLOWED_RAD = 0.15, 0.15
"""and this beside: so near a goal counts as reached, and so far off is what lies a metre ahead."""

ASTRAY_S = 5.0
"""With the pose wrong and unsaid, and for so long after, sensing is not honest; nor for so long
after the sonar agent was started again, which has forgotten what was behind."""

OVER_S = 2.0
"""So long after a fault has ended its voids end too, if the robot has not come to rest before."""

JUST_AFTER = "just after: "

SWUNG_M = 0.1
"""A corner of the body may swing out by so much, m, beside what the robot needs to stop,"""

HEARD_S = 0.4
"""once its sonars have gone round: they take four cycles."""

FRESH_CYCLES = 3
"""A command may answer a cycle so many older than the newest (docs/coordination.md)."""

KEPT: Final = 3000
"""Messages of a kind that are kept for figures: a few minutes' worth."""

REST: Final = 0.01
"""The wheels rest below this, m/s and rad/s."""

ON_ITS_WAY_M_S: Final = 0.05

QUERIED_S: Final = 1.5
"""A bid counts as recent within this where bids are queried, s."""

POSES = 64  # cycles whose true poses are remembered, for poses that come late

ACKS_S = 1.0
"""A holder may let go of what is obeyed so long after healing: acks that were slow are still on
their way, and it counts 6 cycles without one."""

SILENT_S = 0.3
"""A robot agent that has published nothing for so long is not alive."""

BID_AGE_S = 0.35
"""A bid older than this does not count: three cycles, and the way here."""


def may_be_off(pose: Pose) -> tuple[float, float]:
    """By how much a pose may be off by its own word, m and rad; one that is lost by anything."""
    if pose.deviation > LOST_M:
        return inf, inf
    return SIGMAS * pose.deviation + ALLOWED_M, SIGMAS * pose.heading_deviation + ALLOWED_RAD


@dataclass(frozen=True)
class Bounds:
    """The numbers of the promises, SI units."""

    stop_s: float = 0.4  # from the last valid command to the stop
    heard_s: float = 0.0  # a command may be seen so long after the order that obeys it
    overlap_s: float = 0.5  # two tenures in a whole network: 5 cycles
    obeyed_s: float = 5.0
    moves_s: float = 2.0
    stood_back_s: float = 5.0
    watchdog_s: float = 2.0
    killed_s: float = 0.1  # from a holder's end to another's obeyed command: far below its silence
    silent_s: float = 0.3  # from a silent holder's last to another's first: before the stop
    unobeyed_s: float = 0.9  # where the other still receives it: 6 cycles, and the way
    arrives_s: float = 90.0  # from the last fault on
    start_s: float = 20.0  # time for a mission that no fault befalls, besides its way's
    way_m_s: float = 0.25  # speed for its way: half as much time again as any that was seen
    skew_s: float = 0.25  # between two messages of one cycle: a cycle, and two ways here
    v_max: float = 1.6  # m/s
    w_max: float = 5.2  # rad/s
    braking_s: float = 3.0  # from top speed to rest, by the ramp, and for the loops to settle
    v_decel: float = 0.6  # m/s^2, by the ramp
    v_accel: float = 0.9  # m/s^2: 1.5 times the steepest ramp, for the overshoot of the loops
    w_accel: float = 2.7  # rad/s^2, likewise
    way_error: float = 0.0  # what the wheels count wrong: of a way, m a metre
    drift_rad_m: float = 0.0  # and in heading, rad a metre
    turn_error: float = 0.0  # and of a turn


def bounds_of(scenario: Scenario) -> Bounds:
    """The bounds for a scenario's robot: its ramps, its watchdog, and what its wheels count wrong.

    Raises ConfigError if there is no such robot.
    """
    profile = load_profile(scenario.robot)
    sensors = load_entry(find("robots", "sensors"), SensorProfile, scenario.sensors)
    limits, slip = profile.limits, 3.0 * sensors.slip
    return Bounds(
        watchdog_s=profile.watchdog_s,
        v_max=limits.v_max,
        w_max=limits.w_max,
        v_decel=limits.v_decel,
        v_accel=OVERSHOOT * max(limits.v_accel, limits.v_decel),
        w_accel=OVERSHOOT * max(limits.w_accel, limits.w_decel),
        way_error=sensors.way_error + slip,
        drift_rad_m=sensors.drift_rad_m + slip,
        turn_error=sensors.turn_error + slip,
    )


OVERSHOOT = 1.5
"""Of the speed loops over the ramp that they follow, within a cycle."""


def age(cycle: Cycle, newest: Cycle | None) -> float:
    """How many cycles before the newest; inf in another epoch."""
    if newest is None or cycle.epoch != newest.epoch:
        return inf
    return newest.number - cycle.number


def seconds_since(cycle: Cycle, newest: Cycle | None) -> float:
    """How long ago a cycle of this epoch was, s: bids are queried some time after that."""
    known = newest is not None and newest.epoch == cycle.epoch
    return max(age(cycle, newest), 0) * PERIOD if known else 0.0


def _from(kept: Timed[T], since: float) -> Iterator[tuple[float, T]]:
    return ((at, item) for at, item in kept if at >= since)


def _first(kept: Timed[T], since: float, wanted: Callable[[T], bool]) -> float | None:
    return next((at for at, item in _from(kept, since) if wanted(item)), None)


class Fault(NamedTuple):
    """One that is on, as far as promises are concerned."""

    kind: str
    whom: tuple[str, ...]
    to: tuple[str, ...]
    amount: float


@dataclass
class Record:
    """What is known after each observation, which it takes before the promises are checked.

    The last few minutes of some kinds are kept as well, each with its own time: figures are
    measured by them.
    """

    bounds: Bounds = field(default_factory=Bounds)
    acks: Timed[Ack] = field(default_factory=lambda: deque(maxlen=KEPT))  # of the wheels
    commands: Timed[Command] = field(default_factory=lambda: deque(maxlen=KEPT))
    truths: Timed[Truth] = field(default_factory=lambda: deque(maxlen=KEPT))
    orders: Timed[Ordered] = field(default_factory=lambda: deque(maxlen=KEPT))
    logs: Timed[Log] = field(default_factory=lambda: deque(maxlen=200))
    alive: dict[str, float] = field(default_factory=dict)  # since when its token is there
    now: float = -inf
    whole_since: float = inf  # inf while a fault breaks the network
    free_since: float = inf  # inf while a fault or a stop excuses that it does not move
    healed_at: float = -inf  # when the last of what excused it ended
    state: RobotState | None = None
    before: RobotState | None = None  # the state before that, of whatever epoch
    state_at: float = -inf
    state_gap_s: float = inf  # from the state before to the newest
    ack: Ack | None = None  # the newest of the wheels
    ack_before: Ack | None = None
    acked_at: float = -inf
    obeyed_at: float = -inf  # when the ack last showed a command obeyed of late
    moved_at: float = -inf
    rested_at: float = -inf
    stood_back_at: float = -inf  # when a tenure that was not obeyed was last let go of
    mad_back_at: float = -inf  # likewise, by one whose bids are nonsense, and no other bid
    truth: Truth | None = None
    truth_at: float = -inf
    astray_at: float = -inf  # when the pose was last wrong and unsaid
    lost_at: float = -inf  # when it last said that it was lost
    forgot_at: float = -inf  # when the sonar agent last started with an empty map
    wedged_at: float = -inf  # a fault held it against something last, and it is not clear yet
    driving: bool = False
    bids: dict[str, tuple[float, BidRecord]] = field(default_factory=dict)
    sees_bids: bool = False
    claims: dict[Ballot, tuple[float, float, Claim]] = field(default_factory=dict)
    ordered: Ordered | None = None
    active: Counter[Fault] = field(default_factory=Counter)
    ended_at: float = -inf  # when the last fault of any kind ended
    _left_near_until: float = -inf  # until when a contact may be what a fault has led to
    _ended: dict[Promise, tuple[float, str]] = field(default_factory=dict)  # by faults now over
    _excused: bool = True
    _again_at: float = -inf  # when a robot agent that was refused, and is not there, tries again
    _truths: dict[Cycle, Truth] = field(default_factory=dict)  # where it was in the last cycles

    def update(self, seen: Observation) -> None:
        """Take one observation. One that comes late counts as coming now."""
        if self.whole_since == inf and not self.active:
            self.whole_since = self.free_since = seen.at
            self._excused = False
        if not (
            self.bounds.heard_s and isinstance(seen, Said) and isinstance(seen.message, Command)
        ):
            self.now = max(self.now, seen.at)  # a busy observer takes commands before their turn
        if isinstance(seen, Said):
            self._receive(seen)
        elif isinstance(seen, Faulted):
            self._fault(seen)
        elif isinstance(seen, Ordered):
            self.ordered = seen
            self.orders.append((self.now, seen))
        elif isinstance(seen, Bids):
            self.sees_bids = True
            self.bids[seen.instance] = (self.now - seen.age, seen.record)
        elif isinstance(seen, Denied):
            self._deny(seen)
        elif isinstance(seen, Came):
            self.alive.setdefault(seen.instance, self.now)
        elif isinstance(seen, Left):
            self.bids.pop(seen.instance, None)
            self.alive.pop(seen.instance, None)

    # How things stand ----------------------------------------------------------------------------

    def age(self, cycle: Cycle) -> float:
        """How many cycles before the newest; inf in another epoch."""
        return age(cycle, None if self.state is None else self.state.cycle)

    def truth_of(self, cycle: Cycle) -> Truth | None:
        """Where the robot was in one of the last cycles."""
        return self._truths.get(cycle)

    def whole_for(self) -> float:
        """Seconds for which nothing has broken the network; negative while something does."""
        return self.now - self.whole_since

    def unsure_for(self) -> float:
        """Seconds since it last could not know where it is, whether it said so or not."""
        return self.now - max(self.astray_at, self.lost_at)

    def void(self, promise: Promise) -> bool:
        """Whether a fault takes the promise away, now or until the robot is itself again."""
        return bool(self.reason(promise))

    def reason(self, promise: Promise) -> str:
        """What takes the promise away, in a word; empty if nothing does.

        Whoever thinks that it is elsewhere steers into door posts: without localization that is
        what a robot agent that was away leaves behind.
        """
        if promise is not Promise.COLLISION:
            return self._fault_voids(promise)
        wedged = self.now - self.wedged_at < WEDGED_S
        return self._contact_voids() or ("wedged" if wedged else "")

    def contact_reason(self) -> str:
        """What takes a contact's guilt away, in a word; empty: nothing does.

        Just after a fault that is what it could not have stopped for when the fault ended.
        """
        why = self.reason(Promise.COLLISION)
        return "" if why.startswith(JUST_AFTER) and self.now > self._left_near_until else why

    def _contact_voids(self) -> str:
        fault = self._fault_voids(Promise.COLLISION)
        if fault:
            return fault
        if self.now - self.astray_at < ASTRAY_S:
            return "pose"
        return "sonar agent restarted" if self.now - self.forgot_at < ASTRAY_S else ""

    def _fault_voids(self, promise: Promise) -> str:
        for fault in self.active:
            why = voided(fault.kind, fault.whom, fault.amount).get(promise)
            if why:
                return why
        ended, why = self._ended.get(promise, (-inf, ""))
        rested = ended <= self.rested_at < self.now  # what brought it to rest is over, too
        return f"{JUST_AFTER}{why}" if self.now - ended < OVER_S and not rested else ""

    def befalls(self, who: str, *kinds: str) -> bool:
        """Whether a fault of one of these kinds befalls an agent now."""
        return any(fault.kind in kinds and who in fault.whom for fault in self.active)

    def mad(self, instance: str) -> bool:
        """Whether an instance's bids are made to be nonsense: they count for nothing."""
        return self.befalls(agent_of(instance), "nan")

    def mad_in_vain(self, most: float) -> bool:
        """Whether one whose bids are nonsense claims, and has not been obeyed, for at most so long.

        All others wait until it lets go.
        """
        return any(
            self.mad(ballot.instance)
            and ballot != self.obeyed
            and self.now - last <= BID_AGE_S
            and self.now - first <= most
            for ballot, (first, last, _) in self.claims.items()
        )

    def driven(self) -> bool:
        """Whether a command is obeyed, by the newest ack."""
        return self.obeyed_at >= self.acked_at

    def stopped(self) -> bool:
        """Whether `robot/stop` is latched."""
        return self.state is not None and self.state.stop.stopped

    def disturbed(self) -> bool:
        """Whether any fault is on."""
        return bool(self.active)

    def troubled(self, but: str) -> bool:
        """Whether a fault of another kind than this is on."""
        return any(fault.kind != but for fault in self.active)

    @property
    def obeyed(self) -> Ballot | None:
        """The ballot of the last command acknowledged as obeyed; none since a release."""
        return None if self.ack is None else self.ack.obeyed

    def bidders(self) -> list[str]:
        """Instances that bid, as far as one can see: by their bids, else by their claims."""
        if self.sees_bids:
            return [
                instance
                for instance, (at, record) in self.bids.items()
                if record.utility and self.now - at <= BID_AGE_S and not self.mad(instance)
            ]
        recent = [b for b, (_, last, _) in self.claims.items() if self.now - last <= BID_AGE_S]
        return [ballot.instance for ballot in recent]

    @property
    def deaf(self) -> bool:
        """Whether commands may reach the robot and not the observer: real links are cut."""
        return self.bounds.heard_s > 0.0 and any(f.kind == "partition" for f in self.active)

    @property
    def driver(self) -> str | None:
        """The instance that is obeyed now; None if there is none, or the owner is silent."""
        silent = self.ack is None or self.now - self.acked_at > SILENT_S
        return None if self.ack is None or silent else driver(self.ack)

    def on_its_way(self) -> bool:
        """Whether a command is obeyed and the robot truly drives."""
        return self.truth is not None and self.truth.v > ON_ITS_WAY_M_S and self.driver is not None

    def bids_lately(self, instance: str) -> bool:
        """Whether bids of an instance were received lately, on real processes by a query."""
        at, record = self.bids.get(instance, (-inf, None))
        return record is not None and self.now - at <= QUERIED_S and bool(record.utility)

    def instances(self, name: str) -> list[str]:
        """The instances of an agent that are alive, the oldest first."""
        return [
            one for one in sorted(self.alive, key=self.alive.__getitem__) if agent_of(one) == name
        ]

    # From when to when ---------------------------------------------------------------------------

    def obeyed_after(self, since: float, but: Container[str] = ()) -> float | None:
        """When the next command that is known to have been obeyed was published.

        It is known by the ack of the robot agent: the first after `since` of a command published
        since then by an instance that is none of `but`.
        """
        sent = {(c.ballot, c.cycle): at for at, c in self.commands}
        for _, ack in _from(self.acks, since):
            if ack.obeyed is None or ack.obeyed_cycle is None or ack.obeyed.instance in but:
                continue
            found = sent.get((ack.obeyed, ack.obeyed_cycle))
            if found is not None and found >= since:
                return found
        return None

    def stop_after(self, since: float) -> float | None:
        """When the first zero speeds after a time were written to the controller."""
        return _first(self.orders, since, lambda order: order.v == 0.0 and order.w == 0.0)

    def moves_after(self, since: float) -> float | None:
        """When the first speeds that are not zero were written to the controller."""
        return _first(self.orders, since, lambda order: order.v != 0.0 or order.w != 0.0)

    def longest_silence(self, since: float) -> float:
        """The longest time between two orders on the line since a time, s."""
        times = [since, *(at for at, _ in _from(self.orders, since)), self.now]
        return max(b - a for a, b in pairwise(times))

    def rest_after(self, since: float) -> float | None:
        """When the wheels were first seen to rest; the truth comes each 100 ms."""
        return _first(self.truths, since, lambda t: abs(t.v) < REST and abs(t.w) < REST)

    def fastest(self, since: float, until: float) -> float:
        """The largest true speed in a time, m/s; 0 if none was received."""
        return max((abs(t.v) for at, t in _from(self.truths, since) if at <= until), default=0.0)

    def share_obeyed(self, since: float, until: float = inf) -> float:
        """The share of the cycles in a time in which a recent command was obeyed, 0 to 1."""
        cycles = [driver(ack) is not None for at, ack in _from(self.acks, since) if at <= until]
        return sum(cycles) / len(cycles) if cycles else 0.0

    def late_commands(self, since: float, ballot: Ballot) -> int:
        """How many commands with a ballot, or an older one of its instance, came since a time."""
        late = (c.ballot for _, c in _from(self.commands, since))
        return sum(b.instance == ballot.instance and b <= ballot for b in late)

    # Inside --------------------------------------------------------------------------------------

    def _receive(self, seen: Said) -> None:
        message = seen.message
        if isinstance(message, RobotState):
            self._cycle(message)
        elif isinstance(message, Ack):
            self._acked(message)
        elif isinstance(message, Claim):
            self._claim(message)
        elif isinstance(message, MissionStatus):
            self.driving = message.state is MissionState.DRIVING
        elif isinstance(message, Pose):
            self._posed(message)
        elif isinstance(message, Command):
            self.commands.append((seen.at, message))
        elif isinstance(message, Log):
            self.logs.append((self.now, message))
        elif isinstance(message, Truth):
            self.truth, self.truth_at = message, self.now
            self.truths.append((self.now, message))
            near = message.clearance is not None and message.clearance < WEDGED_M
            if not near:
                self.wedged_at = -inf
            elif self._contact_voids():
                self.wedged_at = self.now
            if abs(message.v) < MOVING_M_S and abs(message.w) < MOVING_RAD_S:
                self.rested_at = self.now

    def _posed(self, pose: Pose) -> None:
        most, most_rad = may_be_off(pose)
        truth = self.truth_of(pose.cycle) or self.truth
        if most == inf:
            self.lost_at = self.now
        elif truth is not None:
            off = hypot(pose.x - truth.x, pose.y - truth.y)
            if off > most or abs(wrap(pose.theta - truth.theta)) > most_rad:
                self.astray_at = self.now

    def _cycle(self, state: RobotState) -> None:
        self.before, self.state = self.state, state
        self.state_gap_s, self.state_at = self.now - self.state_at, self.now
        if self.truth is not None:
            self._truths[state.cycle] = self.truth
            if len(self._truths) > POSES:
                del self._truths[next(iter(self._truths))]
        if abs(state.v) >= MOVING_M_S or abs(state.w) >= MOVING_RAD_S:
            self.moved_at = self.now
        self._excuse()
        self.claims = {b: c for b, c in self.claims.items() if self.now - c[1] < 2.0}

    def _acked(self, ack: Ack) -> None:
        if ack.resource != WHEELS.name:
            return
        self.acks.append((self.now, ack))
        self.ack_before, self.ack, self.acked_at = self.ack, ack, self.now
        if driver(ack) is not None:
            self.obeyed_at = self.now

    def _claim(self, claim: Claim) -> None:
        if claim.utility is None:
            self.claims.pop(claim.ballot, None)
            if self._stands_back(claim.ballot):
                self.stood_back_at = self.now
                if self.mad(claim.ballot.instance) and not self.bidders():
                    self.mad_back_at = self.now
            return
        first, last, _ = self.claims.get(claim.ballot, (self.now, self.now, claim))
        if self.now - last > BID_AGE_S:  # whoever was away goes on where it was: a new beginning
            first = self.now
        self.claims[claim.ballot] = (first, self.now, claim)

    def _stands_back(self, released: Ballot) -> bool:
        """Whether it lets go because it is not obeyed, as far as it knows: it bids on.

        Where acks are slow it may have been obeyed all the same, and cannot know.
        """
        if not self.sees_bids:
            return self.obeyed != released
        _, record = self.bids.get(released.instance, (0.0, None))
        bids = record is not None and bool(record.utility)
        return bids and (self.obeyed != released or self.whole_for() < ACKS_S)

    def _fault(self, fault: Faulted) -> None:
        key = Fault(fault.kind, fault.whom, fault.to, fault.amount)
        self.active[key] += 1 if fault.began else -1
        self.active += Counter()  # drops what has come to nothing
        if not fault.began:
            self.ended_at = self.now
            taken = voided(fault.kind, fault.whom, fault.amount)
            if Promise.COLLISION in taken:
                self._left_near_until = self.now + self._stops_in_s()
            self._ended.update({promise: (self.now, why) for promise, why in taken.items()})
            if fault.kind in FORGETS and "sonar" in fault.whom:
                self.forgot_at = self.now
        broken = any(KINDS[fault.kind].breaks for fault in self.active)
        if broken:
            self.whole_since = inf
        elif self.whole_since == inf:
            self.whole_since = max(self.now, self._again_at)
        self._excuse()

    def _stops_in_s(self) -> float:
        """How long it needs to stop if something is nearer than that; 0: nothing is.

        That is to listen all round, to react, and to brake.
        """
        truth, bounds = self.truth, self.bounds
        if truth is None:
            return OVER_S
        v, waits = abs(truth.v), HEARD_S + bounds.stop_s
        needs = v * waits + v * v / (2.0 * bounds.v_decel) + SWUNG_M
        near = truth.clearance is not None and truth.clearance < needs
        return waits + v / bounds.v_decel if near else 0.0

    def _deny(self, denied: Denied) -> None:
        """While a fault breaks the network, another may keep a robot agent from joining."""
        there = self.now - self.state_at <= SILENT_S
        if self.whole_since == inf and not there and agent_of(denied.instance) == "robot":
            self._again_at = denied.at + AGAIN_S

    def _excuse(self) -> None:
        """From the last of what excused it on, it is to move again."""
        if self.stopped() or any(KINDS[fault.kind].excuses for fault in self.active):
            self.free_since, self._excused = inf, True
        elif self._excused:
            self._excused = False
            self.free_since = self.healed_at = max(self.now, self._again_at)
