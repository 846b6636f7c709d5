"""What follows from the observations of a society: one record for every back end.

`Record` has the state for the promises and the figures of trials: active faults, the cycle, claims,
bids, obeyed commands. Times are in seconds, by one clock of the observer; -inf: never.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from math import hypot, inf
from typing import Final, Generic, NamedTuple, TypeVar

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
from armadico_tools.faults.kept import Kept
from armadico_tools.faults.observations import (
    Bids,
    Came,
    Denied,
    Faulted,
    Left,
    Observation,
    Ordered,
    Published,
)

T = TypeVar("T")

# The record -------------------------------------------------------------------------------------

MOVING_M_S = 0.02
MOVING_RAD_S = 0.05
"""Faster than this counts as moving; it is above the noise of encoders at rest."""

SIGMAS = 3.0
"""A pose is wrong if its error exceeds this many of its standard deviations plus `ALLOWED_*`."""

ALLOWED_M, ALLOWED_RAD = 0.15, 0.15
"""Tolerance of a goal, and of a direction to an obstacle at 1 m."""

ASTRAY_S = 5.0
"""Contacts are void while the pose is wrong beyond its covariance, and for this time after, s; also
for this time after a restart of the sonar agent, which has forgotten obstacles behind the robot."""

OVER_S = 2.0
"""A fault's voids end after this time, s, if the robot has not come to rest before."""

JUST_AFTER = "just after: "

SWUNG_M = 0.1
"""A corner of the body may swing out by this, m, in addition to the stopping distance."""

SONARS_S = 0.4
"""Time for a turn of the sonar ring: four cycles."""

FRESH_CYCLES = 3
"""A command may be for a cycle so many older than the newest (docs/coordination.md)."""

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


def may_be_off(pose: Pose) -> tuple[float, float]:
    """The error allowed by a pose's covariance, m and rad; infinite if it is lost."""
    if pose.deviation > LOST_M:
        return inf, inf
    return SIGMAS * pose.deviation + ALLOWED_M, SIGMAS * pose.heading_deviation + ALLOWED_RAD


@dataclass(frozen=True)
class Bounds:
    """The numbers of the promises, SI units."""

    stop_s: float = 0.4  # from the last valid command to the stop
    command_delay_s: float = 0.0  # a command may be received this much after its order
    overlap_s: float = 0.5  # two tenures in a whole network: 5 cycles
    obeyed_s: float = 5.0
    moves_s: float = 2.0
    stood_back_s: float = 5.0
    watchdog_s: float = 2.0
    killed_s: float = 0.1  # from a holder's end to another's obeyed command: far below its silence
    silent_s: float = 0.3  # from a silent holder's last to another's first: before the stop
    unobeyed_s: float = 0.9  # where the other still receives it: 6 cycles, and delays
    arrives_s: float = 90.0  # from the last fault
    start_s: float = 20.0  # for a mission without faults, in addition to its way
    way_m_s: float = 0.25  # speed on its way: the slowest ever took two thirds of this time
    skew_s: float = 0.25  # between two messages of one cycle: a cycle, and two delays
    v_max: float = 1.6  # m/s
    w_max: float = 5.2  # rad/s
    braking_s: float = 3.0  # from top speed to rest, by the ramp, and for the loops to settle
    v_decel: float = 0.6  # m/s^2, by the ramp
    v_accel: float = 0.9  # m/s^2: 1.5 times the steepest ramp, for the overshoot of the loops
    w_accel: float = 2.7  # rad/s^2, likewise
    way_error: float = 0.0  # error of the wheels' counts, m per metre
    drift_rad_m: float = 0.0  # of the heading, rad per metre
    turn_error: float = 0.0  # of a turn, rad per rad


