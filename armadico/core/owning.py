"""The owner's side of one resource: commands in, acknowledgements out."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final

from armadico.core import messages as m
from armadico.core.coordination import Owner, Verdict
from armadico.core.cycles import CycleClock, CycleCounter
from armadico.core.desk import Desk
from armadico.core.outgoing import INFO, WARNING, Publish, Refused
from armadico.core.resources import Resource

REPORT_S: Final = 2.0  # shortest time between two reports of refused commands, s
# Different reasons in one report. Each excessive speed is a reason of its own.
REASONS_REPORTED: Final = 3

# Refusals that every exchange and every start causes. They are no fault.
EXPECTED_REFUSALS: Final = frozenset({Verdict.STALE_BALLOT, Verdict.OVER, Verdict.LISTENING})


class Owning:
    """Has the agent obey the holder of a resource, and rest the resource without one."""

    def __init__(self, desk: Desk, resource: Resource) -> None:
        self._desk = desk
        self._agent = desk.agent
        self.resource = resource
        period = resource.period_s
        self.counter: CycleCounter | None = None  # only of a resource with its own period
        clock = desk.cycles
        if period is not None:
            self.counter = CycleCounter(desk.agent.rng.getrandbits(63), period)
            clock = CycleClock(period)
        rights = desk.agent.identity.rights
        bids = None if rights is None else partial(_bids, rights.may_be_critical, resource.name)
        self.owner = Owner(resource, clock, bids)
        self._due: float | None = None  # when the counter's next cycle begins, s
        self._reported_at = float("-inf")

    def start(self, now: float) -> None:
        if self.counter is not None:
            self._due = now

    def on_claim(self, claim: m.Claim) -> None:
        if self.owner.on_claim(claim):
            self.rest()

    def on_command(self, command: m.Command, now: float) -> None:
        """Obey a command, or refuse it."""
        owner, resource, agent = self.owner, self.resource, self._agent
        unpack: Callable[[m.Action], Any] = resource.unpack  # the agent's hooks name its type
        if agent.unavailable(resource):
            owner.refusals[Verdict.UNAVAILABLE] += 1
            return
        action, fault = command.action, ""
        if action is not None:
            fault = resource.fault(action) or agent.beyond(resource, unpack(action))
        stopped = resource.stops and self._desk.stopped is not None
        verdict = owner.judge(command, now, stopped=stopped, fault=fault)
        if verdict is Verdict.OBEYED and action is not None:
            agent.obey(resource, unpack(action))
        elif verdict is Verdict.RELEASED and owner.obeyed is None:  # else another tenure drives
            self.rest()
        elif verdict is Verdict.OUT_OF_RANGE:
            owner.refusals[f"{command.ballot.instance}: {fault}"] += 1
            owner.refusals.pop(verdict, None)

    def acknowledge(self) -> None:
        """Publish the cycle's acknowledgement; report refusals at intervals."""
        desk, resource, owner = self._desk, self.resource, self.owner
        measured = self._agent.measure(resource)
        if measured and (fault := resource.fault(measured)):
            why = f"{type(self._agent).__name__}.measure: {fault}; the values are ignored"
            desk.outbox.append(Refused(resource.ack_key, why))
            measured = ()
        ack = owner.ack(measured)
        if ack is not None:
            desk.outbox.append(Publish(resource.ack_key, ack))
        refusals = owner.refusals
        if refusals and desk.now - self._reported_at >= REPORT_S:
            self._reported_at = desk.now
            counts = [f"{count} x {verdict}" for verdict, count in refusals.items()]
            if len(counts) > REASONS_REPORTED:
                counts[REASONS_REPORTED:] = [f"{sum(refusals.values())} in all"]
            text = "; ".join(counts)
            level = INFO if set(refusals) <= EXPECTED_REFUSALS else WARNING
            desk.log(f"commands refused: {text}", level, m.LogEvent.COMMANDS_REFUSED)
            refusals.clear()

    def rest(self) -> None:
        self.owner.rested()
        self._agent.rest(self.resource)

    def wake(self, now: float) -> None:
        """Rest the resource after its command timeout; begin its next cycle if it has its own."""
        silent_at = self.owner.silent_at
        if silent_at is not None and now >= silent_at:
            after = self.resource.silence(self._desk.cycles.period)
            self._desk.log(f"{self.resource.name}: no valid command for {after:g} s: stop", WARNING)
            self.rest()
        if self.counter is not None and self._due is not None and now >= self._due:
            self.owner.clock.advance(self.counter.next(now), now)
            late = now - self._due
            self._due += self.counter.period * (1 + late // self.counter.period)
            self.acknowledge()

    @property
    def wakeup(self) -> float | None:
        """When `wake` is due, s; None: not at all."""
        due, silent_at = self._due, self.owner.silent_at
        return due if silent_at is None or (due is not None and due < silent_at) else silent_at


def _bids(may: Callable[[str, str], bool], resource: str, instance: str) -> bool:
    return may(instance, resource)
