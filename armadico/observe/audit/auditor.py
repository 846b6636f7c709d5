"""The auditor: messages in, findings out; sans-IO."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from math import inf
from typing import Final

from armadico.config.worlds import World
from armadico.core.cycles import LATE, PERIOD
from armadico.core.judgement import Answer
from armadico.core.messages import Ack, Command, Cycle, Message, RobotState
from armadico.core.resources import WHEELS
from armadico.core.services import Kind, derived, service_of
from armadico.mobile.messages import MissionStatus, Pose, Scan, Sonar, Trajectory, Truth
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import is_readable
from armadico.observe.audit.arrival import Arrives
from armadico.observe.audit.chart import Chart, Wall
from armadico.observe.audit.contacts import Touched
from armadico.observe.audit.coordination import Fresh, Held, OneDriver, Ordered, Stopped
from armadico.observe.audit.driving import Brakes, Earned, Honest, Speed, Stands, Steady, Turns
from armadico.observe.audit.failures import Failed, Refuses
from armadico.observe.audit.missions import Ends, Reached, Visits
from armadico.observe.audit.paths import Clears, Leads, Waits
from armadico.observe.audit.poses import Claims, Doubts, Found, Heading, Moves, Rated, Scaled
from armadico.observe.audit.promises import Excuse, Finding
from armadico.observe.audit.reflexes import Reflexes
from armadico.observe.audit.rules import MISSING, Handler, Rule, handler_of
from armadico.observe.audit.scene import SHOWN, Scene
from armadico.observe.audit.sensed import reads_of
from armadico.observe.audit.sensing import Changes, Fits, Renewed, Sees, Shown
from armadico.observe.audit.walls import Compared
from armadico.observe.pauses import Pauses

RULES: Final[tuple[type[Rule], ...]] = (
    *(Touched, Arrives, Ends, Reached, Visits, Failed, Refuses, Waits, Found, Doubts),
    *(Leads, Clears, Stands, Honest, Earned, Reflexes, Steady, Speed, Brakes, Turns),
    *(OneDriver, Fresh, Ordered, Held, Stopped, Heading, Scaled, Rated, Moves, Claims),
    *(Changes, Renewed, Fits, Sees, Compared, Shown),
)

EachCycle = RobotState | Ack | Pose | Sonar | Scan | Obstacles
EACH_CYCLE: Final = (RobotState, Ack, Pose, Sonar, Scan, Obstacles)
"""Messages that come once a cycle (docs/protocol.md), so that the numbers of cycles tell how many
are missing. Of several sensors' obstacles the first of a cycle counts."""

FASTER: Final = 2.0
"""Cycles that pass faster than the robot's by this factor have a clock that is not the robot's."""

BURST_S: Final = 1.0
"""Cycles of less than this, s, may come at once."""


def watched() -> tuple[type[Message], ...]:
    """The installed messages that an auditor needs; a base stands for its subclasses."""
    kinds = dict.fromkeys((*SHOWN, *(kind for rule in RULES for kind in (*rule.needs, *rule.sees))))
    return tuple(kind for base in kinds for kind in derived(base))


@cache
def _deadline_s(kind: type[Message]) -> float | None:
    """The longest time between two messages of a kind, s; None: it does not come periodically."""
    service = service_of(kind)
    if service.kind is Kind.LATCHED and service.rate_hz is not None:
        return 2.0 / service.rate_hz
    return service.deadline_s


def _behind(newest: EachCycle | Truth, message: EachCycle | Truth) -> float:
    """How many cycles a message is older than the newest of its kind, by their own stamps."""
    if isinstance(newest, Truth) and isinstance(message, Truth):
        return (newest.t - message.t) / PERIOD
    if isinstance(newest, EACH_CYCLE) and isinstance(message, EACH_CYCLE):
        same = newest.cycle.epoch == message.cycle.epoch
        return newest.cycle.number - message.cycle.number if same else -inf
    return -inf


