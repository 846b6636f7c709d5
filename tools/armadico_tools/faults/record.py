"""What follows from observations: the state by which promises are checked.

The virtual network, real processes and recordings all produce observations, in the order of time.
The record has four parts: what the owner of the wheels published, the contest for them, the robot's
body, and the faults. The last messages are kept for the figures of trials.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from math import hypot, inf
from typing import Final, NamedTuple

from armadico.config.loading import find, load_entry
from armadico.config.profile import SensorProfile, load_profile
from armadico.config.scenarios import Scenario
from armadico.config.worlds import Segment, World, load_world
from armadico.core.cycles import PERIOD
from armadico.core.membership import agent_of
from armadico.core.messages import (
    Ack,
    Ballot,
    BidRecord,
    Claim,
    Command,
    Cycle,
    Description,
    Log,
    RobotState,
)
from armadico.core.outgoing import EXPIRY_S
from armadico.core.resources import WHEELS
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Truth
from armadico.mobile.swept_path import Outline
from armadico.observe.audit.poses import may_be_off
from armadico.observe.view import driver
from armadico_tools.faults.fault_types import (
    AGAIN_S,
    KINDS,
    Promise,
    hinders,
    voided,
)
from armadico_tools.faults.figures import Kept
from armadico_tools.faults.observations import (
    Arrived,
    Bids,
    Came,
    Denied,
    Faulted,
    Left,
    Observation,
    Ordered,
    Published,
)

MOVING_M_S = 0.02
MOVING_RAD_S = 0.05
"""Faster than this counts as moving; it is above the noise of encoders at rest."""

OVER_S = 2.0
"""A fault's voids end after this time, s, if the robot has not come to rest before."""

JUST_AFTER = "just after: "

OUTLINE: Final = Outline(0.25, 0.25, 0.2)
"""Of a robot that is not known."""

STOPS_S: Final = 0.3
"""From a reading until the wheels brake, s: a cycle, the command, the speed loops."""

SWUNG_M = 0.1
"""A corner of the body may swing out by this, m, in addition to the stopping distance."""

SONARS_S = 0.4
"""Time for a turn of the sonar ring: four cycles."""

ON_ITS_WAY_M_S: Final = 0.05

QUERIED_S: Final = 1.5
"""A bid counts as recent for this time where bids are queried, s."""

POSES = 64  # cycles whose true poses are kept, for late poses

ACKS_S = 1.0
"""A holder may release for this time after healing although it is obeyed: slow acks are still under
way, and it counts 6 cycles without one."""

SILENT_S = 0.3
"""A robot agent that has published nothing for this time is not alive."""

BID_AGE_S = 0.35
"""A bid older than this does not count: three cycles, and the delay."""


def moves(v: float, w: float) -> bool:
    """Whether a speed counts as moving, m/s and rad/s."""
    return abs(v) >= MOVING_M_S or abs(w) >= MOVING_RAD_S


