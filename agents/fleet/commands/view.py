"""The measures of a fleet's run: messages of all its robots in, one row out (sans-IO)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot, inf
from typing import Final

from msgspec import Struct

from armadico.agents.fleet.messages import FleetClaims, FleetStatus
from armadico.core.judgement import Judgement, all_of, no, unknown, yes
from armadico.core.messages import Award, Description, Message, Proposal
from armadico.mobile.messages import FleetAwards, FleetPose, FleetProposals, Truth
from armadico.observe.contention import Contention
from armadico.observe.ground_truth import GroundTruth
from armadico.observe.view import View


class RobotRow(Struct, frozen=True):
    robot: str
    tasks: tuple[int, ...]  # that it did, in order
    way_m: float  # by the truth; without it, by its published poses
    collisions: int | None  # by its own motion, as far as the truth goes; None without the truth
    bumped: int | None  # by the motion of others
    min_clearance_m: float | None


class FleetResult(Struct, frozen=True):
    """The result of one run of a fleet.

    `unreachable` are tasks that every robot has given up. `makespan_s` is the time from accepting
    the list until the last task was done; null if some were not. `twice` are tasks done by two
    robots, `unsure` those of which it is unknown whether the robot was there, by the deviation of
    its pose. `contended` counts the cycles in which two robots, or two agents of one, wanted what a
    chosen mechanism decides about, null by ballots and if it is not known; `undecided` tells of a
    mechanism that had nothing to decide. `messages` is the number of messages for sharing, without
    poses, per task. `judgement` is the conclusion: without the truth of each robot nobody knows
    whether one touched anything.
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
    unsure: tuple[int, ...] = ()
    judgement: Judgement = unknown("nothing was judged")
    contended: int | None = None
    undecided: str = ""

    @property
    def passed(self) -> bool:
        """Whether the judgement is yes: all tasks done, none twice, and no collision."""
        return self.judgement.passed

    @property
    def verdict(self) -> str:
        took = "" if self.makespan_s is None else f" in {self.makespan_s:.1f} s"
        left = ", ".join(map(str, self.unreachable))
        unreached = f"; no robot reaches {left}" if left else ""
        unsure = f", {len(self.unsure)} of them unsure" if self.unsure else ""
        limit = "" if self.limit_s is None else f"; time limit of {self.limit_s:.0f} s"
        known = [row.collisions for row in self.robots if row.collisions is not None]
        least = " or more" if known and len(known) < len(self.robots) else ""
        touched = f", {sum(known)}{least} collisions" if known else ", collisions unknown"
        return (
            f"{self.done} of {self.tasks} tasks done{took} by {len(self.robots)} robots,"
            f" {len(self.twice)} twice; {self.messages:.0f} messages a task{touched}"
            f"{unreached}{unsure}{limit}"
        )


# A robot whose fleet agent is silent for this time holds no task that the others respect.
SILENT_S: Final = 5.0

# The path driven is counted in steps of this: poses of a standing robot are corrected, too.
POSES_M: Final = 0.05


@dataclass
class _Robot:
    tasks: list[int] = field(default_factory=list)
    way: float = 0.0  # by the truth
    posed: float = 0.0  # by its poses
    pose: FleetPose | None = None  # the last one that was counted
    view: View = field(default_factory=View)  # which tells its simulator from others
    truth: GroundTruth = field(default_factory=GroundTruth)
    clearance: float | None = None


