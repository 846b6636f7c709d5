"""The contender's side of one resource: an agent's turns, its bids and what it publishes."""

from __future__ import annotations

from math import isfinite
from typing import Any, Final

from armadico.core import messages as m
from armadico.core.cycles import CycleClock
from armadico.core.desk import Desk
from armadico.core.exchange import Bid
from armadico.core.mechanisms import contender
from armadico.core.messages import Message
from armadico.core.outgoing import ERROR, WARNING, Publish, Refused
from armadico.core.resources import Resource

LONGEST_REASON: Final = 200  # characters of a bid's reason that are kept


class Bidding:
    """Has the agent bid for a resource once per cycle, and publishes what its contender decides."""

    def __init__(self, desk: Desk, resource: Resource) -> None:
        self._desk = desk
        self._agent = agent = desk.agent
        self.resource = resource
        period = resource.period_s
        self.clock = desk.cycles if period is None else CycleClock(period)
        self.mechanism, self.contender = contender(resource, agent, self.clock)
        self._turned: m.Cycle | None = None  # the cycle of the last turn
        self._warned = False  # that critical bids are not declared
        self._claim_key = desk.key_of(m.Claim, resource=resource.name)
        self._command_key = resource.command_key_of(agent.instance)

    # Inputs --------------------------------------------------------------------------------------

    def on_claim(self, claim: m.Claim, now: float) -> None:
        self._send(self.contender.on_claim(claim, now))

    def on_message(self, message: Message, now: float) -> None:
        self._send(self.contender.on_message(message, now))

    def on_ack(self, ack: m.Ack, now: float) -> bool:
        """Process an acknowledgement of a fresh cycle; return whether it is a newer one."""
        contender, resource = self.contender, self.resource
        known = contender.ack.cycle if contender.ack is not None else ack.cycle
        if known.epoch == ack.cycle.epoch and known.number > ack.cycle.number:
            return False
        if ack.measured and (fault := resource.fault(ack.measured)):
            why = f"measured values are ignored: {fault}"
            self._desk.outbox.append(Refused(resource.ack_key, why))
        self._send(contender.acked(ack, now))
        return True

    def gone(self, instance: str, now: float) -> None:
        self._send(self.contender.gone(instance, now))

    def wake(self, now: float) -> None:
        due = self.contender.wakeup
        if due is not None and now >= due:
            self._send(self.contender.tick(now))

    def leave(self, now: float) -> None:
        """Release the resource if the agent holds it."""
        self._send(self.contender.bid(self.clock.newest or m.Cycle(0, 0), None, now))

    def returned(self, now: float) -> None:
        """Forget the last turn: its cycle's number was false, and later ones are smaller."""
        self._turned = None
        self.contender.returned(now)

    # Turns ---------------------------------------------------------------------------------------

    def turn(self, message: Any) -> None:
        """Bid, if a message that the agent reacts to starts a turn."""
        if self._agent.begins(self.resource, message):
            self.take(message)

    def take(self, message: Any) -> None:
        """Bid now for the cycle of a message, at most once per cycle."""
        if self._begins_turn(message):
            bid, desk = self._bid(message), self._desk
            self._send(self.contender.bid(message.cycle, bid, desk.now, desk.oldest_input()))

    def _begins_turn(self, message: Any) -> bool:
        """Return whether a message starts a turn: one per cycle, none for an older cycle."""
        if type(message) is m.Ack and message.resource != self.resource.name:
            return False
        last, cycle = self._turned, message.cycle
        if last is not None and last.epoch == cycle.epoch and cycle.number <= last.number:
            return False
        self._turned = cycle
        return True

    def _bid(self, message: Any) -> Bid | None:
        """Return the agent's bid if the inputs are fresh, and keep its record."""
        desk, agent, resource = self._desk, self._agent, self.resource
        bid, unsound, agent.why, agent.lacks = None, False, "", ""
        if not self.clock.alive(desk.now) or not self.contender.owned:
            agent.lacks = resource.ack_key
        elif resource.stops and (stop := desk.stopped) is not None:
            agent.why = f"stopped by {stop.requester}"
        elif stale := desk.stale_need():
            agent.lacks = stale
        else:
            proposed = agent.bid_for(resource, message)
            if proposed is not None:
                bid = self._sound(proposed)
                unsound = bid is None
        cycle, name, inputs = message.cycle, resource.name, desk.inputs
        if bid is None:
            why = agent.why or (f"no fresh {agent.lacks}" if agent.lacks else "")
            agent.why = why
            why, lacks = m.line(why)[:LONGEST_REASON], m.line(agent.lacks)
            record = m.BidRecord(cycle, name, None, False, (), why, inputs, lacks, unsound)
        else:
            record = m.BidRecord(
                cycle, name, bid.utility, bid.critical, bid.packed, bid.reason, inputs
            )
        desk.bids.append(record)
        return bid

    def _sound(self, bid: Bid) -> Bid | None:
        """Return the bid if it can be sent, else None: a holder's NaN is a release."""
        try:
            if not isinstance(bid, Bid):
                raise TypeError(f"expected a Bid, not {type(bid).__name__}")
            utility, within = float(bid.utility), bid.within
            if not 0.0 <= utility <= 1.0:
                raise ValueError(f"its utility must be from 0 to 1 (got {utility})")
            if within is not None and not isfinite(within):
                within = None
            reason = m.line(str(bid.reason))[:LONGEST_REASON]
            self._check_critical(bid)
            return Bid(utility, self.resource.pack(bid.action), bool(bid.critical), within, reason)
        except (TypeError, ValueError) as error:
            why = self._agent.why = m.line(f"its bid is invalid: {error}")[:LONGEST_REASON]
        self._desk.log(f"{self._agent.instance}: {why}", ERROR)
        return None

    def _check_critical(self, bid: Bid) -> None:
        """Log once that a bid is critical, and the class does not declare such bids."""
        if not bid.critical or self.resource in self._agent.critical_for or self._warned:
            return
        self._warned = True
        name = type(self._agent).__name__
        self._desk.log(
            f"{self._agent.instance}: its bid for {self.resource.name} is critical, and"
            f" {name}.critical_for lacks that resource: a society with keys refuses the bid",
            WARNING,
        )

    def _send(self, messages: list[Message]) -> None:
        outbox = self._desk.outbox
        for message in messages:
            if type(message) is m.Claim:
                key = self._claim_key
            elif type(message) is m.Command:
                key = self._command_key
            else:
                key = self._desk.key_of(type(message), resource=self.resource.name)
            outbox.append(Publish(key, message))