@dataclass(frozen=True)
class Bounds:
    """The numbers of the promises, SI units."""

    stop_s: float = 0.4  # from the last valid command to the stop
    command_delay_s: float = 0.0  # a command may be received this much after its order
    overlap_s: float = 0.5  # two tenures in a whole network: 5 cycles
    obeyed_s: float = 5.0
    moves_s: float = 2.0
    stood_back_s: float = 5.0
    guard_s: float = 2.0 * EXPIRY_S  # until the guard brakes: the last command, renewed once
    killed_s: float = 0.1  # from a holder's end to another's obeyed command: far below its silence
    silent_s: float = 0.3  # from a silent holder's last to another's first: before the stop
    unobeyed_s: float = 0.9  # where the other still receives it: 6 cycles, and delays
    skew_s: float = 0.25  # between two messages of one cycle: a cycle, and two delays
    limit: float | None = None  # of the speed, by the scenario, m/s; inf: none; None: unknown
    v_max: float = 1.6  # m/s
    w_max: float = 5.2  # rad/s
    braking_s: float = 3.0  # from top speed to rest, by the ramp, and for the loops to settle
    v_decel: float = 0.6  # m/s^2, by the ramp
    v_accel: float = 0.9  # m/s^2: 1.5 times the steepest ramp, for the overshoot of the loops
    w_accel: float = 2.7  # rad/s^2, likewise
    way_error: float = 0.0  # error of the wheels' counts, m per metre
    drift_rad_m: float = 0.0  # of the heading, rad per metre
    turn_error: float = 0.0  # of a turn, rad per rad
    outline: Outline = OUTLINE
    coordination: str = ""  # the mechanism, if it is not ballots
    margin: float | None = None  # by which a bid must be better to take over; None: the resource's
    walls: tuple[Segment, ...] | None = None  # of the world; None: unknown
    world: World | None = None

    def stopping_m(self, v: float) -> float:
        """The way to rest from a speed, m: reading, reacting, braking."""
        return abs(v) * STOPS_S + v * v / (2.0 * self.v_decel)


def bounds_of(scenario: Scenario) -> Bounds:
    """The bounds for a scenario's robot: ramps, errors of the odometry.

    Raises ConfigError for an unknown robot.
    """
    profile = load_profile(scenario.robot)
    sensors = load_entry(find("robots", "sensors"), SensorProfile, scenario.sensors)
    limits, body, slip = profile.limits, profile.body, 3.0 * sensors.slip
    world = load_world(scenario.world) if scenario.world else None
    return Bounds(
        limit=inf if scenario.v_max is None else scenario.v_max,
        v_max=limits.v_max,
        w_max=limits.w_max,
        v_decel=limits.v_decel,
        v_accel=OVERSHOOT * max(limits.v_accel, limits.v_decel),
        w_accel=OVERSHOOT * max(limits.w_accel, limits.w_decel),
        way_error=sensors.way_error + slip,
        drift_rad_m=sensors.drift_rad_m + slip,
        turn_error=sensors.turn_error + slip,
        outline=Outline(body.front_m, body.rear_m, body.width_m / 2.0),
        walls=() if world is None else world.outlines,
        world=world,
    )


def described_bounds(about: Description | None) -> Bounds:
    """The bounds of a robot by its own description; without one its ramps are not checked."""
    if about is None:
        return Bounds(v_accel=inf, w_accel=inf)
    return Bounds(
        v_max=about.v_max,
        w_max=about.w_max,
        v_decel=about.v_decel,
        v_accel=OVERSHOOT * max(about.v_accel, about.v_decel),
        w_accel=OVERSHOOT * max(about.w_accel, about.w_decel),
        outline=Outline(about.front, about.rear, about.half_width),
    )


OVERSHOOT = 1.5
"""Overshoot of the speed loops over their ramp within a cycle."""


def age(cycle: Cycle, newest: Cycle | None) -> float:
    """The number of cycles before the newest; inf in another epoch."""
    if newest is None or cycle.epoch != newest.epoch:
        return inf
    return newest.number - cycle.number


def seconds_since(cycle: Cycle, newest: Cycle | None) -> float:
    """Time since a cycle of this epoch, s: bids are queried some time after their cycle."""
    known = newest is not None and newest.epoch == cycle.epoch
    return max(age(cycle, newest), 0) * PERIOD if known else 0.0


class Fault(NamedTuple):
    """An active fault, as far as it concerns promises."""

    kind: str
    targets: tuple[str, ...]
    to: tuple[str, ...]
    amount: float