def bounds_of(scenario: Scenario) -> Bounds:
    """The bounds for a scenario's robot: ramps, watchdog, errors of the odometry.

    Raises ConfigError for an unknown robot.
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
class Newest(Generic[T]):
    """The newest message of a kind, and the one before."""

    item: T | None = None
    before: T | None = None
    at: float = -inf
    gap_s: float = inf  # between the two

    def add(self, item: T, at: float) -> None:
        self.before, self.item = self.item, item
        self.gap_s, self.at = at - self.at, at


@dataclass
class Last:
    """When something was last so."""

    obeyed: float = -inf  # an ack showed a recent command obeyed
    moved: float = -inf
    rested: float = -inf
    stood_back: float = -inf  # a tenure without obedience was released
    nonsense_back: float = -inf  # likewise, with nonsense bids and no other bidder
    astray: float = -inf  # the pose was wrong beyond its covariance
    lost: float = -inf  # the pose was reported as lost
    forgot: float = -inf  # the sonar agent started with an empty map
    wedged: float = -inf  # a fault held it near an obstacle; -inf: clear


@dataclass
class Faults:
    """The active faults, and what they excuse."""

    active: Counter[Fault] = field(default_factory=Counter)
    ended_at: float = -inf  # when the last fault of any kind ended
    ended: dict[Promise, tuple[float, str]] = field(default_factory=dict)  # by faults now over
    whole_since: float = inf  # inf while a fault breaks the network
    free_since: float = inf  # inf while a fault or a stop excuses the robot from moving
    healed_at: float = -inf  # end of the last excuse
    excused: bool = True
    left_near_until: float = -inf  # until when a contact may be the result of a fault
    again_at: float = -inf  # when a robot agent that was refused, and is absent, tries again

    def befalls(self, name: str, *kinds: str) -> bool:
        """Whether a fault of one of these kinds is active on an agent."""
        return any(fault.kind in kinds and name in fault.targets for fault in self.active)

    def troubled(self, but: str) -> bool:
        """Whether a fault of another kind than this is active."""
        return any(fault.kind != but for fault in self.active)

    def count(self, fault: Faulted) -> None:
        """Process the beginning or the end of a fault."""
        key = Fault(fault.kind, fault.targets, fault.to, fault.amount)
        self.active[key] += 1 if fault.began else -1
        self.active += Counter()  # drops zero counts

    def excuse(self, now: float, *, stopped: bool) -> None:
        """Set the time from which the robot has to move again."""
        if stopped or any(KINDS[fault.kind].excuses for fault in self.active):
            self.free_since, self.excused = inf, True
        elif self.excused:
            self.excused = False
            self.free_since = self.healed_at = max(now, self.again_at)


@dataclass
class Record:
    """The state after each observation, updated before promises are checked."""

    bounds: Bounds = field(default_factory=Bounds)
    kept: Kept = field(default_factory=Kept)
    faults: Faults = field(default_factory=Faults)
    last: Last = field(default_factory=Last)
    alive: dict[str, float] = field(default_factory=dict)  # time of its token, by instance
    now: float = -inf
    states: Newest[RobotState] = field(default_factory=Newest)  # of any epoch
    acks: Newest[Ack] = field(default_factory=Newest)  # of the wheels
    truths: Newest[Truth] = field(default_factory=Newest)
    ordered: Ordered | None = None
    driving: bool = False
    bids: dict[str, tuple[float, BidRecord]] = field(default_factory=dict)
    sees_bids: bool = False
    claims: dict[Ballot, tuple[float, float, Claim]] = field(default_factory=dict)
    _truths: dict[Cycle, Truth] = field(default_factory=dict)  # of the last cycles

    def update(self, seen: Observation) -> None:
        """Process one observation. A late one counts as of now."""
        faults = self.faults
        if faults.whole_since == inf and not faults.active:
            faults.whole_since = faults.free_since = seen.at
            faults.excused = False
        if not (
            self.bounds.command_delay_s
            and isinstance(seen, Published)
            and isinstance(seen.message, Command)
        ):
            self.now = max(self.now, seen.at)  # commands precede their turn (`EARLIER_S` in live)
        match seen:
            case Published():
                self._on_message(seen)
            case Faulted():
                self._fault(seen)
            case Ordered():
                self.ordered = seen
                self.kept.orders.append((self.now, seen))
            case Bids():
                self.sees_bids = True
                self.bids[seen.instance] = (self.now - seen.age, seen.record)
            case Denied():
                self._deny(seen)
            case Came():
                self.alive.setdefault(seen.instance, self.now)
            case Left():
                self.bids.pop(seen.instance, None)
                self.alive.pop(seen.instance, None)

    # State ---------------------------------------------------------------------------------------

    @property
    def state(self) -> RobotState | None:
        return self.states.item

    @property
    def ack(self) -> Ack | None:
        """The newest ack of the wheels."""
        return self.acks.item

    @property
    def truth(self) -> Truth | None:
        return self.truths.item

    def age(self, cycle: Cycle) -> float:
        """The number of cycles before the newest; inf in another epoch."""
        return age(cycle, None if self.state is None else self.state.cycle)

    def truth_of(self, cycle: Cycle) -> Truth | None:
        """The true state in one of the last cycles."""
        return self._truths.get(cycle)

    def whole_for(self) -> float:
        """Seconds since a fault last broke the network; negative during one."""
        return self.now - self.faults.whole_since

    def unsure_for(self) -> float:
        """Seconds since the pose was last lost, or wrong beyond its covariance."""
        return self.now - max(self.last.astray, self.last.lost)

    def void(self, promise: Promise) -> bool:
        """Whether a fault voids the promise, now or until the robot has recovered."""
        return bool(self.reason(promise))

    def reason(self, promise: Promise) -> str:
        """What voids the promise, in a word; "" if nothing does.

        A robot with a wrong pose steers into door posts. Without localization that follows an
        absence of the robot agent.
        """
        if promise is not Promise.COLLISION:
            return self._fault_voids(promise)
        wedged = self.now - self.last.wedged < WEDGED_S
        return self._contact_voids() or ("wedged" if wedged else "")

    def contact_reason(self) -> str:
        """What voids a contact, in a word; "": nothing does.

        Just after a fault, contacts are void if the robot could not have stopped in time.
        """
        why = self.reason(Promise.COLLISION)
        return "" if why.startswith(JUST_AFTER) and self.now > self.faults.left_near_until else why

    def _contact_voids(self) -> str:
        fault = self._fault_voids(Promise.COLLISION)
        if fault:
            return fault
        if self.now - self.last.astray < ASTRAY_S:
            return "pose"
        return "sonar agent restarted" if self.now - self.last.forgot < ASTRAY_S else ""

    def _fault_voids(self, promise: Promise) -> str:
        for fault in self.faults.active:
            why = voided(fault.kind, fault.targets, fault.amount).get(promise)
            if why:
                return why
        ended, why = self.faults.ended.get(promise, (-inf, ""))
        rested = ended <= self.last.rested < self.now  # the cause of the rest is over, too
        return f"{JUST_AFTER}{why}" if self.now - ended < OVER_S and not rested else ""

    def bids_nonsense(self, instance: str) -> bool:
        """Whether an instance's bids are replaced by nonsense, so that they do not count."""
        return self.faults.befalls(agent_of(instance), "nan")

    def nonsense_in_vain(self, most: float) -> bool:
        """Whether a nonsense bidder claims without being obeyed, for at most so long.

        All others wait until it releases.
        """
        return any(
            self.bids_nonsense(ballot.instance)
            and ballot != self.obeyed
            and self.now - last <= BID_AGE_S
            and self.now - first <= most
            for ballot, (first, last, _) in self.claims.items()
        )

    def driven(self) -> bool:
        """Whether a command is obeyed, by the newest ack."""
        return self.last.obeyed >= self.acks.at

    def stopped(self) -> bool:
        """Whether `robot/stop` is latched."""
        return self.state is not None and self.state.stop.stopped

    @property
    def obeyed(self) -> Ballot | None:
        """The ballot of the last command acknowledged as obeyed; None since a release."""
        return None if self.ack is None else self.ack.obeyed

    def bidders(self) -> list[str]:
        """Instances that bid, as far as observed: by their bids, else by their claims."""
        if self.sees_bids:
            return [
                instance
                for instance, (at, record) in self.bids.items()
                if record.utility
                and self.now - at <= BID_AGE_S
                and not self.bids_nonsense(instance)
            ]
        recent = [b for b, (_, last, _) in self.claims.items() if self.now - last <= BID_AGE_S]
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
        silent = self.ack is None or self.now - self.acks.at > SILENT_S
        return None if self.ack is None or silent else driver(self.ack)

    def on_its_way(self) -> bool:
        """Whether a command is obeyed and the robot truly drives."""
        return self.truth is not None and self.truth.v > ON_ITS_WAY_M_S and self.driver is not None

    def bids_lately(self, instance: str) -> bool:
        """Whether a bid of an instance was received lately, on real processes by a query."""
        at, record = self.bids.get(instance, (-inf, None))
        return record is not None and self.now - at <= QUERIED_S and bool(record.utility)

    def instances(self, name: str) -> list[str]:
        """The instances of an agent that are alive, the oldest first."""
        return [
            one for one in sorted(self.alive, key=self.alive.__getitem__) if agent_of(one) == name
        ]

    # Updates -------------------------------------------------------------------------------------

    def _on_message(self, seen: Published) -> None:
        match message := seen.message:
            case RobotState():
                self._cycle(message)
            case Ack():
                self._acked(message)
            case Claim():
                self._claim(message)
            case MissionStatus():
                self.driving = message.state is MissionState.DRIVING
            case Pose():
                self._posed(message)
            case Command():
                self.kept.commands.append((seen.at, message))
            case Log():
                self.kept.logs.append((self.now, message))
            case Truth():
                self._truth(message)

    def _truth(self, truth: Truth) -> None:
        self.truths.add(truth, self.now)
        self.kept.truths.append((self.now, truth))
        near = truth.clearance is not None and truth.clearance < WEDGED_M
        if not near:
            self.last.wedged = -inf
        elif self._contact_voids():
            self.last.wedged = self.now
        if abs(truth.v) < MOVING_M_S and abs(truth.w) < MOVING_RAD_S:
            self.last.rested = self.now

    def _posed(self, pose: Pose) -> None:
        most, most_rad = may_be_off(pose)
        truth = self.truth_of(pose.cycle) or self.truth
        if most == inf:
            self.last.lost = self.now
        elif truth is not None:
            off = hypot(pose.x - truth.x, pose.y - truth.y)
            if off > most or abs(wrap(pose.theta - truth.theta)) > most_rad:
                self.last.astray = self.now

    def _cycle(self, state: RobotState) -> None:
        self.states.add(state, self.now)
        if self.truth is not None:
            self._truths[state.cycle] = self.truth
            if len(self._truths) > POSES:
                del self._truths[next(iter(self._truths))]
        if abs(state.v) >= MOVING_M_S or abs(state.w) >= MOVING_RAD_S:
            self.last.moved = self.now
        self.faults.excuse(self.now, stopped=self.stopped())
        self.claims = {b: c for b, c in self.claims.items() if self.now - c[1] < 2.0}

    def _acked(self, ack: Ack) -> None:
        if ack.resource != WHEELS.name:
            return
        self.kept.acks.append((self.now, ack))
        self.acks.add(ack, self.now)
        if driver(ack) is not None:
            self.last.obeyed = self.now

    def _claim(self, claim: Claim) -> None:
        if claim.utility is None:
            self.claims.pop(claim.ballot, None)
            if self._stands_back(claim.ballot):
                self.last.stood_back = self.now
                if self.bids_nonsense(claim.ballot.instance) and not self.bidders():
                    self.last.nonsense_back = self.now
            return
        first, last, _ = self.claims.get(claim.ballot, (self.now, self.now, claim))
        if self.now - last > BID_AGE_S:  # it was away, and starts anew
            first = self.now
        self.claims[claim.ballot] = (first, self.now, claim)

    def _stands_back(self, released: Ballot) -> bool:
        """Whether a release is for lack of obedience, as far as the holder knows: it still bids.

        With slow acks it may have been obeyed without knowing.
        """
        if not self.sees_bids:
            return self.obeyed != released
        _, record = self.bids.get(released.instance, (0.0, None))
        bids = record is not None and bool(record.utility)
        return bids and (self.obeyed != released or self.whole_for() < ACKS_S)

    def _fault(self, fault: Faulted) -> None:
        faults = self.faults
        faults.count(fault)
        if not fault.began:
            faults.ended_at = self.now
            taken = voided(fault.kind, fault.targets, fault.amount)
            if Promise.COLLISION in taken:
                faults.left_near_until = self.now + self._stops_in_s()
            faults.ended.update({promise: (self.now, why) for promise, why in taken.items()})
            if fault.kind in FORGETS and "sonar" in fault.targets:
                self.last.forgot = self.now
        if any(KINDS[fault.kind].breaks for fault in faults.active):
            faults.whole_since = inf
        elif faults.whole_since == inf:
            faults.whole_since = max(self.now, faults.again_at)
        faults.excuse(self.now, stopped=self.stopped())

    def _stops_in_s(self) -> float:
        """Time needed to stop if an obstacle is within the stopping distance; else 0.

        It includes a turn of the sonars, reacting, and braking.
        """
        truth, bounds = self.truth, self.bounds
        if truth is None:
            return OVER_S
        v, waits = abs(truth.v), SONARS_S + bounds.stop_s
        needs = v * waits + v * v / (2.0 * bounds.v_decel) + SWUNG_M
        near = truth.clearance is not None and truth.clearance < needs
        return waits + v / bounds.v_decel if near else 0.0

    def _deny(self, denied: Denied) -> None:
        """While a fault breaks the network, another process may block a robot agent."""
        there = self.now - self.states.at <= SILENT_S
        if self.faults.whole_since == inf and not there and agent_of(denied.instance) == "robot":
            self.faults.again_at = denied.at + AGAIN_S
