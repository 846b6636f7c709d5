"""What an onlooker knows: which faults are on, what cycle it is, who claims, bids and is obeyed."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from math import hypot, inf

from armadico.config.profile import RobotProfile
from armadico.messages import (
    Ballot,
    BidRecord,
    Claim,
    Cycle,
    MissionState,
    MissionStatus,
    Pose,
    RobotState,
    Truth,
)
from armadico.tools.faults.kinds import FORGETS, KINDS, WEDGED_M, Promise, voided
from armadico.tools.faults.observations import Bids, Faulted, Left, Observation, Ordered, Said

MOVING_M_S = 0.02
MOVING_RAD_S = 0.05
"""Faster than this is moving: above the noise of encoders at rest."""

ASTRAY_M = 0.15
ASTRAY_S = 5.0
"""With the pose farther off than this, and for so long after, sensing is not honest; nor for so
long after the sonar agent was started again, which has forgotten what was behind."""

OVER_S = 2.0
"""So long after a fault has ended its voids end too, if the robot has not come to rest before."""

FRESH_CYCLES = 3
"""A command may answer a cycle so many older than the newest (docs/architecture.md)."""

POSES = 16  # cycles whose true poses are remembered, for poses that come late

BID_AGE_S = 0.35
"""A bid older than this says nothing of now: three cycles, and the way here."""


@dataclass(frozen=True)
class Bounds:
    """The numbers of the promises, SI units."""

    stop_s: float = 0.4  # from the last valid command to the stop
    overlap_s: float = 0.5  # two tenures in a whole network: 5 cycles
    obeyed_s: float = 5.0
    moves_s: float = 2.0
    stood_back_s: float = 5.0
    watchdog_s: float = 2.0
    braking_s: float = 3.0  # from top speed to rest, by the ramp, and for the loops to settle
    v_accel: float = 0.9  # m/s^2: 1.5 times the steepest ramp, for the overshoot of the loops
    w_accel: float = 2.7  # rad/s^2, likewise


def bounds_of(profile: RobotProfile) -> Bounds:
    """The bounds for a robot: its ramps and its watchdog."""
    limits = profile.limits
    return Bounds(
        watchdog_s=profile.p2os.watchdog_s,
        v_accel=OVERSHOOT * max(limits.v_accel, limits.v_decel),
        w_accel=OVERSHOOT * max(limits.w_accel, limits.w_decel),
    )


OVERSHOOT = 1.5
"""Of the speed loops over the ramp that they follow, within a cycle."""


@dataclass
class Situation:
    """Taken in before the promises are looked at."""

    now: float = -inf
    whole_since: float = inf  # inf while a fault breaks the network
    healed_at: float = -inf  # when the last fault that broke it ended
    state: RobotState | None = None
    before: RobotState | None = None  # the state before that, of whatever epoch
    state_at: float = -inf
    obeyed_at: float = -inf  # when the echo last showed somebody obeyed of late
    moved_at: float = -inf
    rested_at: float = -inf
    released_at: float = -inf  # when the stop was last released
    stood_back_at: float = -inf  # when a tenure that was not obeyed was last let go of
    truth: Truth | None = None
    truth_at: float = -inf
    astray_at: float = -inf  # when pose or map were last known to be wrong
    wedged: bool = False  # a fault has brought it against something, and it has not got clear
    driving: bool = False
    bids: dict[str, tuple[float, BidRecord]] = field(default_factory=dict)
    sees_bids: bool = False
    claims: dict[Ballot, tuple[float, float, Claim]] = field(default_factory=dict)
    ordered: Ordered | None = None
    active: Counter[tuple[str, tuple[str, ...]]] = field(default_factory=Counter)
    _ended: dict[Promise, float] = field(default_factory=dict)  # voids of faults that are over
    _truths: dict[Cycle, Truth] = field(default_factory=dict)  # where it was in the last cycles

    def take(self, seen: Observation) -> None:
        """Learn from one observation."""
        if self.whole_since == inf and not self.active:
            self.whole_since = seen.at
        self.now = seen.at
        if isinstance(seen, Said):
            self._hear(seen)
        elif isinstance(seen, Faulted):
            self._fault(seen)
        elif isinstance(seen, Ordered):
            self.ordered = seen
        elif isinstance(seen, Bids):
            self.sees_bids = True
            self.bids[seen.instance] = (seen.at - seen.age, seen.record)
        elif isinstance(seen, Left):
            self.bids.pop(seen.instance, None)

    def age(self, cycle: Cycle) -> float:
        """How many cycles before the newest; inf in another epoch."""
        state = self.state
        if state is None or cycle.epoch != state.cycle.epoch:
            return inf
        return state.cycle.number - cycle.number

    def whole_for(self) -> float:
        """Seconds for which nothing has broken the network; negative while something does."""
        return self.now - self.whole_since

    def void(self, promise: Promise) -> bool:
        """Whether a fault takes the promise away, now or until the robot is itself again.

        Whoever thinks that it is elsewhere steers into door posts: without localization that is
        what a robot agent that was away leaves behind.
        """
        if promise is Promise.COLLISION and self.wedged:
            return True
        return self._voided(promise)

    def _voided(self, promise: Promise) -> bool:
        if promise is Promise.COLLISION and self.now - self.astray_at < ASTRAY_S:
            return True
        if any(promise in voided(kind, whom) for kind, whom in self.active):
            return True
        ended = self._ended.get(promise, -inf)
        rested = ended <= self.rested_at < self.now  # what brought it to rest is over, too
        return self.now - ended < OVER_S and not rested

    def befalls(self, who: str, *kinds: str) -> bool:
        """Whether a fault of one of these kinds befalls an agent now."""
        return any(kind in kinds and who in whom for kind, whom in self.active)

    def mad(self, instance: str) -> bool:
        """Whether an instance's bids are made to be nonsense: they count for nothing."""
        return self.befalls(instance.rpartition("-")[0], "nan")

    def driven(self) -> bool:
        """Whether somebody is obeyed, by the newest echo."""
        return self.obeyed_at >= self.state_at

    def stopped(self) -> bool:
        """Whether `robot/stop` is latched."""
        return self.state is not None and self.state.stop.stopped

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

    def _hear(self, said: Said) -> None:
        message = said.message
        if isinstance(message, RobotState):
            self._cycle(message)
        elif isinstance(message, Claim):
            self._claim(message)
        elif isinstance(message, MissionStatus):
            self.driving = message.state is MissionState.DRIVING
        elif isinstance(message, Pose):
            truth = self._truths.get(message.cycle, self.truth)
            if truth is not None and hypot(message.x - truth.x, message.y - truth.y) > ASTRAY_M:
                self.astray_at = said.at
        elif isinstance(message, Truth):
            self.truth, self.truth_at = message, said.at
            near = message.clearance is not None and message.clearance < WEDGED_M
            self.wedged = near and (self.wedged or self._voided(Promise.COLLISION))
            if abs(message.v) < MOVING_M_S and abs(message.w) < MOVING_RAD_S:
                self.rested_at = said.at

    def _cycle(self, state: RobotState) -> None:
        before, self.before, self.state = self.state, self.state, state
        self.state_at = self.now
        if self.truth is not None:
            self._truths[state.cycle] = self.truth
            if len(self._truths) > POSES:
                del self._truths[next(iter(self._truths))]
        at = state.obeyed_cycle
        if at is not None and state.cycle.number - at.number <= FRESH_CYCLES:
            self.obeyed_at = self.now
        if abs(state.v) >= MOVING_M_S or abs(state.w) >= MOVING_RAD_S:
            self.moved_at = self.now
        if before is not None and before.stop.stopped and not state.stop.stopped:
            self.released_at = self.now
        self.claims = {b: c for b, c in self.claims.items() if self.now - c[1] < 2.0}

    def _claim(self, claim: Claim) -> None:
        if claim.utility is None:
            self.claims.pop(claim.ballot, None)
            if self.state is None or self.state.obeyed != claim.ballot:
                self.stood_back_at = self.now
            return
        first, last, _ = self.claims.get(claim.ballot, (self.now, self.now, claim))
        if self.now - last > BID_AGE_S:  # whoever was away goes on where it was: a new beginning
            first = self.now
        self.claims[claim.ballot] = (first, self.now, claim)

    def _fault(self, fault: Faulted) -> None:
        key = (fault.kind, fault.whom)
        self.active[key] += 1 if fault.began else -1
        self.active += Counter()  # drops what has come to nothing
        if not fault.began:
            self._ended.update(dict.fromkeys(voided(*key), self.now))
            if fault.kind in FORGETS and "sonar" in fault.whom:
                self.astray_at = self.now
        broken = any(KINDS[kind].breaks for kind, _ in self.active)
        if broken:
            self.whole_since = inf
        elif self.whole_since == inf:
            self.whole_since = self.healed_at = self.now