@dataclass
class Owner:
    """What the robot agent published, acknowledged and ordered."""

    state: RobotState | None = None
    before: RobotState | None = None  # the previous state, of any epoch
    state_at: float = -inf
    state_gap_s: float = inf  # between the last two states
    ack: Ack | None = None  # the newest of the wheels
    acked_at: float = -inf
    obeyed_at: float = -inf  # when an ack last showed a recent command obeyed
    ordered: Ordered | None = None

    def driven(self) -> bool:
        """Whether a command is obeyed, by the newest ack."""
        return self.obeyed_at >= self.acked_at

    def stopped(self) -> bool:
        """Whether `robot/stop` is latched."""
        return self.state is not None and self.state.stop.stopped

    @property
    def obeyed(self) -> Ballot | None:
        """The ballot of the last command acknowledged as obeyed; None since a release."""
        return None if self.ack is None else self.ack.obeyed

    def on_state(self, state: RobotState, now: float) -> None:
        self.before, self.state = self.state, state
        self.state_gap_s, self.state_at = now - self.state_at, now

    def on_ack(self, ack: Ack, now: float) -> None:
        self.ack, self.acked_at = ack, now
        if driver(ack) is not None:
            self.obeyed_at = now


@dataclass
class Contest:
    """Who competes for the wheels: tokens, bids, claims."""

    alive: dict[str, float] = field(default_factory=dict)  # time of its token, by instance
    bids: dict[str, tuple[float, BidRecord]] = field(default_factory=dict)
    sees_bids: bool = False
    claims: dict[Ballot, tuple[float, float, Claim]] = field(default_factory=dict)
    stood_back_at: float = -inf  # when a tenure without obedience was last released
    nonsense_back_at: float = -inf  # likewise, with nonsense bids and no other bidder

    def on_bids(self, seen: Bids, now: float) -> None:
        self.sees_bids = True
        self.bids[seen.instance] = (now - seen.age, seen.record)

    def on_left(self, instance: str) -> None:
        self.bids.pop(instance, None)
        self.alive.pop(instance, None)

    def instances(self, name: str) -> list[str]:
        """The instances of an agent that are alive, the oldest first."""
        return [
            one for one in sorted(self.alive, key=self.alive.__getitem__) if agent_of(one) == name
        ]


@dataclass
class Body:
    """The robot's true state, its pose's error, and how near obstacles are."""

    truth: Truth | None = None
    truth_at: float = -inf
    moved_at: float = -inf
    rested_at: float = -inf
    astray_at: float = -inf  # when the pose was last wrong beyond its covariance
    _truths: dict[Cycle, Truth] = field(default_factory=dict)  # of the last cycles

    def truth_of(self, cycle: Cycle) -> Truth | None:
        """The true state in one of the last cycles."""
        return self._truths.get(cycle)

    def on_state(self, state: RobotState, now: float) -> None:
        if self.truth is not None:
            self._truths[state.cycle] = self.truth
            if len(self._truths) > POSES:
                del self._truths[next(iter(self._truths))]
        if moves(state.v, state.w):
            self.moved_at = now

    def on_truth(self, truth: Truth, now: float) -> None:
        self.truth, self.truth_at = truth, now
        if not moves(truth.v, truth.w):
            self.rested_at = now

    def on_pose(self, pose: Pose, now: float) -> None:
        most, most_rad = may_be_off(pose)
        truth = self.truth_of(pose.cycle) or self.truth
        if truth is not None:
            off = hypot(pose.x - truth.x, pose.y - truth.y)
            if off > most or abs(wrap(pose.theta - truth.theta)) > most_rad:
                self.astray_at = now

    def stops_in_s(self, bounds: Bounds) -> float:
        """Time needed to stop if an obstacle is within the stopping distance; else 0.

        It includes a turn of the sonars, reacting, and braking.
        """
        truth = self.truth
        if truth is None:
            return OVER_S
        v, waits = abs(truth.v), SONARS_S + bounds.stop_s
        needs = v * waits + v * v / (2.0 * bounds.v_decel) + SWUNG_M
        near = truth.clearance is not None and truth.clearance < needs
        return waits + v / bounds.v_decel if near else 0.0


