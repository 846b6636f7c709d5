"""The auditor: messages in, findings out; sans-IO."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import inf
from typing import Final

from armadico.config.worlds import World
from armadico.core.judgement import Answer
from armadico.core.messages import Ack, Command, Cycle, Message, RobotState
from armadico.core.resources import WHEELS
from armadico.core.services import derived, service_of
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
from armadico.observe.audit.poses import Doubts, Found, Heading, Moves, Rated, Scaled
from armadico.observe.audit.promises import Excuse, Finding
from armadico.observe.audit.reflexes import Reflexes
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import SHOWN, Scene
from armadico.observe.audit.sensing import Changes, Fits, Renewed, Sees, Shown
from armadico.observe.audit.walls import Compared

RULES: Final[tuple[type[Rule], ...]] = (
    *(
        Touched,
        Arrives,
        Ends,
        Reached,
        Visits,
        Failed,
        Refuses,
        Waits,
        Found,
        Doubts,
        Leads,
        Clears,
    ),
    *(Stands, Honest, Earned, Reflexes, Steady, Speed, Brakes, Turns),
    *(
        OneDriver,
        Fresh,
        Ordered,
        Held,
        Stopped,
        Heading,
        Scaled,
        Rated,
        Moves,
        Changes,
        Renewed,
        Fits,
        Sees,
        Compared,
        Shown,
    ),
)

ENDED_S: Final = 2.0
"""A periodic message that is missing at the end for longer, s, has stopped: agents that are ended
together do not end at the same moment."""

MISSING: Final = 0.2
"""If more of the robot's states than this share are missing, nothing counts as kept. A speed,
a stop or a change of the agent that drives may lie between the others. If others of `EACH_CYCLE`
are, what needs them does not."""

EACH_CYCLE: Final = (RobotState, Ack, Pose, Scan, Obstacles)
"""Messages that come once a cycle (docs/protocol.md), so that the numbers of cycles tell how many
are missing. Of several sensors' obstacles the first of a cycle counts."""

FASTER: Final = 2.0
"""Cycles that pass faster than the robot's by this factor have a clock that is not the robot's."""

READINGS: Final[dict[str, type[Message]]] = {"sonar": Sonar, "laser": Scan}
"""What shows the readings of a sensor of `Description.sensors`."""


