"""Why no new command was obeyed for a while, by what an observer received (sans-IO).

Agents that lose publish nothing, so the reasons come from their records of bids, which are queried
each second. Each cycle of a pause counts for one reason, and the most frequent one is the cause.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from enum import StrEnum
from itertools import pairwise
from typing import Final, NamedTuple

from armadico.core.cycles import PERIOD
from armadico.core.messages import Ack, BidHistory, BidRecord, Command, Cycle, RobotState
from armadico.core.resources import WHEELS
from armadico.core.services import matches

LIMIT_S: Final = 0.4
"""A longer time without a newly obeyed command is a pause."""

AFTER_KILL_S: Final = 5.0
"""A kill explains a pause that begins at most so long after it: the agent is to be back by then."""

LATE_S: Final = 0.35
"""A longer time between two acknowledgements is silence of the robot agent."""


class Cause(StrEnum):
    """Why no new command was obeyed."""

    OWNER = "the robot agent was killed"
    SILENT = "the robot agent was silent, and was not killed"
    STOPPED = "the robot was stopped"
    INPUT = "no bid: the only agent of an input was killed"
    LATE = "no bid: an input was late, and its agent was not killed"
    NO_BID = "no bid, for another reason"
    NO_TURN = "no contender computed a bid"
    REFUSED = "commands were sent, and refused"
    UNTAKEN = "an agent bid, and none took over"


class Pause(NamedTuple):
    """A time without a newly obeyed command.

    Attributes:
        begin: When the last command was known to be obeyed, s.
        end: When the next one was, s; the end of the observation if none was.
        killed: The agent that was killed last before its end, if that may explain it; else "".
        held: Whether that agent's process held the wheels.
        reasons: How many cycles each reason had; the most frequent, the cause, first.
    """

    begin: float
    end: float
    killed: str
    held: bool
    reasons: tuple[tuple[str, int], ...]

    @property
    def seconds(self) -> float:
        return self.end - self.begin

    @property
    def cause(self) -> str:
        return self.reasons[0][0]

    @property
    def text(self) -> str:
        """The pause in a line, for people."""
        reasons = "; ".join(f"{reason}: {count} cycles" for reason, count in self.reasons)
        return f"pause of {self.seconds:.2f} s: {reasons}"


class Kill(NamedTuple):
    at: float
    name: str
    held: bool


class Drive:
    """What an observer receives of the wheels, with the times of arrival, s."""

    def __init__(self) -> None:
        self.holder = ""  # the instance that gave the newest obeyed command
        self.kills: list[Kill] = []
        self.provides: dict[str, tuple[str, ...]] = {}  # key expressions, by agent
        self._obeyed: list[tuple[float, int]] = []  # each new command, acknowledged; its cycle
        self._newest: Cycle | None = None
        self._acks: list[tuple[float, int]] = []  # with the cycle's number
        self._stopped: list[float] = []
        self._commanded: set[int] = set()  # numbers of cycles that had a command
        self._bids: dict[int, dict[str, BidRecord]] = {}  # by the cycle's number and the instance

    def update(self, message: object, at: float) -> None:
        match message:
            case Ack(resource=WHEELS.name):
                self._acks.append((at, message.cycle.number))
                cycle = message.obeyed_cycle
                if message.obeyed is not None and cycle is not None and cycle != self._newest:
                    self._newest, self.holder = cycle, message.obeyed.instance
                    self._obeyed.append((at, cycle.number))
            case RobotState(stop=stop) if stop.stopped:
                self._stopped.append(at)
            case Command(resource=WHEELS.name) if message.action is not None:
                self._commanded.add(message.cycle.number)
            case BidHistory():
                for bid in message.bids:
                    if bid.resource == WHEELS.name:
                        self._bids.setdefault(bid.cycle.number, {})[message.instance] = bid

    def lasts(self, seconds: float, now: float) -> bool:
        """Whether commands were obeyed for so long until now, without a pause."""
        return self.paused(now - seconds, now) <= LIMIT_S

    def paused(self, since: float, until: float) -> float:
        """The longest time without a newly obeyed command, s."""
        first = bisect_left(self._obeyed, since, key=lambda each: each[0])
        times = [at for at, _ in self._obeyed[first:] if at <= until]
        before = [self._obeyed[first - 1][0]] if first else []
        return longest([*(before or [since]), *times, until])

    @property
    def gap(self) -> float:
        """The longest time without an acknowledgement, s."""
        return longest([at for at, _ in self._acks])

    def pauses(self, since: float, until: float) -> list[Pause]:
        """All pauses that began after `since`; those before the first obeyed command do not."""
        times: list[tuple[float, int | None]] = [
            *(each for each in self._obeyed if each[0] >= since),
            (until, None),
        ]
        pairs = pairwise(times)
        return [self._explained(a, b, last) for (a, _), (b, last) in pairs if b - a > LIMIT_S]

    def _explained(self, begin: float, end: float, last: int | None) -> Pause:
        since = begin - AFTER_KILL_S
        kill = next((k for k in reversed(self.kills) if since <= k.at < end), None)
        reasons = self._reasons(begin, end, last).most_common()
        name, held = ("", False) if kill is None else (kill.name, kill.held)
        return Pause(begin, end, name, held, tuple(reasons))

    def _reasons(self, begin: float, end: float, last: int | None) -> Counter[str]:
        """How many cycles of a pause each reason had. `last` is the cycle of the next command."""
        acks = [(at, number) for at, number in self._acks if begin <= at <= end]
        silence = longest([begin, *(at for at, _ in acks), end])
        reasons: Counter[str] = Counter()
        if silence > LATE_S:
            owner = Cause.OWNER if self._killed("robot", begin, end) else Cause.SILENT
            reasons[owner] += round(silence / PERIOD)
        if any(begin <= at <= end for at in self._stopped):
            reasons[Cause.STOPPED] += len(acks)
        for _, number in acks:
            if last is None or number < last:
                reasons[self._reason(number, begin, end)] += 1
        return reasons or Counter({Cause.SILENT: 1})

    def _reason(self, number: int, begin: float, end: float) -> str:
        """Why no command of a cycle was obeyed."""
        bids = self._bids.get(number, {}).values()
        if number in self._commanded:
            return Cause.REFUSED
        if any(bid.utility for bid in bids):
            return Cause.UNTAKEN
        lacking = Counter(bid.lacks for bid in bids if bid.lacks)
        if lacking:
            key = lacking.most_common(1)[0][0]
            agents = [n for n, keys in self.provides.items() if any(matches(k, key) for k in keys)]
            was = any(self._killed(name, begin, end) for name in agents)
            return f"{Cause.INPUT if was else Cause.LATE} ({key})"
        whys = Counter(bid.reason if bid.utility is None else "a bid of 0" for bid in bids)
        return f"{Cause.NO_BID} ({whys.most_common(1)[0][0]})" if whys else Cause.NO_TURN

    def _killed(self, name: str, begin: float, end: float) -> bool:
        """Whether an agent's kill may explain a pause."""
        since = begin - AFTER_KILL_S
        return any(k.name == name and since <= k.at < end for k in self.kills)


def longest(times: Sequence[float]) -> float:
    """The longest time between two that follow each other, s; 0 of fewer than two."""
    return max((b - a for a, b in pairwise(times)), default=0.0)


def summary(pauses: Sequence[Pause], counts: Mapping[tuple[str, bool], int]) -> list[list[str]]:
    """A row for each agent that was killed, whether it held, and each cause.

    Args:
        pauses: All pauses.
        counts: How often each agent was killed, by its name and whether it held.
    """
    found: dict[tuple[str, bool, str], list[Pause]] = {}
    for each in pauses:
        found.setdefault((each.killed, each.held, each.cause), []).append(each)
    for name, held in counts:
        if not any(key[:2] == (name, held) for key in found):
            found[name, held, ""] = []
    rows = []
    for (name, held, cause), of in sorted(found.items()):
        kills = counts.get((name, held), 0)
        worst = f"{max(pause.seconds for pause in of):.2f} s" if of else f"below {LIMIT_S} s"
        who = f"{name}, the holder" if held else name or "none"
        rows.append([who, str(kills or "-"), cause or "-", str(len(of)), worst])
    return rows