@dataclass
class FleetWatch:
    """Measures one run: call `begin` when the list is accepted, then `update` for each message."""

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
    lost: str = ""  # why the run could not be watched until its end
    status: dict[str, FleetStatus] = field(default_factory=dict)
    contention: Contention = field(default_factory=lambda: Contention({}))
    _status_at: dict[str, float] = field(default_factory=dict)  # each robot's last status
    # The tasks that each robot has given up, and the time of that message.
    _given_up: dict[str, tuple[float, frozenset[int]]] = field(default_factory=dict)
    _robots: dict[str, _Robot] = field(default_factory=dict)
    _unsure: set[int] = field(default_factory=set)

    def begin(self, list_id: int, now: float) -> None:
        """Begin to measure: the list is accepted."""
        self.list, self.began = list_id, now
        for one in self._robots.values():
            one.truth.begin(now)

    def end(self, limit: float) -> None:
        """End at the time limit, s."""
        self.limit = limit

    def lose(self, why: str) -> None:
        """From now on nothing is known, as when the simulator has ended."""
        for name in self.names:
            self._one(name).truth.lose(why)
        self.lost = why

    def update(self, robot: str, message: Message, now: float) -> None:
        """Process a message of a robot's agents or simulator."""
        self.now = now
        if isinstance(message, FleetPose):
            self._follow(message)
            return
        one = self._one(robot)
        for each in _bids(message):
            # What agents of one robot want has cycles of its own.
            self.contention.update(each, "" if each is message else robot)
        if isinstance(message, FleetStatus):
            self.status[robot], self._status_at[robot] = message, now
        elif isinstance(message, FleetClaims):
            self._on_claims(message)
        elif isinstance(message, FleetProposals | FleetAwards):
            self._count(message)
        elif isinstance(message, Truth | Description):
            one.view.learn(message, now)
            if message is one.view.truth:
                self._on_truth(one, one.view.truth)

    def _on_truth(self, one: _Robot, truth: Truth) -> None:
        before = one.truth.newest
        if not one.truth.add(truth, self.now):
            return
        if before is not None and self._counts:
            one.way += hypot(truth.x - before.x, truth.y - before.y)
        if truth.clearance is not None:
            known = truth.clearance if one.clearance is None else one.clearance
            one.clearance = min(known, truth.clearance)

    def _one(self, name: str) -> _Robot:
        if name not in self._robots:
            self._robots[name] = one = _Robot()
            if self.began is not None:  # it has come during the run
                one.truth.begin(self.now)
        return self._robots[name]

    def _follow(self, pose: FleetPose) -> None:
        one = self._one(pose.robot)
        step = 0.0 if one.pose is None else hypot(pose.x - one.pose.x, pose.y - one.pose.y)
        if one.pose is None or step >= POSES_M:
            one.pose = pose
            one.posed += step if self._counts else 0.0

    @property
    def _counts(self) -> bool:
        """Whether the list is worked on."""
        return self.began is not None and self.ended is None

    def silent(self, robot: str, now: float) -> bool:
        """Return whether a robot's fleet agent is silent."""
        return now - self._status_at.get(robot, -inf) >= SILENT_S

    def _on_claims(self, message: FleetClaims) -> None:
        if self.began is None:
            return
        of_it = message.cycle.epoch == self.list
        self._given_up[message.robot] = self.now, frozenset(message.given_up if of_it else ())
        if not of_it:
            return
        self._count(message)
        for each in message.done:
            did = self._one(each.by).tasks
            if each.task not in did:
                did.append(each.task)
                self._unsure |= {each.task} if each.unsure else set()
        if self.ended is None and len(self.done) == self.tasks:
            self.ended = self.now

    def _count(self, message: FleetClaims | FleetProposals | FleetAwards) -> None:
        """Count a message for sharing the list."""
        of_it = self.began is not None and message.cycle.epoch == self.list
        self.messages += of_it and self.ended is None

    @property
    def done(self) -> set[int]:
        """Tasks that any robot reports as done."""
        return {task for one in self._robots.values() for task in one.tasks}

    @property
    def over(self) -> bool:
        """Whether all is done, except tasks that no robot can reach."""
        return self.ended is not None or bool(self.unreachable)

    @property
    def unreachable(self) -> tuple[int, ...]:
        """The tasks that are not done, if every publishing robot has given them up; else none."""
        given = [each for at, each in self._given_up.values() if self.now - at < SILENT_S]
        left = set(range(self.tasks)) - self.done
        return tuple(sorted(left)) if given and all(left <= each for each in given) else ()

    @property
    def remark(self) -> str:
        """The progress in a line."""
        holds = ", ".join(
            f"{name} {'silent' if self.silent(name, self.now) else len(status.holds)}"
            for name, status in sorted(self.status.items())
        )
        return f"{len(self.done)} of {self.tasks} done; held: {holds or 'none'}"

    def result(self) -> FleetResult:
        """Return the results so far."""
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
            unsure=tuple(sorted(self._unsure)),
            judgement=self.judge(),
            contended=self.contention.least,
            undecided=self.contention.undecided,
        )

    def judge(self) -> Judgement:
        """Whether all tasks are done, none twice, and without a collision."""
        found = [self._tasks_done()]
        for name in self.names:
            truth = self._robots.get(name, _Robot()).truth
            found.append(truth.touched(self.now, f"{name}'s collisions"))
            if truth.bumped:
                found.append(no(f"{name} was run into {truth.bumped} times"))
        return all_of(found)

    def _tasks_done(self) -> Judgement:
        did = [task for one in self._robots.values() for task in one.tasks]
        if len(did) > len(set(did)):
            return no("a task was done twice")
        if len(self.done) == self.tasks:
            unsure = ", ".join(map(str, sorted(self._unsure)))
            return unknown(f"whether a robot was there: task {unsure}") if unsure else yes()
        count = f"{len(self.done)} of {self.tasks} tasks done"
        return unknown(f"{count}; {self.lost}") if self.lost else no(count)

    def _row(self, name: str) -> RobotRow:
        one = self._robots.get(name, _Robot())
        touched, bumped = one.truth.collisions, one.truth.bumped
        clearance = None if one.clearance is None else round(one.clearance, 3)
        way = round(one.posed if one.truth.newest is None else one.way, 2)
        return RobotRow(name, tuple(one.tasks), way, touched, bumped, clearance)


def _bids(message: Message) -> Sequence[Message]:
    """What a message of a robot tells of its agents' bids."""
    if isinstance(message, FleetProposals):
        return message.proposals
    return message.claims if isinstance(message, FleetClaims) else (message,)


# The messages that a `FleetWatch` needs.
FLEET_WATCHED: tuple[type[Message], ...] = (
    FleetStatus,
    FleetClaims,
    FleetPose,
    FleetProposals,
    FleetAwards,
    Proposal,
    Award,
    Truth,
    Description,
)