@dataclass
class Faults:
    """The active faults, and what follows from those that are over.

    The network is whole or broken, the robot free or excused from moving: each by its time.
    """

    active: Counter[Fault] = field(default_factory=Counter)
    whole_since: float = inf  # inf while a fault breaks the network
    free_since: float = inf  # inf while a fault or a stop excuses the robot from moving
    healed_at: float = -inf  # end of the last excuse
    hindered_at: float = -inf  # when the last fault that excuses from outcomes ended
    waits_since: float = inf  # when the first order was written that has not arrived
    slowest: tuple[float, float] = (inf, inf)  # |v| and |w| of the orders since
    written: tuple[float, float] = (inf, inf)  # of the newest order
    arrived: tuple[float, float] = (inf, inf)  # of the newest that arrived; inf: not observed
    unable_until: float = -inf  # until when a robot that could not act may still be braking
    unable_why: str = ""
    again_at: float = -inf  # when a robot agent that was refused, and is absent, tries again
    _ended: dict[Promise, tuple[float, str]] = field(default_factory=dict)  # by faults now over

    def begin(self, now: float) -> None:
        """The first observation: whole and free, until a fault begins."""
        if self.whole_since == inf and not self.active:
            self.whole_since = self.free_since = now

    def on_fault(self, fault: Faulted, now: float, stops_in_s: float) -> None:
        if not fault.began:
            self._recovers(now, stops_in_s)
        key = Fault(fault.kind, fault.targets, fault.to, fault.amount)
        self.active[key] += 1 if fault.began else -1
        self.active += Counter()  # drops zero counts
        if not fault.began:
            if hinders(fault.kind, fault.amount):
                self.hindered_at = now
            taken = voided(fault.kind, fault.amount)
            self._ended.update({promise: (now, why) for promise, why in taken.items()})
        if any(KINDS[fault.kind].breaks for fault in self.active):
            self.whole_since = inf
        elif self.whole_since == inf:
            self.whole_since = max(now, self.again_at)

    def excuse(self, now: float, *, stopped: bool) -> None:
        """Set the time from which the robot has to move again."""
        if stopped or any(KINDS[fault.kind].excuses for fault in self.active):
            self.free_since = inf
        elif self.free_since == inf:
            self.free_since = self.healed_at = max(now, self.again_at)

    def voids(self, promise: Promise, now: float, rested_at: float) -> str:
        """The fault that voids a promise, in words, or that did just before; "" without one."""
        for fault in self.active:
            why = voided(fault.kind, fault.amount).get(promise)
            if why:
                return why
        ended, why = self._ended.get(promise, (-inf, ""))
        rested = ended <= rested_at < now  # the cause of the rest is over, too
        return f"{JUST_AFTER}{why}" if now - ended < OVER_S and not rested else ""

    def on_order(self, order: Ordered, now: float) -> None:
        """Process that an order was written to the line."""
        self.waits_since = min(self.waits_since, now)
        self.written = v, w = abs(order.v), abs(order.w)
        self.slowest = min(self.slowest[0], v), min(self.slowest[1], w)

    def on_arrival(self, now: float, stops_in_s: float) -> None:
        """Process that an order has arrived at the controller."""
        self._recovers(now, stops_in_s)
        self.waits_since, self.slowest, self.arrived = inf, (inf, inf), self.written

    def _recovers(self, now: float, stops_in_s: float) -> None:
        if why := self._line_fails(now):
            self.unable_until, self.unable_why = now + stops_in_s, why

    def _line_fails(self, now: float) -> str:
        """The fault by which an order to go slower has not arrived for as long as acting may take.

        "" if it did, or if the robot agent ordered none: then the line has prevented nothing.
        """
        slower = (new < old for new, old in zip(self.slowest, self.arrived, strict=True))
        if not any(slower):
            return ""
        kinds = [fault for fault in self.active if now - self.waits_since > STOPS_S]
        whys = (voided(f.kind, f.amount).get(Promise.COLLISION, "") for f in kinds)
        return next(filter(None, whys), "")

    def unable(self, now: float) -> str:
        """Why the robot's braking does not arrive, or did not just before; "" if it does.

        Just before: until it has braked, if an obstacle was within its stopping distance.
        """
        if why := self._line_fails(now):
            return why
        return f"{JUST_AFTER}{self.unable_why}" if now <= self.unable_until else ""

    @property
    def alters_readings(self) -> bool:
        """Whether a fault makes readings wrong."""
        voids = (voided(fault.kind, fault.amount) for fault in self.active)
        return any(Promise.SENSORS in taken for taken in voids)

    def befalls(self, name: str, *kinds: str) -> bool:
        """Whether a fault of one of these kinds is active on an agent."""
        return any(fault.kind in kinds and name in fault.targets for fault in self.active)

    def troubled(self, but: str) -> bool:
        """Whether a fault of another kind than this is active."""
        return any(fault.kind != but for fault in self.active)

    def bids_nonsense(self, instance: str) -> bool:
        """Whether an instance's bids are replaced by nonsense, so that they do not count."""
        return self.befalls(agent_of(instance), "nan")