def watched() -> tuple[type[Message], ...]:
    """The installed messages that an auditor needs; a base stands for its subclasses."""
    kinds = dict.fromkeys((*SHOWN, *(kind for rule in RULES for kind in (*rule.needs, *rule.sees))))
    return tuple(kind for base in kinds for kind in derived(base))


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
        self._seen: dict[type[Message], float] = {}  # when each kind was last received, s
        self._driven = False  # there was a mission, so it must have had a path
        self._held = False  # an agent was obeyed, so it must have commanded
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
        new.scene.world = self.scene.world
        return new

    def chart(self, walls: Iterable[Wall] | None, world: World | None = None) -> None:
        """The robot was launched with a map of these walls, world frame, m; None: not at hand.

        `world` is that map with its rooms and goals.
        """
        self.scene.mapped, self.scene.chart = True, None if walls is None else Chart(walls)
        self.scene.world = world

    def update(self, at: float, key: str, message: Message) -> list[Finding]:  # noqa: ARG002
        """Process one message, received at a time (s). Returns what it shows."""
        if isinstance(message, Truth) and not self.scene.own(message):
            return []
        if isinstance(message, Scan) and not is_readable(message):
            return []
        of_wheels = not isinstance(message, Ack) or message.resource == WHEELS.name
        if of_wheels:
            self._seen[type(message)] = max(at, self.scene.now)
        self.scene.update(at, message)
        if of_wheels and isinstance(message, EACH_CYCLE):
            self._count(message)
        self._driven = self._driven or self.scene.driving
        self._held = self._held or bool(self.scene.holder)
        return self._keep(
            each for rule in self._rules for each in rule.on_message(message, self.scene)
        )

    def tick(self, at: float) -> list[Finding]:
        """Time has passed without a message."""
        self.scene.now = max(self.scene.now, at)
        return self._keep(each for rule in self._rules for each in rule.on_time(self.scene))

    def disturbed(self, why: str) -> None:
        """From now on the observer knows of a disturbance that excuses outcomes; "": of none."""
        self.scene.disturbed = why

    def _count(self, message: RobotState | Ack | Pose | Scan | Obstacles) -> None:
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
    def doubts(self) -> list[str]:
        """Why nothing that seems kept is known to be, a sentence each."""
        found, about = [], self.scene.description
        if (missing := self._missing(RobotState)) > MISSING:
            found.append(f"{missing:.0%} of the robot's states are missing")
        _, _, passed = self._counts.get(RobotState, (None, 0, 0))
        cycles_s = 0.0 if about is None else passed * about.cycle_s
        if cycles_s > FASTER * self._lasted_s > 0.0:
            found.append(
                f"the robot's cycles of {cycles_s:.1f} s came within {self._lasted_s:.1f} s: these"
                " are not the times at which they were sent"
            )
        return found

    def report(self) -> list[Finding]:
        """One finding for each promise: broken, unknown, or kept."""
        return [self._verdict(rule) for rule in self._rules]

    def _verdict(self, rule: Rule) -> Finding:
        own = [each for each in self.findings if each.promise is rule.promise]
        for answer in (Answer.NO, Answer.UNKNOWN):
            those = [each for each in own if each.answer is answer]
            if those:
                return those[0]
        no_path = not self._driven and self._has(MissionStatus)
        no_command = not self._held and self._has(Ack)
        spared = {kind for kind, none in ((Trajectory, no_path), (Command, no_command)) if none}
        lacking = [kind.__name__ for kind in rule.needs if not self._has(kind, *spared)]
        if self.scene.description is not None:
            reads = [READINGS[name] for name in self.scene.description.sensors if name in READINGS]
            lacking += [one.__name__ for one in reads if one in rule.sees and not self._has(one)]
        uncharted = rule.charted and self.scene.chart is None
        if lacking:
            what = f"not checked: no {', '.join(lacking)} received"
        elif uncharted:
            unmet = "" if self.scene.mapped is not None else ", as no agent's card was received"
            what = f"not checked: the robot's map is not known{unmet}"
        elif not rule.checked:
            what = "not checked: there was no occasion"
        elif rule.pending:
            what = f"not checked: {rule.pending}"
        elif lacks := self._thin(rule) or self._ended(rule):
            return rule.found(self.scene, "", lacks, answer=Answer.UNKNOWN)
        else:
            return rule.found(self.scene, "", "kept", answer=Answer.YES)
        found = rule.found(self.scene, "", what, answer=Answer.UNKNOWN)
        occasion = bool(lacking) or (uncharted and self.scene.mapped is not False) or rule.due
        return replace(found, occasion=occasion)

    def _thin(self, rule: Rule) -> str:
        """Which messages a rule lacks in too many cycles; "" if none."""
        kinds = [kind for kind in EACH_CYCLE if kind in (*rule.needs, *rule.sees)]
        shares = {kind.__name__: self._missing(kind) for kind in kinds}
        thin = [f"{share:.0%} of {name}" for name, share in shares.items() if share > MISSING]
        return f"not checked: {', '.join(thin)} missing" if thin else ""

    def _ended(self, rule: Rule) -> str:
        """Since when a rule lacks periodic messages that it received before; "" if it does not.

        What happened after them cannot be judged, so nothing is known to be kept until the end.
        """
        kinds = (*rule.needs, *rule.sees)
        seen = ((kind, at) for kind, at in self._seen.items() if issubclass(kind, kinds))
        over = {
            kind.__name__: at
            for kind, at in seen
            if self.scene.now - at > max(2.0 * (service_of(kind).deadline_s or inf), ENDED_S)
        }
        if not over:
            return ""
        first = min(over.values())
        names = ", ".join(sorted(over))
        return f"kept until {first:.1f} s, unknown after: no {names} received to the end"

    def _has(self, kind: type[Message], *spared: type[Message]) -> bool:
        return kind in spared or any(issubclass(each, kind) for each in self._seen)

    def _keep(self, found: Iterable[Finding]) -> list[Finding]:
        new = list(found)
        self.findings += new
        return new