class Auditor:
    """Judges one robot's society by its messages, in the order of their times.

    `v_max` is the limit of the speed that a scenario sets, m/s; inf: none; None: unknown, until a
    `ParametersReply` of goto shows it.

    Attributes:
        findings: All so far, except those of `report`.
        scene: What the messages show now; `scene.needed` counts the excuses that were needed.
    """

    def __init__(
        self,
        rules: Iterable[type[Rule]] = RULES,
        excuses: frozenset[Excuse] = frozenset(Excuse),
        v_max: float | None = None,
    ) -> None:
        self.scene = Scene(excuses, v_max)
        self.findings: list[Finding] = []
        self._kinds = tuple(rules)
        self._rules = [rule() for rule in self._kinds]
        # Made when a kind first comes.
        self._handlers: dict[type[Message], list[tuple[Rule, Handler]]] = {}
        self._timed = [rule for rule in self._rules if type(rule).on_time is not Rule.on_time]
        self._used = tuple(kind for rule in self._rules for kind in (*rule.needs, *rule.sees))
        self._seen = set[type[Message]]()
        # Of kinds that come periodically, by key.
        self._pauses: dict[tuple[type[Message], str], Pauses] = {}
        self._driven = False  # there was a mission, so it must have had a path
        self._held_at: float | None = None  # since an agent was obeyed, it must have commanded
        self._newest: dict[tuple[type[Message], str, str], EachCycle | Truth] = {}
        # Of a kind the newest cycle, and how many were received and passed from the first to it.
        self._counts: dict[type[Message], tuple[Cycle, int, int]] = {}
        self._lasted_s = 0.0  # from the first state to the last, by the observer's clock

    def without(self, excuse: Excuse) -> Auditor:
        """A new auditor with the same rules and map that does not accept an excuse."""
        return self.anew(self.scene.excuses - {excuse})

    def anew(self, excuses: frozenset[Excuse] | None = None) -> Auditor:
        """A new auditor with the same rules and map, and these excuses, by default the same."""
        new = Auditor(self._kinds, self.scene.excuses if excuses is None else excuses)
        new.scene.v_max = self.scene.v_max
        new.scene.mapped, new.scene.chart = self.scene.mapped, self.scene.chart
        new.scene.world, new.scene.accuses = self.scene.world, self.scene.accuses
        return new

    def chart(self, walls: Iterable[Wall] | None, world: World | None = None) -> None:
        """The robot was launched with a map of these walls, world frame, m; None: not at hand.

        `world` is that map with its rooms and goals.
        """
        self.scene.mapped, self.scene.chart = True, None if walls is None else Chart(walls)
        self.scene.world = world

    def update(self, at: float, key: str, message: Message) -> list[Finding]:
        """Process one message, received at a time (s). Returns what it shows.

        With an empty `key` the publishers of a kind are not told apart.
        """
        if isinstance(message, Truth) and not self.scene.own(message):
            return []
        if isinstance(message, Scan) and not is_readable(message):
            return []
        kind, scene = type(message), self.scene
        of_wheels = not isinstance(message, Ack) or message.resource == WHEELS.name
        if of_wheels:
            # One that is repeated shows nothing, so a stream of them is a gap.
            if isinstance(message, (*EACH_CYCLE, Truth)) and self._is_late(key, message):
                return []
            self._arrive(kind, key, max(at, scene.now))
        scene.update(at, message)
        if of_wheels and isinstance(message, EACH_CYCLE):
            self._count(message)
        self._driven = self._driven or scene.driving
        if self._held_at is None and scene.holder:
            self._held_at = scene.now
        handlers = self._handlers.get(kind)
        if handlers is None:
            found = ((rule, handler_of(rule, kind)) for rule in self._rules)
            handlers = self._handlers[kind] = [
                (rule, handle) for rule, handle in found if handle is not None
            ]
        return self._keep(
            (rule, each) for rule, handle in handlers for each in handle(message, scene) or ()
        )

    def tick(self, at: float) -> list[Finding]:
        """Time has passed without a message."""
        self.scene.now = max(self.scene.now, at)
        return self._keep((rule, each) for rule in self._timed for each in rule.on_time(self.scene))

    def disturbed(self, why: str) -> None:
        """From now on the observer knows of a disturbance that excuses outcomes; "": of none."""
        self.scene.disturbed = why

    def _arrive(self, kind: type[Message], key: str, at: float) -> None:
        deadline_s = _deadline_s(kind) if issubclass(kind, self._used) else None
        if deadline_s is not None:
            by = kind, "" if service_of(kind).kind is Kind.LATCHED else key  # of any publisher
            if by not in self._pauses:
                # While the robot is driven, all that is needed to judge it should come.
                since = at if kind in self._seen or self._held_at is None else self._held_at
                self._pauses[by] = Pauses(since, deadline_s)
            self._pauses[by].add(at)
        self._seen.add(kind)

    def _is_late(self, key: str, message: EachCycle | Truth) -> bool:
        """Whether it repeats the newest of its kind, or came after it, and shows no present."""
        by = type(message), key, message.sensor if isinstance(message, Obstacles) else ""
        newest = self._newest.get(by)
        if newest is not None:
            behind = _behind(newest, message)
            if 0.0 < behind <= LATE or (behind == 0.0 and newest == message):
                return True
        self._newest[by] = message
        return False

    def _count(self, message: EachCycle) -> None:
        kind, cycle = type(message), message.cycle
        before, received, passed = self._counts.get(kind, (cycle, 0, 0))
        if before.epoch == cycle.epoch:
            further = cycle.number - before.number
            if further <= 0 and kind in self._counts:
                return
            if further > 0:
                received, passed = received + 1, passed + further
                self._lasted_s += self.scene.state_gap_s if kind is RobotState else 0.0
        self._counts[kind] = cycle, received, passed

    def _missing(self, kind: type[Message]) -> float:
        """The share of a kind's messages that was not received; 0 if it is not known."""
        _, received, passed = self._counts.get(kind, (None, 0, 0))
        return 1.0 - received / passed if passed else 0.0

    @property
    def driven(self) -> bool:
        """Whether an agent was obeyed."""
        return self._held_at is not None

    @property
    def doubts(self) -> list[str]:
        """Why nothing that seems kept is known to be, a sentence each."""
        found, about = [], self.scene.description
        if (missing := self._missing(RobotState)) > MISSING:
            found.append(f"{missing:.0%} of the robot's states are missing")
        _, _, passed = self._counts.get(RobotState, (None, 0, 0))
        cycles_s = 0.0 if about is None else passed * about.cycle_s
        if cycles_s > max(FASTER * self._lasted_s, BURST_S):
            found.append(
                f"the robot's cycles of {cycles_s:.1f} s came within {self._lasted_s:.1f} s: these"
                " are not the times at which they were sent"
            )
        return found

    def report(self, unread: str = "") -> list[Finding]:
        """One finding for each promise: broken, unknown, or kept.

        What was kept as far as was judged is unknown if something was not judged: for the reason
        `unread`, or by `doubts`.
        """
        why, *_ = (unread or next(iter(self.doubts), "")).partition(";")
        return [self._verdict(rule, why) for rule in self._rules]

    def _verdict(self, rule: Rule, unread: str) -> Finding:
        own = [each for each in self.findings if each.promise is rule.promise]
        for answer in (Answer.NO, Answer.UNKNOWN):
            those = [each for each in own if each.answer is answer]
            if those:
                return those[0]
        lacking = self._lacking(rule, *self._reads(rule))
        uncharted = rule.charted and self.scene.chart is None
        if lacking:
            what = f"not checked: {lacking}"
        elif uncharted:
            unmet = "" if self.scene.mapped is not None else ", as no agent's card was received"
            what = f"not checked: the robot's map is not known{unmet}"
        elif lacks := self._gaps(rule) or self._thin(rule):
            return rule.found(self.scene, "", lacks, answer=Answer.UNKNOWN)
        elif not rule.checked:
            what = "not checked: there was no occasion"
        elif rule.pending:
            what = f"not checked: {rule.pending}"
        elif unread:
            what = f"kept as far as was judged: {unread}"
            return rule.found(self.scene, "", what, answer=Answer.UNKNOWN)
        else:
            return rule.found(self.scene, "", "kept", answer=Answer.YES)
        found = rule.found(self.scene, "", what, answer=Answer.UNKNOWN)
        occasion = bool(lacking) or (uncharted and self.scene.mapped is not False) or rule.due
        return replace(found, occasion=occasion)

    def _reads(self, rule: Rule) -> list[type[Message]]:
        """The readings of the robot's sensors that a rule uses."""
        about = self.scene.description
        return [] if about is None else [each for each in reads_of(about) if each in rule.sees]

    def _lacking(self, rule: Rule, *others: type[Message]) -> str:
        """Which messages that a rule needs, or of the others, were never received; "" if none."""
        no_path = not self._driven and self._has(MissionStatus)
        no_command = self._held_at is None and self._has(Ack)
        spared = {kind for kind, none in ((Trajectory, no_path), (Command, no_command)) if none}
        needs = (*rule.needs, *others)
        lacking = [kind.__name__ for kind in needs if not self._has(kind, *spared)]
        return f"no {', '.join(lacking)} received" if lacking else ""

    def _thin(self, rule: Rule) -> str:
        """Which messages a rule lacks in too many cycles; "" if none."""
        kinds = [kind for kind in EACH_CYCLE if kind in (*rule.needs, *rule.sees)]
        shares = {kind.__name__: self._missing(kind) for kind in kinds}
        thin = [f"{share:.0%} of {name}" for name, share in shares.items() if share > MISSING]
        return f"not checked: {', '.join(thin)} missing" if thin else ""

    def _gaps(self, rule: Rule) -> str:
        """When a rule lacks periodic messages that it received otherwise; "" if it does not.

        What happened then cannot be judged, so nothing is known to be kept, nor that there was no
        occasion.
        """
        gaps = self.gaps(*rule.needs, *rule.sees)
        so_far = "kept as far as was judged" if rule.checked and not rule.pending else "not checked"
        return f"{so_far}: {gaps}" if gaps else ""

    def gaps(self, *kinds: type[Message], begun: float = 0.0) -> str:
        """When periodic messages of these kinds did not come, in times from `begun`; "" if never.

        Of each kind the first gap is named.
        """
        found = dict[str, set[str]]()
        for (kind, _), pauses in self._pauses.items():
            if issubclass(kind, kinds) and (when := pauses.gap(self.scene.now, begun)):
                found.setdefault(when, set()).add(kind.__name__)
        return ", ".join(
            f"no {', '.join(sorted(names))} received {when}" for when, names in found.items()
        )

    def _has(self, kind: type[Message], *spared: type[Message]) -> bool:
        return kind in spared or any(issubclass(each, kind) for each in self._seen)

    def _keep(self, found: Iterable[tuple[Rule, Finding]]) -> list[Finding]:
        """Keep findings. One that lacks what its rule needs accuses nobody: it is unknown."""
        new = []
        for rule, each in found:
            lacking = self._lacking(rule) if each.answer is Answer.NO else ""
            what = f"{each.what}; not checked: {lacking}"
            new.append(replace(each, what=what, answer=Answer.UNKNOWN) if lacking else each)
        self.findings += new
        return new
