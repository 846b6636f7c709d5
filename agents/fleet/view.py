"""The measures of a fleet's run: messages of all its robots in, one row out (sans-IO)."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, inf
from typing import Final

from msgspec import Struct

from armadico.agents.fleet.messages import FleetClaims, FleetStatus
from armadico.core.messages import Message
from armadico.mobile.messages import FleetPose, Truth


class RobotRow(Struct, frozen=True):
    robot: str
    tasks: tuple[int, ...]  # that it did, in its order
    way_m: float  # by the truth; without, by the poses that it tells the others
    collisions: int | None  # of its own motion; by the truth, None without
    bumped: int | None  # somebody ran into it
    min_clearance_m: float | None


class FleetResult(Struct, frozen=True):
    """One run of a fleet.

    `unreachable` are tasks that every robot has given up. `makespan_s` is from the moment that the
    list was taken on until the last task was done; null if some were not. `twice` has those that
    two robots did. `messages` are those by which the tasks were shared, poses apart, for one task.
    """

    scenario: str
    seed: int
    robots: tuple[RobotRow, ...]
    tasks: int
    done: int
    twice: tuple[int, ...]
    makespan_s: float | None
    messages: float
    limit_s: float | None = None
    note: str = ""
    unreachable: tuple[int, ...] = ()

    @property
    def passed(self) -> bool:
        """All done, none twice, and nothing touched as far as a simulator tells."""
        touched = any(row.collisions or row.bumped for row in self.robots)
        return self.done == self.tasks and not self.twice and not touched

    @property
    def verdict(self) -> str:
        took = "" if self.makespan_s is None else f" in {self.makespan_s:.1f} s"
        left = ", ".join(map(str, self.unreachable))
        nobody = f"; nobody gets to {left}" if left else ""
        limit = "" if self.limit_s is None else f"; time limit of {self.limit_s:.0f} s"
        known = [row.collisions for row in self.robots if row.collisions is not None]
        touched = f", {sum(known)} collisions" if known else ""
        return (
            f"{self.done} of {self.tasks} tasks done{took} by {len(self.robots)} robots,"
            f" {len(self.twice)} twice; {self.messages:.0f} messages a task{touched}{nobody}{limit}"
        )


SILENT_S: Final = 5.0
"""Whose fleet agent has said nothing for so long holds nothing that the others would leave it."""

POSES_M: Final = 0.05
"""Poses of a robot that stands are corrected now and then: a way is counted in steps of this."""


@dataclass
class _Robot:
    tasks: list[int] = field(default_factory=list)
    way: float = 0.0  # by the truth
    told: float = 0.0  # by its poses
    pose: FleetPose | None = None  # as far as which that is counted
    truth: Truth | None = None
    first: Truth | None = None
    clearance: float | None = None


@dataclass
class FleetWatch:
    """Watches one run: say `begin` when the list is taken on, then show it every message."""

    scenario: str
    names: tuple[str, ...]
    tasks: int
    seed: int = 0
    now: float = 0.0
    began: float | None = None
    list: int = 0
    ended: float | None = None
    messages: int = 0
    limit: float | None = None
    note: str = ""
    status: dict[str, FleetStatus] = field(default_factory=dict)
    _said: dict[str, float] = field(default_factory=dict)  # when each robot's last status came
    # What each robot has given up, and when it spoke.
    _given_up: dict[str, tuple[float, frozenset[int]]] = field(default_factory=dict)
    _robots: dict[str, _Robot] = field(default_factory=dict)

    def begin(self, list_id: int, now: float) -> None:
        """The list is taken on."""
        self.list, self.began = list_id, now

    def end(self, limit: float) -> None:
        """The time that it may take (s) is over."""
        self.limit = limit

    def update(self, robot: str, message: Message, now: float) -> None:
        """Take one message that a robot's agents or simulator published."""
        self.now = now
        if isinstance(message, FleetPose):
            self._follow(message)
            return
        one = self._robots.setdefault(robot, _Robot())
        if isinstance(message, FleetStatus):
            self.status[robot], self._said[robot] = message, now
        elif isinstance(message, FleetClaims):
            self._on_claims(message)
        elif isinstance(message, Truth):
            if one.truth is not None and self._counts:
                one.way += hypot(message.x - one.truth.x, message.y - one.truth.y)
            one.truth, one.first = message, one.first or message
            if message.clearance is not None:
                known = message.clearance if one.clearance is None else one.clearance
                one.clearance = min(known, message.clearance)

    def _follow(self, said: FleetPose) -> None:
        one = self._robots.setdefault(said.robot, _Robot())
        step = 0.0 if one.pose is None else hypot(said.x - one.pose.x, said.y - one.pose.y)
        if one.pose is None or step >= POSES_M:
            one.pose = said
            one.told += step if self._counts else 0.0

    @property
    def _counts(self) -> bool:
        """Whether the list is worked on."""
        return self.began is not None and self.ended is None

    def silent(self, robot: str, now: float) -> bool:
        """Whether nothing of a robot's fleet agent has come lately."""
        return now - self._said.get(robot, -inf) >= SILENT_S

    def _on_claims(self, said: FleetClaims) -> None:
        if self.began is None:
            return
        of_it = said.cycle.epoch == self.list
        self._given_up[said.robot] = self.now, frozenset(said.given_up if of_it else ())
        if not of_it:
            return
        self.messages += self.ended is None
        for each in said.done:
            did = self._robots.setdefault(each.by, _Robot()).tasks
            if each.task not in did:
                did.append(each.task)
        if self.ended is None and len(self.done) == self.tasks:
            self.ended = self.now

    @property
    def done(self) -> set[int]:
        """Tasks that anybody says are done."""
        return {task for one in self._robots.values() for task in one.tasks}

    @property
    def over(self) -> bool:
        """Whether all is done, but for what nobody gets to."""
        return self.ended is not None or bool(self.unreachable)

    @property
    def unreachable(self) -> tuple[int, ...]:
        """All that is not done, if every robot that speaks has given it up; else none."""
        given = [each for at, each in self._given_up.values() if self.now - at < SILENT_S]
        left = set(range(self.tasks)) - self.done
        return tuple(sorted(left)) if given and all(left <= each for each in given) else ()

    @property
    def remark(self) -> str:
        """How far it is, for people."""
        holds = ", ".join(
            f"{name} {'silent' if self.silent(name, self.now) else len(status.holds)}"
            for name, status in sorted(self.status.items())
        )
        return f"{len(self.done)} of {self.tasks} done; held: {holds or 'none'}"

    def result(self) -> FleetResult:
        """The row, as far as it has come."""
        did = [task for one in self._robots.values() for task in one.tasks]
        took = None
        if self.ended is not None and self.began is not None:
            took = round(self.ended - self.began, 2)
        return FleetResult(
            scenario=self.scenario,
            seed=self.seed,
            robots=tuple(self._row(name) for name in self.names),
            tasks=self.tasks,
            done=len(self.done),
            twice=tuple(sorted({task for task in did if did.count(task) > 1})),
            makespan_s=took,
            messages=round(self.messages / max(self.tasks, 1), 1),
            limit_s=None if self.over else self.limit,
            note=self.note,
            unreachable=self.unreachable,
        )

    def _row(self, name: str) -> RobotRow:
        one = self._robots.get(name, _Robot())
        truth, first = one.truth, one.first
        touched = bumped = None
        if truth is not None and first is not None:
            bumped = truth.bumped - first.bumped
            touched = truth.collisions - first.collisions - bumped
        clearance = None if one.clearance is None else round(one.clearance, 3)
        way = round(one.told if truth is None else one.way, 2)
        return RobotRow(name, tuple(one.tasks), way, touched, bumped, clearance)


FLEET_WATCHED: tuple[type[Message], ...] = (FleetStatus, FleetClaims, FleetPose, Truth)
"""What a `FleetWatch` wants to be shown."""
