"""What was seen of a real society, in the order of time, and the times that trials are about.

Sans-IO: what the mesh delivered, what crossed the line to the controller and which faults were made
go in; the checker of promises is shown the same. All times are s by one clock, that of
whoever watches; processes on one machine share it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterator
from itertools import pairwise
from typing import Final, TypeVar

from msgspec.structs import replace

from armadico.core.cycles import PERIOD
from armadico.core.messages import Ack, Ballot, BidHistory, Command, Cycle, Log, Message
from armadico.core.resources import WHEELS
from armadico.mobile.messages import MissionState, Truth
from armadico.observe.view import View, agent_of, driver
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.observations import (
    Bids,
    Left,
    Observation,
    Ordered,
    Said,
)

KEPT: Final = 3000
"""Messages of a kind that are kept: a few minutes' worth."""

HEARD_S: Final = 1.0
"""A busy onlooker may receive a command so much later than the line shows that it is obeyed. With
seven processes a core 49 ms were seen in 10 s; the first orders of a run are each another one."""

REST_M_S: Final = 0.01
REST_RAD_S: Final = 0.01
"""Slower than this the wheels rest."""

MOVES_M_S: Final = 0.05
"""Faster than this the robot is on its way."""

T = TypeVar("T")

Timed = deque[tuple[float, T]]


