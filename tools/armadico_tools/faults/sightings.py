"""Situations of a society that a campaign must show, counted.

A campaign in which one of them never occurred has tested less than it claims, and fails. This
follows the "sometimes" assertions of FoundationDB's and Antithesis's simulations.
"""

from __future__ import annotations

from collections import Counter
from enum import StrEnum
from typing import Final

from armadico.core.messages import Ballot, Claim, RobotState
from armadico.mobile.messages import MissionState, MissionStatus, Truth
from armadico_tools.faults.observations import (
    Bids,
    Denied,
    Faulted,
    Left,
    Missed,
    Obeyed,
    Observation,
    Ordered,
    Published,
    Refused,
)
from armadico_tools.faults.record import Record

SILENT_S: Final = 0.2
"""A holder whose last claim is older than this, s, is silent: two of its claims are missing."""

UNCOMMANDED_S: Final = 0.28
"""A stop that is ordered this long after the last obeyed command, s, is the owner's own."""


class Sight(StrEnum):
    """A situation that a campaign must show."""

    BETTER = "a better bid takes over"
    CRITICAL = "about to collide, an equal bid takes over"
    SILENCE = "the holder is silent, and another takes over"
    VACANT = "the holder has released or is gone, and another takes over"
    BLENDED = "an exchange is blended over some cycles"
    AT_ONCE = "an exchange happens at once"
    OFFERED = "a holder offers its resource"
    RELEASED = "a holder releases in order"
    STOOD_BACK = "a holder that is not obeyed stands back"
    STALE_BALLOT = "a smaller ballot is refused"
    OLD_CYCLE = "a command for an old cycle is refused"
    OUT_OF_RANGE = "speeds beyond the robot's limits are refused"
    LISTENING = "an owner that has just started refuses"
    WHILE_STOPPED = "a command is refused because the robot is stopped"
    STOPPED = "the stop is latched while a fault is on"
    FREED = "the stop is released"
    SILENT_STOP = "no commands arrive, and the owner orders a stop"
    WATCHDOG = "without the robot agent the wheels come to rest"
    RESTARTED = "a command is obeyed in a new epoch"
    STALE_INPUT = "a bid is withheld because an input is stale"
    MISSED = "a live agent is considered gone"
    TOGETHER = "two faults are active at once"
    LOST = "the pose is wrong beyond its covariance"
    TOUCHED = "a contact occurs that is void"
    REACHED = "a mission is reached in spite of faults"
    SECOND_REFUSED = "admission refuses a second instance"


class Sightings:
    """Counts the situations of one run."""

    def __init__(self) -> None:
        self.counts: Counter[Sight] = Counter()
        self._largest: Ballot | None = None
        self._rival: tuple[float, Claim] | None = None  # the last claim, and its time
        self._gone: set[str] = set()
        self._obeyed_at = 0.0
        self._epoch: int | None = None
        self._stopped = False
        self._rolling = False  # the robot agent was away while the wheels turned
        self._resting = True
        self._lost = False
        self._touches = 0
        self._befallen = False  # whether a fault affected the present mission

    def update(self, seen: Observation, now: Record) -> None:
        """Process one observation, after the record."""
        if isinstance(seen, Published):
            self._on_message(seen, now)
        elif isinstance(seen, Refused):
            why = "WHILE_STOPPED" if seen.why == "STOPPED" else seen.why
            if why in Sight.__members__:
                self.counts[Sight[why]] += 1
        elif isinstance(seen, Obeyed):
            if self._epoch is not None and seen.cycle.epoch != self._epoch:
                self.counts[Sight.RESTARTED] += 1
            self._epoch, self._obeyed_at = seen.cycle.epoch, seen.at
        elif isinstance(seen, Ordered):
            self._ordered(seen)
        elif isinstance(seen, Faulted):
            self._befallen = True
            self.counts[Sight.TOGETHER] += seen.began and now.faults.active.total() > 1
        elif isinstance(seen, Left):
            self._gone.add(seen.instance)
        elif isinstance(seen, Missed):
            self.counts[Sight.MISSED] += 1
        elif isinstance(seen, Denied):
            self.counts[Sight.SECOND_REFUSED] += 1
        elif isinstance(seen, Bids):
            self.counts[Sight.STALE_INPUT] += seen.record.reason.startswith("no fresh")

    def _on_message(self, seen: Published, now: Record) -> None:
        message = seen.message
        if isinstance(message, Claim):
            self._claim(message, seen.at, now)
        elif isinstance(message, RobotState):
            stopped = message.stop.stopped
            self.counts[Sight.STOPPED] += (
                stopped and not self._stopped and now.faults.troubled("stop")
            )
            self.counts[Sight.FREED] += self._stopped and not stopped
            self._stopped = stopped
        elif isinstance(message, Truth):
            self._truth(message, seen.at, now)
        elif isinstance(message, MissionStatus):
            if message.state is MissionState.REACHED:
                self.counts[Sight.REACHED] += self._befallen
                self._befallen = False
            elif message.state is not MissionState.DRIVING:
                self._befallen = False
        lost = now.body.astray_at == seen.at
        self.counts[Sight.LOST] += lost and not self._lost
        self._lost = lost or (self._lost and now.now - now.body.astray_at < 1.0)

    def _claim(self, claim: Claim, at: float, now: Record) -> None:
        if self._largest is None or claim.ballot > self._largest:
            self._largest = claim.ballot
            self._takes_over(claim, at)
        if claim.utility is None:
            kept = now.owner.obeyed == claim.ballot
            self.counts[Sight.RELEASED if kept else Sight.STOOD_BACK] += 1
        elif claim.utility == 0.0:
            self.counts[Sight.OFFERED] += 1
        elif claim.wanted != claim.commanded:
            self.counts[Sight.BLENDED] += 1
        self._rival = at, claim

    def _takes_over(self, claim: Claim, at: float) -> None:
        if self._rival is None or claim.utility is None:
            return
        last, before = self._rival
        if claim.wanted == claim.commanded:
            self.counts[Sight.AT_ONCE] += 1
        if before.utility is None or before.ballot.instance in self._gone:
            self.counts[Sight.VACANT] += 1
        elif at - last > SILENT_S:
            self.counts[Sight.SILENCE] += 1
        elif claim.utility > before.utility:
            self.counts[Sight.BETTER] += 1
        elif claim.critical and not before.critical:
            self.counts[Sight.CRITICAL] += 1

    def _ordered(self, order: Ordered) -> None:
        moves = bool(order.v or order.w)
        silent = order.at - self._obeyed_at > UNCOMMANDED_S
        self.counts[Sight.SILENT_STOP] += not moves and not self._resting and silent
        self._resting = not moves

    def _truth(self, truth: Truth, at: float, now: Record) -> None:
        rests, away = now.body.rested_at == at, now.faults.befalls("robot", "crash", "hang")
        self.counts[Sight.WATCHDOG] += self._rolling and rests and away
        self._rolling = away and not rests
        touched = truth.collisions > self._touches
        self.counts[Sight.TOUCHED] += touched and bool(now.unable())
        self._touches = truth.collisions
