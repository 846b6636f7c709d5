"""Who drives, by the acknowledgements: ballots never decrease, commands are fresh and carried out.

And a stop holds until it is released.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from math import inf
from typing import Final

from armadico.core.judgement import Answer
from armadico.core.membership import agent_of
from armadico.core.messages import Ack, Ballot, Command, RobotState, Stop
from armadico.core.resources import WHEELS
from armadico.mobile.messages import MissionState, MissionStatus, Pose
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import AGAIN_S, MISSING, Rule
from armadico.observe.audit.scene import Scene
from armadico.observe.measures import speeds

FRESH_CYCLES = 3
"""A command may be for a cycle so many older than the newest (docs/coordination.md)."""

COMMANDS: Final = 64
"""Commands that are kept, to be compared with what was ordered."""

SAME: Final = 0.001
"""Speeds that differ by less, m/s or rad/s, are the same."""

OTHERS, WITHIN_S = 3, 10.0
"""So many orders within this time, s, that were not commanded are no accident."""

IDLE_S: Final = 3.0
"""Without a mission the wheels are released within this time, s: the interface agent may be
restarted under way, and publishes the mission again."""

SILENT_CYCLES: Final = 8
"""A tenure without a command for so many cycles has ended; the owner rests after four."""

RELEASED_S: Final = 2.0
"""A release may be received so much later than the state that shows it, s."""


def brief(ballot: Ballot | None) -> str:
    """A ballot for people: term and agent."""
    return "none" if ballot is None else f"{ballot.term} of {agent_of(ballot.instance)}"


class Rising:
    """The largest ballot of each epoch, and those that are smaller than one before."""

    def __init__(self, how: str) -> None:
        self._how = how
        self._known: dict[int, Ballot] = {}

    def add(self, epoch: int, ballot: Ballot | None) -> str:
        """Returns what is wrong with a ballot; "" if nothing."""
        if ballot is None:
            return ""
        before = self._known.get(epoch)
        self._known[epoch] = ballot if before is None else max(ballot, before)
        if before is None or ballot >= before:
            return ""
        return f"ballot {brief(ballot)} is {self._how} after {brief(before)}"


class OneDriver(Rule):
    """Within an epoch neither the ballots obeyed nor the largest known ever decrease."""

    promise = Promise.ONE_DRIVER
    needs = (Ack,)

    def __init__(self) -> None:
        super().__init__()
        self._obeyed, self._largest = Rising("acknowledged as obeyed"), Rising("the largest")

    def on_ack(self, ack: Ack, now: Scene) -> Iterator[Finding]:
        if ack.resource != WHEELS.name:
            return
        epoch, obeyed, largest = ack.cycle.epoch, ack.obeyed, ack.largest
        self.checked |= obeyed is not None or largest is not None
        below = obeyed is not None and (largest is None or largest < obeyed)
        for what in (
            self._obeyed.add(epoch, obeyed),
            self._largest.add(epoch, largest),
            f"{brief(obeyed)} is obeyed, the largest is {brief(largest)}" if below else "",
        ):
            if what:
                yield self.found(now, now.who, what)


class Fresh(Rule):
    """No command is obeyed for a cycle more than 3 before the newest, or before the last one."""

    promise = Promise.FRESH
    needs = (Ack,)

    def __init__(self) -> None:
        super().__init__()
        self._before: Ack | None = None

    def on_ack(self, ack: Ack, now: Scene) -> Iterator[Finding]:
        if ack.resource != WHEELS.name:
            return
        before, self._before = self._before, ack
        at, by = ack.obeyed_cycle, ack.obeyed
        if before is None or at is None or by is None or before.cycle.epoch != ack.cycle.epoch:
            return
        self.checked, was, who = True, before.obeyed_cycle, agent_of(by.instance)
        if at.epoch != ack.cycle.epoch:
            yield self.found(now, who, f"{brief(by)} is obeyed for a cycle of another epoch")
        elif (at, by) != (was, before.obeyed):
            age = before.cycle.number - at.number  # it was obeyed after the cycle before
            if age > FRESH_CYCLES:
                yield self.found(now, who, f"{brief(by)} is obeyed for a cycle at least {age} old")
            if by == before.obeyed and was is not None and at < was:
                what = f"{brief(by)} is obeyed for cycle {at.number} after {was.number}"
                yield self.found(now, who, what)


class Ordered(Rule):
    """What the robot agent orders is what the agent that it obeys commanded for that cycle.

    A limit on the speed shows in `admitted`, and not in `ordered`; a rest at a contact does.
    """

    promise = Promise.ORDERED
    needs = (RobotState, Ack, Command)

    def __init__(self) -> None:
        super().__init__()
        self._commands: deque[Command] = deque(maxlen=COMMANDS)
        self._others: deque[float] = deque(maxlen=OTHERS)
        self._orders = self._unseen = 0  # of the latter the command was not received

    @property
    def pending(self) -> str:
        share = self._unseen / max(self._orders, 1)
        return f"{share:.0%} of the obeyed Command messages missing" if share > MISSING else ""

    @property
    def due(self) -> bool:
        return bool(self.pending)

    def on_command(self, command: Command, _: Scene) -> None:
        if command.resource == WHEELS.name:
            self._commands.append(command)

    def on_ack(self, ack: Ack, now: Scene) -> Iterator[Finding]:
        state = now.state
        if ack.resource != WHEELS.name or state is None:
            return
        by, at = ack.obeyed, ack.obeyed_cycle
        if by is None or state.driver != by.instance or state.cycle != ack.cycle:
            return
        if not now.publishes_orders:
            return
        obeyed = [each for each in self._commands if (each.ballot, each.cycle) == (by, at)]
        commanded = [speeds(each) for each in obeyed if each.action is not None]
        v, w = state.ordered.v, state.ordered.w
        self._orders, self._unseen = self._orders + 1, self._unseen + (not obeyed)
        self.checked = self.checked or bool(commanded or self.pending)
        if not commanded:
            return
        if any(abs(v - each[0]) < SAME and abs(w - each[1]) < SAME for each in commanded):
            return
        if state.touch is not None and v == 0.0 == w:
            return  # it rests at a contact, and says so; the next command counts (seed 97088)
        self._others.append(now.now)
        often = len(self._others) == OTHERS and now.now - self._others[0] < WITHIN_S
        if often and self.is_new("robot", now, AGAIN_S):
            was = f"{agent_of(by.instance)} commanded %.2f and %.2f" % commanded[-1]
            what = f"orders {v:.2f} m/s and {w:.2f} rad/s, where {was}"
            yield self.found(now, "robot", what, f"{OTHERS} such orders")


class Held(Rule):
    """A tenure ends with its mission, and by a release or a takeover.

    An agent may drive without missions; one that took the wheels for a mission has no use for them
    after it, unless a person drives by hand, it leads the robot, or searches its place.
    """

    promise = Promise.HELD
    needs = (Ack, MissionStatus, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._driven: Ballot | None = None  # of the newest mission
        self._since = inf  # when it was first held without a use
        # Tenures that ended in silence, by instance: one that was killed can release nothing, and
        # another one follows it. Only one that lives comes back and does it again.
        self._silent: Counter[str] = Counter()
        self._before: Ack | None = None
        self._without = 0  # cycles since the last command, which the owner lived through

    def on_ack(self, ack: Ack, now: Scene) -> Iterator[Finding]:
        if ack.resource != WHEELS.name or now.mission is None:
            return
        self.checked |= ack.obeyed is not None
        if now.excuse(Excuse.DISTURBED) is not None:
            self._since = inf
            return
        yield from self._unreleased(ack, now)
        due = now.mission.state in (MissionState.DRIVING, MissionState.PLANNING)
        self._driven = ack.obeyed if due else self._driven
        uses = due or now.excuse(Excuse.BY_HAND, Excuse.LED, Excuse.LOST) is not None
        if not now.holder or ack.obeyed != self._driven or uses:
            self._since = inf
            return
        self._since = min(self._since, now.now)
        if now.now - self._since > IDLE_S:
            self._since = inf
            what = f"holds the wheels {IDLE_S:g} s after its mission"
            yield self.found(now, now.who, what, f"utility {ack.utility:.2f}")

    def _unreleased(self, ack: Ack, now: Scene) -> Iterator[Finding]:
        before, self._before, by = self._before, ack, ack.obeyed
        same = before is not None and (by, ack.obeyed_cycle) == (before.obeyed, before.obeyed_cycle)
        if by is None or before is None or not same:
            self._without = 0
            return
        # What passed while the owner hung, or while its acks were missing, is not known.
        further = ack.cycle.number - before.cycle.number
        self._without += further == 1 and ack.cycle.epoch == before.cycle.epoch
        if self._without == SILENT_CYCLES and further == 1:
            self._silent[by.instance] += 1
            if self._silent[by.instance] == OTHERS:
                what = "stopped commanding without a release"
                yield self.found(now, agent_of(by.instance), what, f"{OTHERS} times")


class Stopped(Rule):
    """A latched stop ends by a release, and nothing is ordered before."""

    promise = Promise.STOP
    needs = (RobotState,)
    sees = (Stop,)

    def __init__(self) -> None:
        super().__init__()
        self._received = False  # any stop or release
        self._stop: Stop | None = None  # the latched one
        self._since = inf  # when it ended without a release
        self._released: set[int] = set()  # presses
        self._later: set[int] = set()  # presses since, which take its place in the latch

    def on_stop(self, stop: Stop, _: Scene) -> None:
        self._received = True
        if not stop.stopped:
            self._released.add(stop.press)
        elif stop.press not in self._released:
            self._later.add(stop.press)

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        if state.stop.stopped:
            if self._stop is None or self._stop.press != state.stop.press:
                self._later.clear()
            self.checked, self._stop, self._since = True, state.stop, inf
            if state.ordered.v or state.ordered.w:
                v, w = state.ordered.v, state.ordered.w
                what = f"orders {v:.2f} m/s, {w:.2f} rad/s while a stop is latched"
                yield self.found(now, "robot", what)
        elif self._stop is None:
            return
        elif self._released & {self._stop.press, *(self._later & {state.stop.press})}:
            self._stop = None  # a later press may have been released before any state showed it
        elif now.excuse(Excuse.DISTURBED) is None:
            self._since = min(self._since, now.now)
            if now.now - self._since > RELEASED_S:
                what = f"the stop of {self._stop.requester} ended, and no release was received"
                what += "" if self._received else ", nor any other Stop"
                self._stop, answer = None, Answer.NO if self._received else Answer.UNKNOWN
                yield self.found(now, "robot", what, answer=answer)