class Account:
    """Takes what is seen, and measures from when to when things took."""

    def __init__(self, checker: Checker | None = None) -> None:
        self.checker = checker or Checker()
        self.acks: Timed[Ack] = deque(maxlen=KEPT)  # the robot agent's, of the wheels
        self.commands: Timed[Command] = deque(maxlen=KEPT)
        self.truths: Timed[Truth] = deque(maxlen=KEPT)
        self.orders: Timed[Ordered] = deque(maxlen=KEPT)
        self.logs: Timed[Log] = deque(maxlen=200)
        self.view = View()
        self.now = float("-inf")
        self.deaf = False  # commands may reach the robot and not the onlooker

    # What comes in -------------------------------------------------------------------------------

    def take(self, seen: Observation) -> None:
        """Take one thing; what comes a little late counts as coming now.

        A command does not move the time: it may be taken before what was seen before it.
        """
        if isinstance(seen, Said) and isinstance(seen.message, Command):
            self.commands.append((seen.at, seen.message))
            self.checker.take(Said(self.now, seen.message))
            return
        self.now = max(self.now, seen.at)
        if isinstance(seen, Said):
            self._receive(seen.message)
            if not isinstance(seen.message, BidHistory | Log):
                self.checker.take(Said(self.now, seen.message))
            return
        if isinstance(seen, Ordered):
            self.orders.append((seen.at, seen))
            if self.deaf:
                self._supply(seen)
        self.checker.take(replace(seen, at=self.now))

    def deafen(self, deaf: bool) -> None:
        """Commands may reach the robot and not the onlooker from now on, or no more.

        A cut may have taken what was just under way to the onlooker, and had reached the robot.
        """
        self.deaf = deaf
        if deaf:
            for _, order in _from(self.orders, self.now - HEARD_S):
                self._supply(order)

    def _supply(self, order: Ordered) -> None:
        """Have been commanded what is ordered: when it is to stop is still looked at."""
        ack = self.view.acks.get(WHEELS.name)
        if ack is not None and ack.obeyed is not None:
            unheard = Command(WHEELS.name, ack.cycle, ack.obeyed, (order.v, order.w))
            self.checker.take(Said(self.now, unheard))

    def token(self, at: float, instance: str, there: bool) -> None:
        """A liveliness token came or went."""
        self.now = max(self.now, at)
        if self.view.token(instance, there=there, t=at) and not there:
            self.checker.take(Left(self.now, instance))

    def _receive(self, message: Message) -> None:
        self.view.learn(message, self.now)
        if isinstance(message, Ack) and message.resource == WHEELS.name:
            self.acks.append((self.now, message))
        elif isinstance(message, Truth):
            self.truths.append((self.now, message))
        elif isinstance(message, Log):
            self.logs.append((self.now, message))
        elif isinstance(message, BidHistory) and message.bids:
            last = message.bids[-1]
            self.checker.take(Bids(self.now, message.instance, last, self._age(last.cycle)))

    def _age(self, cycle: Cycle) -> float:
        """How long ago something answered a cycle, s."""
        state = self.view.state
        newest = None if state is None else state.cycle
        if newest is None or newest.epoch != cycle.epoch:
            return 0.0
        return max(newest.number - cycle.number, 0) * PERIOD

    # How things stand ----------------------------------------------------------------------------

    @property
    def driver(self) -> str | None:
        """The instance that drives; None if there is none."""
        return self.view.driver(WHEELS.name, self.now)

    def driving(self) -> bool:
        """Whether a command is obeyed and the robot is truly on its way."""
        truth = self.view.truth
        return truth is not None and truth.v > MOVES_M_S and self.driver is not None

    def at_rest(self) -> bool:
        """Whether the wheels truly rest."""
        return self.view.truth is not None and _rests(self.view.truth)

    def on_mission(self) -> bool:
        """Whether the interface agent drives to a goal, by its last status."""
        mission = self.view.mission
        return mission is not None and mission.state is MissionState.DRIVING

    def bids_now(self, instance: str, within: float = 1.5) -> bool:
        """Whether an instance's last bids were received at most so long ago (s)."""
        known = self.view.bids.get(instance, {})
        bid, at = next(reversed(known.values()), (None, 0.0))
        return bid is not None and self.now - at <= within and bool(bid.utility)

    def instances(self, name: str) -> list[str]:
        """The instances of an agent that are alive, the oldest first."""
        alive = self.view.alive
        return [who for who in sorted(alive, key=alive.__getitem__) if agent_of(who) == name]

    # From when to when ---------------------------------------------------------------------------

    def next_obeyed(self, since: float, but: Container[str] = ()) -> tuple[float, Command] | None:
        """The next command that is known to have been obeyed, and when it was published.

        Known by the acknowledgement of the robot agent: the first after `since` of a command
        published since then by an instance that is none of `but`.
        """
        sent = {(c.ballot, c.cycle): (at, c) for at, c in self.commands}
        for _, ack in _from(self.acks, since):
            if ack.obeyed is None or ack.obeyed_cycle is None or ack.obeyed.instance in but:
                continue
            found = sent.get((ack.obeyed, ack.obeyed_cycle))
            if found is not None and found[0] >= since:
                return found
        return None

    def obeyed_after(self, since: float, but: Container[str] = ()) -> float | None:
        """When that was published; None if none is yet."""
        found = self.next_obeyed(since, but)
        return None if found is None else found[0]

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
        return _first(self.truths, since, _rests)

    def fastest(self, since: float, until: float) -> float:
        """The largest true speed in a time, m/s; 0 if none was received."""
        return max((abs(t.v) for at, t in _from(self.truths, since) if at <= until), default=0.0)

    def share_obeyed(self, since: float) -> float:
        """The share of the cycles since a time in which a command was obeyed of late, 0 to 1."""
        cycles = [driver(ack) is not None for _, ack in _from(self.acks, since)]
        return sum(cycles) / len(cycles) if cycles else 0.0

    def late_commands(self, instance: str, since: float, ballot: Ballot) -> int:
        """How many commands an instance published with a ballot, or a smaller one, since a time."""
        late = _from(self.commands, since)
        return sum(c.ballot.instance == instance and c.ballot <= ballot for _, c in late)

    def obeyed_ballots(self, since: float) -> set[Ballot]:
        """The ballots that were acknowledged as obeyed since a time."""
        return {ack.obeyed for _, ack in _from(self.acks, since) if ack.obeyed is not None}


def _from(kept: Timed[T], since: float) -> Iterator[tuple[float, T]]:
    return ((at, item) for at, item in kept if at >= since)


def _first(kept: Timed[T], since: float, wanted: Callable[[T], bool]) -> float | None:
    return next((at for at, item in _from(kept, since) if wanted(item)), None)


def _rests(truth: Truth) -> bool:
    return abs(truth.v) < REST_M_S and abs(truth.w) < REST_RAD_S