@dataclass
class Record:
    """The state after each observation, updated before promises are checked."""

    bounds: Bounds = field(default_factory=Bounds)
    now: float = -inf
    driving: bool = False
    owner: Owner = field(default_factory=Owner)
    contest: Contest = field(default_factory=Contest)
    body: Body = field(default_factory=Body)
    faults: Faults = field(default_factory=Faults)
    kept: Kept = field(default_factory=Kept)

    def update(self, seen: Observation) -> None:
        """Process one observation. A late one counts as of now."""
        self.faults.begin(seen.at)
        if not (
            self.bounds.command_delay_s
            and isinstance(seen, Published)
            and isinstance(seen.message, Command)
        ):
            self.now = max(self.now, seen.at)  # commands precede their turn (`EARLIER_S` in live)
        if isinstance(seen, Published):
            self._on_message(seen)
        elif isinstance(seen, Faulted):
            self.faults.on_fault(seen, self.now, self.body.stops_in_s(self.bounds))
            self.faults.excuse(self.now, stopped=self.owner.stopped())
        elif isinstance(seen, Ordered):
            self.owner.ordered = seen
            self.faults.on_order(seen, self.now)
            self.kept.orders.append((self.now, seen))
        elif isinstance(seen, Arrived):
            self.faults.on_arrival(self.now, self.body.stops_in_s(self.bounds))
        elif isinstance(seen, Bids):
            if seen.record.resource == WHEELS.name:
                self.contest.on_bids(seen, self.now)
        elif isinstance(seen, Denied):
            self._deny(seen)
        elif isinstance(seen, Came):
            self.contest.alive.setdefault(seen.instance, self.now)
        elif isinstance(seen, Left):
            self.contest.on_left(seen.instance)

    # State ---------------------------------------------------------------------------------------

    def whole_for(self) -> float:
        """Seconds since a fault last broke the network; negative during one."""
        return self.now - self.faults.whole_since

    def void(self, promise: Promise) -> bool:
        """Whether a fault voids the promise, now or until the robot has recovered."""
        return bool(self.reason(promise))

    def reason(self, promise: Promise) -> str:
        """What voids the promise, in a word; "" if nothing does."""
        return self.faults.voids(promise, self.now, self.body.rested_at)

    def unable(self) -> str:
        """Why an order of the robot agent to go slower has no effect, in words; "" if it has."""
        return self.faults.unable(self.now)

    def nonsense_in_vain(self, most: float) -> bool:
        """Whether a nonsense bidder claims without being obeyed, for at most so long.

        All others wait until it releases.
        """
        return any(
            self.faults.bids_nonsense(ballot.instance)
            and ballot != self.owner.obeyed
            and self.now - last <= BID_AGE_S
            and self.now - first <= most
            for ballot, (first, last, _) in self.contest.claims.items()
        )

    def bidders(self) -> list[str]:
        """Instances that bid, as far as observed: by their bids, else by their claims."""
        if self.contest.sees_bids:
            return [
                instance
                for instance, (at, record) in self.contest.bids.items()
                if record.utility
                and self.now - at <= BID_AGE_S
                and not self.faults.bids_nonsense(instance)
            ]
        recent = [
            b for b, (_, last, _) in self.contest.claims.items() if self.now - last <= BID_AGE_S
        ]
        return [ballot.instance for ballot in recent]

    @property
    def cut_off(self) -> bool:
        """Whether commands may reach the robot and not the observer: real links are cut."""
        return self.bounds.command_delay_s > 0.0 and any(
            f.kind == "partition" for f in self.faults.active
        )

    @property
    def driver(self) -> str | None:
        """The instance that is obeyed now; None without one, or if the owner is silent."""
        silent = self.owner.ack is None or self.now - self.owner.acked_at > SILENT_S
        return None if self.owner.ack is None or silent else driver(self.owner.ack)

    def on_its_way(self) -> bool:
        """Whether a command is obeyed and the robot truly drives."""
        return (
            self.body.truth is not None
            and self.body.truth.v > ON_ITS_WAY_M_S
            and self.driver is not None
        )

    def bids_lately(self, instance: str) -> bool:
        """Whether a bid of an instance was received lately, on real processes by a query."""
        at, record = self.contest.bids.get(instance, (-inf, None))
        return record is not None and self.now - at <= QUERIED_S and bool(record.utility)

    # Updates -------------------------------------------------------------------------------------

    def _on_message(self, seen: Published) -> None:
        message, now = seen.message, self.now
        if isinstance(message, RobotState):
            self.owner.on_state(message, now)
            self.body.on_state(message, now)
            self.faults.excuse(now, stopped=self.owner.stopped())
            claims = self.contest.claims
            self.contest.claims = {b: c for b, c in claims.items() if now - c[1] < 2.0}
        elif isinstance(message, Ack):
            if message.resource == WHEELS.name:
                self.kept.acks.append((now, message))
                self.owner.on_ack(message, now)
        elif isinstance(message, Claim):
            self._claim(message)
        elif isinstance(message, MissionStatus):
            self.driving = message.state is MissionState.DRIVING
        elif isinstance(message, Pose):
            self.body.on_pose(message, now)
        elif isinstance(message, Command):
            self.kept.commands.append((seen.at, message))
        elif isinstance(message, Log):
            self.kept.logs.append((now, message))
        elif isinstance(message, Truth):
            self.kept.truths.append((now, message))
            self.body.on_truth(message, now)

    def _claim(self, claim: Claim) -> None:
        if claim.utility is None:
            self.contest.claims.pop(claim.ballot, None)
            if self._stands_back(claim.ballot):
                self.contest.stood_back_at = self.now
                if self.faults.bids_nonsense(claim.ballot.instance) and not self.bidders():
                    self.contest.nonsense_back_at = self.now
            return
        first, last, _ = self.contest.claims.get(claim.ballot, (self.now, self.now, claim))
        if self.now - last > BID_AGE_S:  # it was away, and starts anew
            first = self.now
        self.contest.claims[claim.ballot] = (first, self.now, claim)

    def _stands_back(self, released: Ballot) -> bool:
        """Whether a release is for lack of obedience, as far as the holder knows: it still bids.

        With slow acks it may have been obeyed without knowing.
        """
        if not self.contest.sees_bids:
            return self.owner.obeyed != released
        _, record = self.contest.bids.get(released.instance, (0.0, None))
        bids = record is not None and bool(record.utility)
        return bids and (self.owner.obeyed != released or self.whole_for() < ACKS_S)

    def _deny(self, denied: Denied) -> None:
        """While a fault breaks the network, another process may block a robot agent."""
        there = self.now - self.owner.state_at <= SILENT_S
        if self.faults.whole_since == inf and not there and agent_of(denied.instance) == "robot":
            self.faults.again_at = denied.at + AGAIN_S
