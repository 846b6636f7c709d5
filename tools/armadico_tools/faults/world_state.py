"""What an onlooker knows: which faults are on, what cycle it is, who claims, bids and is obeyed."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from math import hypot, inf
from typing import NamedTuple

from armadico.config.loading import find, load_entry
from armadico.config.profile import SensorProfile, load_profile
from armadico.config.scenarios import Scenario
from armadico.core.messages import Ack, Ballot, BidRecord, Claim, Cycle, RobotState
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
from armadico_tools.faults.observations import (
    Bids,
    Denied,
    Faulted,
    Left,
    Observation,
    Ordered,
    Said,
)

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


class Fault(NamedTuple):
    """One that is on, as far as promises are concerned."""

    kind: str
    whom: tuple[str, ...]
    to: tuple[str, ...]
    amount: float


@dataclass
class Situation:
    """Taken in before the promises are looked at."""

    bounds: Bounds = field(default_factory=Bounds)
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

    def take(self, seen: Observation) -> None:
        if self.whole_since == inf and not self.active:
            self.whole_since = self.free_since = seen.at
            self._excused = False
        self.now = seen.at
        if isinstance(seen, Said):
            self._receive(seen)
        elif isinstance(seen, Faulted):
            self._fault(seen)
        elif isinstance(seen, Ordered):
            self.ordered = seen
        elif isinstance(seen, Bids):
            self.sees_bids = True
            self.bids[seen.instance] = (seen.at - seen.age, seen.record)
        elif isinstance(seen, Denied):
            self._deny(seen)
        elif isinstance(seen, Left):
            self.bids.pop(seen.instance, None)

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
        elif isinstance(message, Truth):
            self.truth, self.truth_at = message, seen.at
            near = message.clearance is not None and message.clearance < WEDGED_M
            if not near:
                self.wedged_at = -inf
            elif self._contact_voids():
                self.wedged_at = seen.at
            if abs(message.v) < MOVING_M_S and abs(message.w) < MOVING_RAD_S:
                self.rested_at = seen.at

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
