"""The auditor on small sequences of messages: what each rule finds, and what excuses a robot."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from math import cos, inf, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.config.worlds import load_world
from armadico.core.hands import Hand
from armadico.core.judgement import Answer
from armadico.core.messages import (
    Ack,
    Ballot,
    Command,
    Cycle,
    Description,
    Message,
    Parameter,
    ParametersReply,
    Point,
    RobotState,
    Stop,
    Twist,
)
from armadico.core.names import handler_name
from armadico.mobile.errand import Errands, Progress, StepDone
from armadico.mobile.messages import (
    ByHand,
    Correction,
    Echo,
    InitialPose,
    Leading,
    MissionState,
    MissionStatus,
    Pose,
    Scan,
    Sonar,
    Trajectory,
    Truth,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import packed
from armadico.observe.audit import missions
from armadico.observe.audit.auditor import RULES, Auditor, watched
from armadico.observe.audit.chart import Chart
from armadico.observe.audit.coordination import OneDriver
from armadico.observe.audit.driving import Honest
from armadico.observe.audit.live import Live
from armadico.observe.audit.missions import Reached, Visits
from armadico.observe.audit.paths import Leads
from armadico.observe.audit.poses import Claims
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene
from armadico.observe.audit.sensing import Fits, Sees

GOTO, AVOID = "goto-0123456789ab", "avoid-0123456789ab"
SURE = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
LOST = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
DOUBTS = (0.03, 0.0, 0.0, 1e-4, 0.0, 1e-4)
ROUGH = (0.16, 0.0, 0.0, 1e-4, 0.0, 1e-4)
ROBOT = Description(
    *("pioneer", 0.1, 0.2, 0.2, 0.2, 1.2, 3.0, 0.3, 0.6, 1.0, 1.0, 0.3, 2.0),
    simulator="sim",
)


GOES = Stop()
NO_MISSION = MissionStatus(0, MissionState.NONE, 0.0)
STANDS_STILL = {"v": 0.0, "ordered": 0.0}


@dataclass
class Drive:
    """A robot that drives straight on along a free path of 10 m, as it should."""

    auditor: Auditor = field(default_factory=lambda: Auditor(v_max=inf))
    now: float = 0.0
    number: int = 0
    x: float = 0.0
    v: float = 0.75  # measured
    w: float = 0.0
    ordered: float = 0.75
    commanded: float | None = None  # None: as ordered
    admitted: float | None = None  # None: as ordered
    turns: float = 0.0  # ordered and admitted, rad/s
    truly: float = 1.0  # driven in truth, as a share of the odometry
    capped: str = ""
    holder: str = GOTO
    term: int = 1
    stop: Stop = GOES
    fault: str = ""
    stalled: bool = False
    touch: Point | None = None
    covariance: tuple[float, ...] = SURE
    ahead: tuple[Point, ...] = ()
    renews: float = 1e-6  # m, by which obstacles move aside in a cycle
    waits: bool = False
    contacts: int = 0
    off: float = 0.0  # of the pose, m
    status: MissionStatus = NO_MISSION
    mission: int = 1
    says: Callable[[Drive], tuple[Message, ...]] = lambda _: ()
    theta: float = 0.0
    way: tuple[Waypoint, ...] = ()
    path: Trajectory | None = None
    mapped: bool = True
    revision: int = 0
    said: list[tuple[float, Message]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.auditor.scene.mapped = self.mapped
        self.say(ROBOT)
        self.begin()

    def say(self, *messages: Message) -> None:
        for message in messages:
            self.said.append((self.now, message))
            self.auditor.update(self.now, "", message)

    def begin(self, length: float = 10.0) -> None:
        self.way = (Waypoint(self.x + length, 0.0, 0.0),)
        self.path = Trajectory(1, self.mission, self.way, Point(self.x, 0.0), waits=self.waits)
        self.say(self.path)
        self._say_status(MissionState.DRIVING, length)

    def end(self, state: MissionState, note: str = "") -> None:
        self.way = ()
        self._say_status(state, 0.0, note)

    def _say_status(self, state: MissionState, to_go: float, note: str = "") -> None:
        self.status = MissionStatus(self.mission, state, to_go, note=note)
        self.say(self.status)

    def go(self, seconds: float, **now: object) -> Drive:
        for name, value in now.items():
            setattr(self, name, value)
        for _ in range(round(10 * seconds)):
            self._cycle()
        return self

    def _cycle(self) -> None:
        self.now, self.number = round(self.now + 0.1, 3), self.number + 1
        self.theta += 0.1 * self.w
        self.x += 0.1 * self.v * cos(self.theta)
        cycle = Cycle(1, self.number)
        admitted = self.ordered if self.admitted is None else self.admitted
        rests, ballot = Twist(0.0, 0.0), Ballot(self.term, 0.6, False, self.holder or "nobody")
        by = ballot if self.holder else None
        commanded = self.ordered if self.commanded is None else self.commanded
        if self.number % 5 == 0:
            self.say(self.status)
        if self.number % 10 == 0 and self.path is not None:
            self.say(self.path)
        if by is not None:
            self.say(Command("wheels", cycle, by, (commanded, self.turns)))
        self.say(
            Truth(self.now, self.truly * self.x, 0, 0, self.v, self.w, self.contacts, 1.0, "sim"),
            RobotState(
                *(cycle, self.x, 0, self.theta, self.v, self.w, 12, True, self.stalled, self.stop),
                fault=self.fault,
                ordered=Twist(self.ordered, self.turns) if self.holder else rests,
                admitted=Twist(admitted, self.turns) if self.holder else rests,
                capped=self.capped,
                driver=self.holder,
                touch=self.touch,
            ),
            Ack("wheels", cycle, ballot, by, cycle if by else None, 0.6, False, (self.v, 0.0)),
            Pose(cycle, self.x + self.off, 0, 0, self.covariance, self.revision),
            Obstacles(cycle, None, None, None, None, self.points(self.ahead)),
            *self.says(self),
        )

    def points(self, ahead: tuple[Point, ...]) -> tuple[Point, ...]:
        """Obstacles in about these places: none stays exactly where it was."""
        return tuple(replace(p, y=p.y + self.renews * self.number) for p in ahead)

    @property
    def found(self) -> list[tuple[Promise, str]]:
        broken = (each for each in self.auditor.findings if each.answer is Answer.NO)
        return [(each.promise, each.who) for each in broken]


def test_a_drive_as_it_should_be_breaks_nothing_and_leaves_the_rest_unknown() -> None:
    drive = Drive().go(13.3)
    drive.end(MissionState.REACHED)
    assert drive.auditor.findings == [], "10 m in 13.3 s"
    verdicts = {each.promise: each for each in reversed(drive.auditor.report())}
    assert verdicts[Promise.ARRIVES].answer is Answer.YES
    assert verdicts[Promise.FAILED].answer is Answer.UNKNOWN, "none failed"
    assert "occasion" in verdicts[Promise.FAILED].what


def arrives(drive: Drive) -> Finding:
    return next(each for each in drive.auditor.report() if each.promise is Promise.ARRIVES)


def test_a_mission_that_goes_on_has_not_arrived_and_no_excuse_lets_it_pass() -> None:
    drive = Drive().go(13.3)
    assert arrives(drive).answer is Answer.UNKNOWN
    assert not arrives(drive).occasion, "it is not late yet"
    drive.go(200, v=0.0, ordered=0.0, covariance=LOST)
    assert Promise.ARRIVES not in [promise for promise, _ in drive.found]
    assert arrives(drive).answer is Answer.UNKNOWN
    assert arrives(drive).occasion
    assert "lost 200 s" in arrives(drive).what


def test_missing_states_and_another_clock_are_named() -> None:
    drive = Drive().go(10)
    assert drive.auditor.doubts == []
    kept, robot = Auditor(), [*range(0, 100, 3)]
    for number in robot:
        state = RobotState(Cycle(1, number), 0, 0, 0, 0, 0, 12, True, False, GOES)
        kept.update(number / 10.0, "", state)
    (why,) = kept.doubts
    assert why.startswith("67%")
    fast = Auditor()
    fast.update(0.0, "", ROBOT)
    for number in range(100):
        state = RobotState(Cycle(1, number), 0, 0, 0, 0, 0, 12, True, False, GOES)
        fast.update(number / 100.0, "", state)
    (why,) = fast.doubts
    assert "9.9 s came within 1.0 s" in why


def test_with_a_clock_that_stands_nothing_counts_as_kept() -> None:
    drive = whole()
    stuck = judged([(0.0, message) for _, message in drive.said], drive.auditor)
    assert {each.answer for each in stuck.values()} == {Answer.UNKNOWN}
    assert "within 0.0 s" in stuck[OneDriver].what


def test_neither_another_resources_acks_nor_silent_sensors_are_evidence() -> None:
    drive = Drive()
    drive.auditor.update(0.0, "", Ack("lamp", Cycle(1, 1)))
    drive.go(10)
    verdicts = {each.promise: each for each in drive.auditor.report()}
    assert "no Sonar" in verdicts[Promise.EARNED].what
    assert verdicts[Promise.EARNED].occasion
    without = Auditor()
    for message in (ROBOT, Ack("lamp", Cycle(1, 1))):
        without.update(0.0, "", message)
    verdicts = {each.promise: each for each in without.report()}
    assert "no Ack" in verdicts[Promise.FRESH].what


def test_a_stop_ends_by_a_release() -> None:
    drive = Drive().go(1, stop=Stop(1, True, "anna", 7), **STANDS_STILL)
    drive.go(1, stop=Stop(2, False, "", 7))
    drive.say(Stop(2, False, "ben", 7))
    drive.go(3)
    verdicts = {each.promise: each for each in drive.auditor.report()}
    assert verdicts[Promise.STOP].answer is Answer.YES


@cache
def whole() -> Drive:
    """A drive that gives most rules an occasion, and breaks none of their promises."""

    def says(d: Drive) -> tuple[Message, ...]:
        cycle = Cycle(1, d.number)
        far, ahead = 0.7 + 0.001 * (d.number % 7), 10.8 - d.x
        echoes = echo(far, LEFT), echo(ahead if ahead < 5.0 else None)
        around = tuple(Point(0.0, 0.9 + 0.001 * (d.number % 7)) for _ in range(2))
        xx, _, _, yy, _, aa = d.covariance
        said: list[Message] = [
            Sonar(cycle, 5.0, echoes),
            Obstacles(cycle, None, None, None, None, around),
            Correction(cycle, 0.0, 0.0, 0.0, (xx, 0.0, 0.0, yy, 0.0, aa), 1.0),
        ]
        if d.number % 5 == 0:
            way = Trajectory(d.number, d.mission, d.way, planned=True)
            said += [ROBOT, way]
        return tuple(said)

    drive = Drive()
    drive.auditor.chart([WALL, (11.0, -5.0, 11.0, 5.0)])
    drive.go(1, says=says, covariance=DOUBTS)
    drive.go(12.3, covariance=SURE)
    drive.end(MissionState.REACHED)
    drive.go(7, holder="", **STANDS_STILL)
    drive.say(Stop(1, True, "anna", 7))
    drive.go(2, stop=Stop(1, True, "anna", 7))
    drive.say(Stop(2, False, "anna", 7))
    drive.go(4, stop=GOES)
    return drive


def judged(said: list[tuple[float, Message]], like: Auditor) -> dict[type[Rule], Finding]:
    auditor = like.anew()
    for at, message in said:
        auditor.tick(at)
        auditor.update(at, "", message)
    return dict(zip(RULES, auditor.report(), strict=True))


@cache
def judged_whole() -> dict[type[Rule], Finding]:
    return judged(whole().said, whole().auditor)


def judged_of_a_part(
    said: list[tuple[float, Message]],
) -> tuple[dict[type[Rule], Finding], dict[type[Rule], Finding]]:
    """What that drive and a part of its messages show; by the part no more is kept or broken."""
    full, found = judged_whole(), judged(said, whole().auditor)
    for rule, each in found.items():
        assert each.answer in (Answer.UNKNOWN, full[rule].answer), (rule, each)
    return full, found


@pytest.mark.parametrize("until_s", [-inf, 7.0])
@pytest.mark.parametrize(
    "kind",
    [
        *(Ack, Command, Correction, Description, MissionStatus, Obstacles, Pose, RobotState),
        *(Sonar, Stop, Trajectory, Truth),
    ],
)
def test_without_a_kind_of_message_no_more_is_kept_or_broken_and_what_is_unknown_names_it(
    kind: type[Message], until_s: float
) -> None:
    drive = whole()
    said = [each for each in drive.said if each[0] < until_s or not isinstance(each[1], kind)]
    full, found = judged_of_a_part(said)
    assert Answer.NO not in {each.answer for each in full.values()}, full
    for rule, each in found.items():
        if each.answer is not full[rule].answer:
            assert each.occasion, (rule, each)
            assert kind.__name__ in each.what, (rule, each)
    assert until_s > 0.0 or full != found


@pytest.mark.parametrize("begins_s", [4.0, 15.0])
@pytest.mark.parametrize(
    "kind",
    [
        *(Ack, Correction, Description, MissionStatus, Obstacles, Pose, RobotState),
        *(Sonar, Trajectory, Truth),
    ],
)
def test_what_needs_a_kind_of_message_is_not_kept_over_a_gap_in_it(
    kind: type[Message], begins_s: float
) -> None:
    drive = whole()
    until_s = begins_s + 6.0
    said = [
        each
        for each in drive.said
        if not isinstance(each[1], kind) or not begins_s < each[0] < until_s
    ]
    (last, then) = (
        max(at for at, each in said if isinstance(each, kind) and at <= begins_s),
        min(at for at, each in said if isinstance(each, kind) and at >= until_s),
    )
    _, found = judged_of_a_part(said)
    needs = [rule for rule in RULES if kind in (*rule.needs, *rule.sees)]
    assert needs
    for rule in needs:
        each = found[rule]
        assert each.answer is Answer.UNKNOWN, (rule, each)
        assert each.occasion, (rule, each)
        assert kind.__name__ in each.what, (rule, each)
    gap = f"no {kind.__name__} received from {last:.1f} to {then:.1f} s"
    assert any(gap in found[rule].what for rule in needs), found


def test_a_gap_leaves_what_was_broken_elsewhere_broken() -> None:
    drive = Drive().go(2)
    drive.go(1, contacts=1)
    drive.now += 6.0
    drive.go(2)
    (found,) = (each for each in drive.auditor.report() if each.promise is Promise.COLLISION)
    assert found.answer is Answer.NO


def test_messages_that_begin_to_come_while_it_is_driven_were_missing_before() -> None:
    drive = whole()
    said = [each for each in drive.said if not isinstance(each[1], Truth) or each[0] > 6.0]
    (found,) = (
        each for each in judged(said, drive.auditor).values() if each.promise is Promise.COLLISION
    )
    assert found.answer is Answer.UNKNOWN
    assert "no Truth received from" in found.what


def test_one_of_two_publishers_that_pauses_leaves_unknown_what_it_shows() -> None:
    auditor = Auditor([Honest])
    for number in range(200):
        at, cycle = number / 10.0, Cycle(1, number)
        for name in ("sonar", "laser"):
            if name == "sonar" or not 50 < number < 110:
                seen = Obstacles(cycle, None, None, None, None, ())
                auditor.update(at, f"{name}/obstacles", seen)
        auditor.update(at, "robot/state", RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False, GOES))
        auditor.update(at, "resource/wheels/ack", Ack("wheels", cycle))
        if number % 10 == 0:
            auditor.update(at, "robot/description", ROBOT)
    (honest,) = auditor.report()
    assert honest.answer is Answer.UNKNOWN
    assert "no Obstacles received from 5.0 to 11.0 s" in honest.what


# What each rule finds -----------------------------------------------------------------------------

Story = Callable[[Drive], object]


def lazy(drive: Drive) -> None:
    drive.go(70, v=0.1, ordered=0.1, ahead=(Point(1.5, 0.4),))


def nobody(drive: Drive) -> None:
    drive.go(70, v=0.0, holder="", ahead=(Point(0.5, 0.4),))


def early(drive: Drive) -> None:
    drive.go(5)
    drive.end(MissionState.REACHED)


def elsewhere(drive: Drive) -> None:
    drive.go(12.7, off=0.5)
    drive.end(MissionState.REACHED)


def fails(drive: Drive) -> None:
    drive.go(5)
    drive.end(MissionState.FAILED, "no more")


def stays_lost(drive: Drive) -> None:
    drive.go(62, v=0.0, ordered=0.0, covariance=LOST)


def touches(drive: Drive) -> None:
    drive.go(2)
    drive.go(1, contacts=1)


def half(drive: Drive) -> None:
    drive.go(4, v=0.37, ordered=0.37)


def base_is_slow(drive: Drive) -> None:
    drive.go(4, v=0.3)


def stands(drive: Drive) -> None:
    drive.go(16, v=0.0, ordered=0.0)


def lies(drive: Drive) -> None:
    drive.go(1, v=0.2, ordered=0.5, ahead=(Point(0.22, 0.0),))


def is_capped(drive: Drive) -> None:
    drive.go(2, v=0.2, ordered=0.5, admitted=0.2, capped="0.2 m ahead are free")


def lets_through(drive: Drive) -> None:
    near = echo(0.1, 0.0)
    drive.go(1, v=0.4, ordered=0.4, says=lambda d: (Sonar(Cycle(1, d.number), 5.0, (near,)),))


def hunts(drive: Drive) -> None:
    for _ in range(11):
        drive.go(0.3, holder=GOTO, term=drive.term + 1)
        drive.go(0.3, holder=AVOID, term=drive.term + 1)


def rolls_on(drive: Drive) -> None:
    drive.go(2)
    drive.go(3, ordered=0.0, v=0.7)


def never_ends(drive: Drive) -> None:
    drive.go(13.3)
    drive.go(16, ahead=(Point(0.4, 0.0),), **STANDS_STILL)


def brakes_weakly(drive: Drive) -> None:
    drive.go(2)
    for step in range(20):
        drive.go(0.1, ordered=0.0, v=0.75 - 0.02 * step)


def obeys_otherwise(drive: Drive) -> None:
    drive.go(1, commanded=0.3)


def spins(drive: Drive) -> None:
    drive.go(3, turns=0.5, w=0.5)
    assert Promise.ORDERED not in {promise for promise, _ in drive.found}
    drive.go(5, w=0.8)


def is_stopped_as_it_spins(drive: Drive) -> None:
    drive.go(1).go(1, stop=Stop(1, True, Hand.DISOBEYS, 7), holder="")


def forgets_its_stop(drive: Drive) -> None:
    drive.say(Stop(1, True, "anna", 7))
    drive.go(1, stop=Stop(1, True, "anna", 7), **STANDS_STILL)
    drive.go(3, stop=Stop(2, False, "", 7))


def counts_too_much(drive: Drive) -> None:
    drive.go(10, truly=0.9)


def jumps(drive: Drive) -> None:
    drive.go(1)
    drive.go(0.1, off=1.0)


def goes_down(drive: Drive) -> None:
    drive.go(1, term=5)
    drive.go(0.1, term=4)


def moves_sideways(drive: Drive) -> None:
    drive.go(1)
    state = drive.auditor.scene.state
    assert state is not None
    drive.say(replace(state, cycle=Cycle(1, drive.number + 1), y=0.1))


def obeys_the_past(drive: Drive) -> None:
    drive.go(1)
    ballot = Ballot(drive.term, 0.6, False, GOTO)
    for back in (0, 6):
        cycle = Cycle(1, drive.number + 1)
        at = Cycle(1, drive.number - back)
        drive.say(Ack("wheels", cycle, ballot, ballot, at))


def echo(far: float | None, bearing: float = 0.0) -> Echo:
    return Echo(0.2 * cos(bearing), 0.2 * sin(bearing), bearing, far)


def sonar_repeats(drive: Drive) -> None:
    drive.go(3, says=lambda d: (Sonar(Cycle(1, d.number), 5.0, (echo(2.0), echo(1.0, 1.5))),))


def laser_repeats(drive: Drive) -> None:
    def scan(d: Drive) -> tuple[Message, ...]:
        return (Scan(Cycle(1, d.number), 0.1, 0, -1.0, 0.1, 8.0, b"\x10\x20" * 20, d.number),)

    drive.go(3, says=scan)


WALL = (-5.0, 0.9, 40.0, 0.9)  # on its left
LEFT = 0.5 * pi


def on_its_left(far: float | None, pose_y: float = 0.0) -> Callable[[Drive], tuple[Message, ...]]:
    """A sonar's range, by a pose that is so far to the left."""

    def says(d: Drive) -> tuple[Message, ...]:
        cycle = Cycle(1, d.number)
        return Pose(cycle, d.x, pose_y, 0, SURE), Sonar(cycle, 5.0, (echo(far, LEFT),))

    return says


def sonar_is_biased(drive: Drive) -> None:
    drive.auditor.chart([WALL])
    drive.go(11, says=on_its_left(1.0))


def hides(drive: Drive) -> None:
    def shown(y: float) -> Callable[[Drive], tuple[Message, ...]]:
        def says(d: Drive) -> tuple[Message, ...]:
            cycle = Cycle(1, d.number)
            obstacles = Obstacles(cycle, None, None, None, None, d.points((Point(0.0, y),)))
            return Sonar(cycle, 5.0, (echo(0.3, LEFT),)), obstacles

        return says

    drive.go(3, says=shown(0.5))
    assert drive.found == []
    drive.go(3, says=shown(-0.5))


def is_blind_on_one_side(drive: Drive) -> None:
    drive.auditor.chart([(x - 0.5, 0.9, x + 0.5, 0.9) for x in range(-2, 12)])
    drive.go(4, says=on_its_left(0.7))
    assert drive.found == []
    drive.go(4, says=on_its_left(None))


def freezes_its_obstacles(drive: Drive) -> None:
    drive.go(2, ahead=(Point(1.0, 0.5),), renews=0.0)


def plans_through_a_wall(drive: Drive) -> None:
    drive.go(0.1)
    drive.auditor.chart([(5.0, -1.0, 5.0, 1.0)])
    drive.say(Trajectory(2, 1, (Waypoint(10.0, 0.0, 0.0),), planned=True))


def holds_for_nothing(drive: Drive) -> None:
    drive.go(1)
    drive.end(MissionState.NONE)
    drive.go(4, **STANDS_STILL)


def falls_silent(drive: Drive, *instances: str) -> None:
    drive.go(1)
    for term, instance in enumerate(instances or [GOTO] * 3, start=2):
        ballot, now = Ballot(term, 0.6, False, instance), 20 * term
        for number in range(now, now + 10):
            drive.say(Ack("wheels", Cycle(1, number), ballot, ballot, Cycle(1, now)))


TABLE = [
    (lazy, Promise.ARRIVES, "goto"),
    (nobody, Promise.ARRIVES, ""),
    (early, Promise.REACHED, "interface"),
    (elsewhere, Promise.REACHED, "localization"),
    (fails, Promise.FAILED, "interface"),
    (stays_lost, Promise.FOUND, "localization"),
    (touches, Promise.COLLISION, "goto"),
    (half, Promise.SPEED, "goto"),
    (base_is_slow, Promise.SPEED, "robot"),
    (stands, Promise.STANDS, "goto"),
    (lies, Promise.HONEST, "goto"),
    (is_capped, Promise.HONEST, "goto"),
    (lets_through, Promise.EARNED, "robot"),
    (hunts, Promise.STEADY, "goto"),
    (rolls_on, Promise.BRAKES, "robot"),
    (never_ends, Promise.ARRIVES, "interface"),
    (brakes_weakly, Promise.BRAKES, "robot"),
    (obeys_otherwise, Promise.ORDERED, "robot"),
    (spins, Promise.ORDERED, "robot"),
    (is_stopped_as_it_spins, Promise.ORDERED, "robot"),
    (forgets_its_stop, Promise.STOP, "robot"),
    (counts_too_much, Promise.ODOMETRY, "robot"),
    (jumps, Promise.POSE, "localization"),
    (goes_down, Promise.ONE_DRIVER, "goto"),
    (obeys_the_past, Promise.FRESH, "goto"),
    (moves_sideways, Promise.ODOMETRY, "robot"),
    (sonar_repeats, Promise.SENSORS, "sonar"),
    (laser_repeats, Promise.SENSORS, "laser"),
    (sonar_is_biased, Promise.SENSORS, "sonar"),
    (hides, Promise.SENSORS, "sonar"),
    (is_blind_on_one_side, Promise.SENSORS, "sonar"),
    (freezes_its_obstacles, Promise.SENSORS, "sonar"),
    (plans_through_a_wall, Promise.PATH, "path-planning"),
    (holds_for_nothing, Promise.HELD, "goto"),
    (falls_silent, Promise.HELD, "goto"),
]


@pytest.mark.parametrize(("story", "promise", "who"), TABLE)
def test_a_rule_finds_what_breaks_its_promise_and_names_who(
    story: Story, promise: Promise, who: str
) -> None:
    drive = Drive()
    story(drive)
    assert (promise, who) in drive.found
    verdicts = [each for each in drive.auditor.report() if each.promise is promise]
    assert Answer.NO in {each.answer for each in verdicts}


@pytest.mark.parametrize("rule", RULES)
def test_every_handler_of_a_rule_is_of_a_message_that_auditors_receive(rule: type[Rule]) -> None:
    """A misspelt one would never be called, and its promise would count as kept."""
    kinds = [*watched(), Errands]  # of which each kind comes with a package
    known = {handler_name(each) for kind in kinds for each in kind.__mro__} | {"on_time"}
    assert {name for name in dir(rule) if name.startswith("on_")} <= known


# What does not count ------------------------------------------------------------------------------


def slow_at(ahead: Point) -> Story:
    return lambda drive: drive.go(4, v=0.3, ordered=0.3, ahead=(ahead,))


@pytest.mark.parametrize(
    "story",
    [
        slow_at(Point(1.0, 0.3)),
        lambda d: d.go(0.4, v=0.3, ordered=0.3, ahead=(Point(0.22, 0.0),)),  # a person steps in
        lambda d: d.go(
            3, v=0.05, ordered=0.08, admitted=0.04, ahead=(Point(0.3, 0.0),), capped="x"
        ),
        lambda d: d.go(2).go(2, ordered=0.0, v=0.05, ahead=(Point(1.0, 0.0),)),
        lambda d: [d.go(0.9, holder=who, term=d.term + 1) for who in (GOTO, AVOID) * 6],
        lambda d: falls_silent(d, *(f"auction-{n}" for n in range(9))),  # each was killed
    ],
)
def test_what_looks_similar_is_no_finding(story: Story) -> None:
    drive = Drive()
    story(drive)
    assert drive.found == []


def test_what_a_single_reading_showed_is_a_reason_to_be_slow_for_as_long_as_it_is_known() -> None:
    """A false echo, which no other reading looks through once the robot stands before it."""
    once = Drive().go(3)
    once.say(Sonar(Cycle(1, once.number), 5.0, (echo(0.1),)))
    once.go(2, v=0.0, admitted=0.0, capped="an obstacle is in the way")
    once.go(3, ordered=0.1, admitted=0.1, capped="")
    assert Promise.SPEED not in {promise for promise, _ in once.found}
    once.go(10)
    assert (Promise.SPEED, "goto") in once.found
    caps = Drive().go(3).go(2, v=0.0, admitted=0.0, capped="an obstacle is in the way")
    assert (Promise.SPEED, "robot") in caps.found


def test_what_a_sensor_sees_of_its_own_robot_is_no_reason_to_be_slow() -> None:
    def mast(d: Drive) -> tuple[Message, ...]:
        return (Sonar(Cycle(1, d.number), 5.0, (Echo(0.0, 0.0, 0.0, 0.1),)),)

    drive = Drive().go(3, says=mast)
    drive.go(2, v=0.0, admitted=0.0, capped="an obstacle is in the way")
    assert (Promise.SPEED, "robot") in drive.found


def test_an_agent_may_drive_without_a_mission() -> None:
    drive = Drive(mission=0)
    drive.end(MissionState.NONE)
    assert drive.go(10).found == []


def test_a_scan_that_cannot_be_read_is_left_out() -> None:
    broken = Scan(Cycle(1, 1), 0.1, 0, -1.0, 0.0, 8.0, b"1")
    assert Drive().go(3, says=lambda _: (broken,)).found == []


def test_readings_that_change_or_a_robot_that_stands_show_no_frozen_sensor() -> None:
    def changes(d: Drive) -> tuple[Message, ...]:
        return (Sonar(Cycle(1, d.number), 5.0, (echo(4.0 - 0.01 * d.number),)),)

    drive = Drive().go(3, says=changes)
    same = Sonar(Cycle(1, 1), 5.0, (echo(2.0),))
    drive.go(5, says=lambda _: (same,), v=0.0, ordered=0.0)
    assert drive.found == []


@pytest.mark.parametrize(
    ("far", "pose_y", "found"),
    [
        (0.7, 0.0, []),  # on the wall
        (0.7, 0.4, [(Promise.POSE, "localization")]),
        (1.0, 0.0, [(Promise.SENSORS, "sonar")]),
        (2.5, 0.0, []),  # too far to be exact
    ],
)
def test_readings_off_the_map_are_the_sensors_or_the_poses(
    far: float, pose_y: float, found: list[tuple[Promise, str]]
) -> None:
    drive = Drive(Auditor([Fits]))
    drive.auditor.chart([WALL])
    assert drive.go(20, says=on_its_left(far, pose_y)).found == found


def test_what_stands_before_a_wall_is_the_sensors_fault_only_all_along_the_way() -> None:
    drive = Drive(Auditor([Fits]), v=0.1, ordered=0.1)
    drive.auditor.chart([WALL])
    assert drive.go(20, says=on_its_left(0.4)).found == []
    assert drive.go(40).found == [(Promise.SENSORS, "sonar")]


def test_an_echo_from_the_edge_of_a_sonars_cone_lies_on_the_wall() -> None:
    bearing, half = 0.5, 0.25
    far = (0.9 - 0.2 * sin(bearing)) / sin(bearing + half)

    def found(cone: float) -> list[tuple[Promise, str]]:
        drive = Drive(Auditor([Fits]))
        drive.say(replace(ROBOT, cone=cone))
        drive.auditor.chart([WALL])
        echoes = (echo(far, bearing),)
        return drive.go(20, says=lambda d: (Sonar(Cycle(1, d.number), 5.0, echoes),)).found

    assert found(0.0) == [(Promise.SENSORS, "sonar")]
    assert found(2.0 * half) == []


def test_without_a_map_what_needs_it_is_not_checked() -> None:
    drive = Drive(Auditor([Fits, Leads])).go(2, says=on_its_left(1.0))
    for each in drive.auditor.report():
        assert each.answer is Answer.UNKNOWN
        assert "map" in each.what


def test_one_wall_of_the_map_that_is_gone_is_not_the_sensors_fault() -> None:
    drive = Drive(Auditor([Sees]))
    drive.auditor.chart([WALL])
    assert drive.go(10, says=on_its_left(None)).found == []


@pytest.mark.parametrize(("ends", "found"), [(2.15, []), (3.0, [(Promise.SENSORS, "sonar")])])
def test_a_long_wall_that_returns_nothing_counts_as_one_of_those_that_are_missed(
    ends: float, found: list[tuple[Promise, str]]
) -> None:
    drive = Drive(Auditor([Sees]))
    drive.auditor.chart([(-5.0, 0.9, 2.0, 0.9), (2.0, 0.9, ends, 0.9), (ends, 0.9, 40.0, 0.9)])
    assert drive.go(10, says=on_its_left(None)).found == found


def test_boxes_that_were_carried_away_from_before_a_wall_are_not_the_sensors_fault() -> None:
    """The wall behind them is read all the time."""
    drive = Drive(Auditor([Sees]))
    boxes = [(x, 0.5, x + 0.5, 0.5) for x in (3.0, 7.0, 11.0)]
    drive.auditor.chart([(-5.0, 1.1, 40.0, 1.1), *boxes])
    assert drive.go(60, says=on_its_left(1.1)).found == []


def test_while_it_is_lost_a_path_straight_to_the_goal_is_no_finding() -> None:
    drive = Drive(Auditor([Leads]), covariance=LOST)
    drive.auditor.chart([(5.0, -1.0, 5.0, 1.0)])
    drive.go(1)
    path = Trajectory(2, 1, (Waypoint(10.0, 0.0, 0.0),), planned=True)
    drive.say(path)
    drive.go(2, covariance=SURE).say(path)
    assert drive.found == []
    drive.go(5).say(path)
    assert drive.found == [(Promise.PATH, "path-planning")]


def test_a_path_from_behind_a_wall_by_the_poses_error_is_no_finding() -> None:
    drive = Drive(Auditor([Leads]))
    drive.auditor.chart([(0.2, -1.0, 0.2, 1.0)])
    drive.say(Trajectory(2, 1, (Waypoint(10.0, 0.0, 0.0),), planned=True))
    assert drive.found == []


def test_who_comes_under_way_judges_the_path_from_the_leg_that_is_driven() -> None:
    around = tuple(Waypoint(*at, 0.0) for at in ((0.0, 2.0), (10.0, 2.0), (10.0, 0.0)))
    drive = Drive(Auditor([Leads])).go(0.1)
    drive.auditor.chart([(5.0, -1.0, 5.0, 1.0)])
    drive.say(Trajectory(2, 1, around, planned=True, leg=2))
    assert drive.found == [], "the wall is between the start and the end, which no leg joins"
    drive.auditor.chart([(5.0, 1.0, 5.0, 3.0)])
    drive.say(Trajectory(3, 2, around[:2], planned=True, leg=1))
    assert drive.found == [(Promise.PATH, "path-planning")]


def test_a_wall_beside_the_robot_may_stay_where_it_is() -> None:
    same = Sonar(Cycle(1, 1), 5.0, (echo(2.0, 1.57), echo(2.0, -1.57)))
    assert Drive().go(5, says=lambda _: (same,)).found == []


@pytest.mark.parametrize(("y", "found"), [(0.0, [Promise.HONEST]), (0.24, [])])
def test_on_a_tight_arc_the_robot_turns_away_from_what_it_would_not_reach(
    y: float, found: list[Promise]
) -> None:
    drive = Drive().go(1, v=0.1, ordered=0.1, w=1.0, turns=1.0, ahead=(Point(0.22, y),))
    assert [promise for promise, _ in drive.found if promise is Promise.HONEST] == found


@pytest.mark.parametrize("cause", ["contact", "waits", "fault", "stuck"])
def test_a_mission_may_fail_for_a_cause_that_was_seen(cause: str) -> None:
    drive = Drive(waits=cause == "waits")
    drive.begin()
    stalled, fault = cause == "contact", "no power" if cause == "fault" else ""
    drive.go(12, stalled=stalled, fault=fault)
    if cause == "stuck":
        drive.go(50, v=0.0, ordered=0.0, ahead=(Point(0.5, 0.0),))
    drive.end(MissionState.FAILED, "no more")
    assert Promise.FAILED not in [promise for promise, _ in drive.found]


@pytest.mark.parametrize(
    "note",
    [
        "cancelled by ann",
        "nobody watches it: no agent assistant is alive",
        "another way is driven instead, for battery-charger-1",
    ],
)
def test_a_cancelled_goal_is_no_failure_without_a_cause_and_unknown(note: str) -> None:
    drive = Drive().go(5)
    drive.end(MissionState.FAILED, note)
    assert Promise.FAILED not in [promise for promise, _ in drive.found]
    verdicts = {each.promise: each for each in drive.auditor.report()}
    assert (verdicts[Promise.FAILED].answer, verdicts[Promise.FAILED].occasion) == (
        Answer.UNKNOWN,
        True,
    )


def test_a_published_cap_explains_a_slow_robot_and_gives_it_time() -> None:
    capped = {"ordered": 0.75, "admitted": 0.1, "v": 0.1, "capped": "a person ahead"}
    drive = Drive().go(90, **capped, ahead=(Point(1.0, 0.5),))
    broken = {promise for promise, _ in drive.found}
    assert not broken & {Promise.ARRIVES, Promise.SPEED}
    assert Promise.HONEST in broken, "who orders what is capped for a minute is named"


def test_a_limit_that_is_not_known_leaves_the_speed_unknown_until_goto_says_it() -> None:
    def slow(auditor: Auditor, *first: Message) -> list[Finding]:
        drive = Drive(auditor)
        drive.say(*first)
        drive.go(4, v=0.37, ordered=0.37)
        return auditor.findings

    def limit(value: float | None) -> ParametersReply:
        text = json.dumps(value)
        return ParametersReply(GOTO, (Parameter("v_max", text, text, "m/s", "a number"),))

    assert [each.answer for each in slow(Auditor())] == [Answer.UNKNOWN]
    assert [each.answer for each in slow(Auditor(), limit(None))] == [Answer.NO]
    assert slow(Auditor(), limit(0.4)) == []


def test_without_a_truth_reached_is_judged_by_the_pose() -> None:
    def reached(off: float, covariance: tuple[float, ...], doubt: str = "") -> list[Finding]:
        auditor = Auditor([rule for rule in RULES if rule.promise is Promise.REACHED])
        auditor.update(0.0, "", Trajectory(1, 1, (Waypoint(5.0, 0.0, 0.0),)))
        auditor.update(0.1, "", Pose(Cycle(1, 1), 5.0 + off, 0.0, 0.0, covariance))
        return auditor.update(0.2, "", MissionStatus(1, MissionState.REACHED, 0.0, note=doubt))

    assert [each.answer for each in reached(0.05, SURE)] == [Answer.UNKNOWN], "a pose alone"
    assert [each.answer for each in reached(0.5, SURE)] == [Answer.NO]
    assert [each.answer for each in reached(0.05, LOST)] == [Answer.UNKNOWN]
    assert [each.answer for each in reached(0.05, ())] == [Answer.UNKNOWN]
    assert [each.answer for each in reached(0.3, ROUGH)] == [Answer.NO]
    assert [each.answer for each in reached(0.3, ROUGH, "unsure")] == [Answer.UNKNOWN]
    assert [each.answer for each in reached(0.5, ROUGH, "unsure")] == [Answer.NO]


def at_a_corner(by: str) -> list[tuple[float, Message]]:
    """At the goal (5, 0) the readings show walls 1 m ahead and 1 m on the left."""
    said: list[tuple[float, Message]] = [
        (0.0, replace(ROBOT, cone=0.3)),
        (0.0, Trajectory(1, 1, (Waypoint(5.0, 0.0, 0.0),))),
    ]
    for number in range(1, 11):
        cycle, at = Cycle(1, number), number / 10.0
        said.append((at, Pose(cycle, 5.0, 0.0, 0.0, SURE)))
        if by == "sonar":
            echoes = tuple(Echo(0.0, 0.0, bearing, 1.0) for bearing in (0.0, pi / 2.0))
            said.append((at, Sonar(cycle, 3.0, echoes)))
        else:
            ranges = packed(np.array([1.0]), 0.1, 8.0)
            said += [
                (at, Scan(cycle, 0.0, 0.0, bearing, 1.0, 8.0, ranges, number))
                for bearing in (0.0, pi / 2.0)
            ]
    return [*said, (1.1, MissionStatus(1, MissionState.REACHED, 0.0))]


AHEAD, ON_THE_LEFT = (6.0, -1.0, 6.0, 1.0), (4.0, 1.0, 6.0, 1.0)


@pytest.mark.parametrize("by", ["sonar", "laser"])
@pytest.mark.parametrize(
    ("walls", "unknown"),
    [
        ((AHEAD, ON_THE_LEFT), ""),
        (((6.05, -1.0, 6.05, 0.95), (4.0, 0.95, 6.0, 0.95)), ""),
        # A localization whose map is shifted.
        (((6.3, -1.0, 6.3, 1.0), ON_THE_LEFT), "along 0 degrees"),
        ((AHEAD, (4.0, 1.3, 6.0, 1.3)), "along 90 degrees"),
        # A single wall shows no place along it.
        ((AHEAD,), "along 90 degrees"),
        (((4.0, 1.0, 6.0, 1.0 - 1e-15),), "along 0 degrees"),
        # Nothing reads a wall through another.
        ((AHEAD, ON_THE_LEFT, (5.5, -1.0, 5.5, 1.0)), "along 0 degrees"),
    ],
)
def test_without_a_truth_readings_show_whether_the_place_of_a_goal_is_known(
    walls: tuple[tuple[float, float, float, float], ...], unknown: str, by: str
) -> None:
    auditor = Auditor([Reached])
    auditor.chart(walls)
    found = [each for at, said in at_a_corner(by) for each in auditor.update(at, "", said)]
    assert [each.answer for each in found] == ([Answer.UNKNOWN] if unknown else [])
    assert all(unknown in each.what for each in found)


@pytest.mark.parametrize(
    ("place", "walls", "truth", "answers"),
    [
        ("corner", (AHEAD, ON_THE_LEFT), False, []),
        ("corner", (AHEAD,), False, [Answer.UNKNOWN]),
        ("corner", (AHEAD,), True, []),
        ("elsewhere", (AHEAD, ON_THE_LEFT), False, [Answer.NO]),
    ],
)
def test_a_step_is_done_in_a_place_only_where_the_truth_or_readings_show_the_robot(
    place: str,
    walls: tuple[tuple[float, float, float, float], ...],
    truth: bool,
    answers: list[Answer],
) -> None:
    rule, scene = Visits(), Scene(frozenset())
    scene.chart = Chart(walls)
    scene.world = replace(
        load_world("empty"), goals={"corner": (5.0, 0.0, 0.0), "elsewhere": (8.0, 0.0, 0.0)}
    )

    @dataclass
    class Told:
        """As an agent of missions publishes them."""

        errands: tuple[Progress, ...]

    def tell(*steps: StepDone) -> list[Finding]:
        return [*rule.on_errands(Told((Progress(1, over=False, steps=steps),)), scene)]  # type: ignore[arg-type]

    assert tell() == []
    for at, said in at_a_corner("sonar"):
        if truth:
            scene.update(at, Truth(at, 5.0, 0.0, 0.0, 0.0, 0.0, 0, 1.0, "sim"))
        scene.update(at, said)
        if isinstance(said, Pose):
            rule.on_pose(said, scene)
    assert [each.answer for each in tell(StepDone(f"move({place})", "done", "", 1.0))] == answers


def test_a_monitor_that_keeps_no_unknown_does_not_look_for_a_proof(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(missions, "unproven", lambda _: pytest.fail("it takes long"))
    auditor = Auditor([Reached])
    auditor.chart([AHEAD])
    live = Live(auditor)
    live.begin()
    for at, said in at_a_corner("laser"):
        live.update(at, said)
    assert live.broken(1.1) == ()


@pytest.mark.parametrize(
    ("off", "covariance", "broken"),
    [
        (0.1, SURE, False),
        (0.5, SURE, True),
        (0.5, ROUGH, False),
        (9.0, LOST, False),
        (9.0, (), False),
    ],
)
def test_a_pose_that_is_off_the_truth_beyond_its_covariance_is_not_kept(
    off: float, covariance: tuple[float, ...], broken: bool
) -> None:
    drive = Drive(off=off, covariance=covariance).go(4)
    assert Promise.POSE not in [promise for promise, _ in drive.found], "for some seconds"
    drive.go(4)
    assert ((Promise.POSE, "localization") in drive.found) is broken


def test_with_a_truth_a_goal_is_reached_without_readings() -> None:
    drive = Drive(Auditor([Reached]))
    drive.say(replace(ROBOT, sensors=("laser",)))
    drive.go(12.3)
    drive.begin(0.0)
    drive.end(MissionState.REACHED)
    (found,) = drive.auditor.report()
    assert found.answer is Answer.YES


def test_without_a_map_poses_are_compared_with_the_truth_since_the_first_rest() -> None:
    """The simulator's frame is 3 m beside the poses'."""

    def driven(rule: type[Rule], then: float, rests_s: float = 1.0) -> tuple[Answer, str]:
        """It rests, drives, its pose goes off by `then`, and it reports that it is at its goal."""
        exact = tuple(each / 100.0 for each in SURE)
        drive = Drive(Auditor([rule]), mapped=False, off=3.0, covariance=exact)
        drive.go(rests_s, **STANDS_STILL).go(6, v=0.75, ordered=0.75)
        drive.go(6, off=then)
        drive.begin(then)
        drive.end(MissionState.REACHED)
        (found,) = drive.auditor.report()
        return found.answer, found.what

    for rule in (Claims, Reached):
        assert driven(rule, 3.0)[0] is Answer.YES
        assert driven(rule, 4.0)[0] is Answer.NO
        assert driven(rule, 3.0, rests_s=0.0)[0] is Answer.UNKNOWN
    assert "frames" in driven(Claims, 3.0, rests_s=0.0)[1]


def test_a_pose_that_is_set_anew_without_a_map_is_in_another_frame() -> None:
    """Such as by a SLAM that has found its place on a saved map, or by a person."""

    def verdict(revision: int, *said: Message) -> Finding:
        drive = Drive(Auditor([Claims]), mapped=False, off=3.0).go(1, **STANDS_STILL)
        drive.go(3, v=0.75, ordered=0.75)
        drive.say(*said)
        drive.go(8, off=7.0, revision=revision)
        return drive.auditor.report()[0]

    assert verdict(0).answer is Answer.NO
    for found in (verdict(1), verdict(0, InitialPose(9.0, 0.0, 0.0))):
        assert found.answer is Answer.UNKNOWN
        assert "frames" in found.what


def test_the_truth_of_another_robots_simulator_counts_nothing() -> None:
    drive = Drive().go(1)
    for count in (0, 5):
        drive.say(Truth(drive.now, 9, 9, 0, 0, 0, count, 0.0, "another"))
    assert drive.found == []


# Excuses ------------------------------------------------------------------------------------------


class Teleop(ByHand, frozen=True):
    """A person who drives."""

    @property
    def driven_by(self) -> str:
        return "anna"


class Docks(Leading, frozen=True):
    """An agent that leads the robot."""

    @property
    def leads(self) -> bool:
        return True


def excused(drive: Drive, excuse: Excuse) -> None:
    """A minute and more at rest, for a reason."""
    if excuse is Excuse.DISTURBED:
        drive.auditor.disturbed("the network is cut")
    changes: dict[Excuse, dict[str, object]] = {
        Excuse.STOPPED: {"stop": Stop(1, True, "a person", 7)},
        Excuse.LOST: {"covariance": LOST},
        Excuse.BLOCKED: {"ahead": (Point(0.5, 0.0),)},
        Excuse.WAITS: {"waits": True},
        Excuse.BY_HAND: {"says": lambda _: (Teleop(),)},
        Excuse.LED: {"says": lambda _: (Docks(),)},
    }
    drive.go(0.1, **changes.get(excuse, {}))
    drive.begin()
    drive.go(30, **STANDS_STILL)


@pytest.mark.parametrize(
    "excuse",
    # The others have their own.
    sorted({*Excuse} - {Excuse.CAPPED, Excuse.FAULT, Excuse.UNSURE, Excuse.SILENT}),
)
def test_an_excuse_counts_and_without_it_the_same_is_a_finding(excuse: Excuse) -> None:
    drive = Drive()
    excused(drive, excuse)
    assert Promise.STANDS not in [promise for promise, _ in drive.found]
    assert drive.auditor.scene.needed[excuse]
    strict = Drive(Auditor(v_max=inf).without(excuse))
    excused(strict, excuse)
    assert (Promise.STANDS, "goto") in strict.found


def slow_by_a_cap(drive: Drive) -> None:
    drive.go(100, v=0.1, ordered=0.5, admitted=0.1, capped="0.2 m ahead are free")


def gives_up_with_a_fault(drive: Drive) -> None:
    drive.go(5, fault="no power").end(MissionState.FAILED)


def rests_at_a_goal_of_which_it_is_unsure(drive: Drive) -> None:
    drive.go(13.3).go(20, covariance=ROUGH, **STANDS_STILL)


@pytest.mark.parametrize(
    ("excuse", "does", "promise"),
    [
        (Excuse.CAPPED, slow_by_a_cap, Promise.ARRIVES),
        (Excuse.UNSURE, rests_at_a_goal_of_which_it_is_unsure, Promise.ARRIVES),
        (Excuse.FAULT, gives_up_with_a_fault, Promise.FAILED),
    ],
)
def test_without_an_excuse_a_mission_would_be_late_or_fail_without_a_cause(
    excuse: Excuse, does: Callable[[Drive], None], promise: Promise
) -> None:
    drive, strict = Drive(), Drive(Auditor(v_max=inf).without(excuse))
    for each in (drive, strict):
        does(each)
    assert promise not in [each for each, _ in drive.found]
    assert promise in [each for each, _ in strict.found]


def test_a_hand_that_leads_a_robot_away_gives_it_the_time_to_come_back() -> None:
    def led(v: float) -> list[Promise]:
        drive = Drive().go(5)
        drive.go(10, v=v, says=lambda _: (Teleop(),))
        return [each for each, _ in drive.go(70, v=0.1, says=lambda _: ()).found]

    assert Promise.ARRIVES not in led(0.75)
    assert Promise.ARRIVES in led(0.0), "a hand that moved nothing gives no way back"


@pytest.mark.parametrize(
    ("story", "promise"), [({"v": 0.3}, Promise.SPEED), ({"w": 0.8, "turns": 0.5}, Promise.ORDERED)]
)
@pytest.mark.parametrize("said", [{"fault": "no power"}, {"stop": Stop(1, True, "anna", 7)}])
def test_a_base_that_does_not_follow_what_is_let_through_is_not_excused_by_words(
    story: dict[str, object], promise: Promise, said: dict[str, object]
) -> None:
    """A stop and a fault let nothing through; a robot agent that does is to blame for the rest."""
    drive = Drive().go(2).go(8, **story, **said)
    assert (promise, "robot") in drive.found


@pytest.mark.parametrize("touch", [Point(0.2, 0.0), None])
def test_a_rest_at_a_contact_is_not_an_order_of_its_own(touch: Point | None) -> None:
    drive = Drive().go(1).go(1, commanded=0.3, touch=touch, v=0.0, ordered=0.0)
    assert (Promise.ORDERED in [promise for promise, _ in drive.found]) == (touch is None)


def test_a_turn_that_friction_held_may_overshoot() -> None:
    drive = Drive().go(2, turns=0.3, w=0.1).go(1, w=0.5).go(2, w=0.3)
    assert Promise.ORDERED not in [promise for promise, _ in drive.found]


def test_a_silent_robot_agent_takes_no_time_of_the_mission() -> None:
    def silence(auditor: Auditor) -> list[Promise]:
        drive = Drive(auditor)
        drive.go(1)
        for _ in range(100):
            drive.now += 1.0
            auditor.tick(drive.now)
        return [promise for promise, _ in drive.found]

    assert silence(Auditor(v_max=inf)) == []
    assert Promise.ARRIVES in silence(Auditor(v_max=inf).without(Excuse.SILENT))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.sampled_from([0.0, 0.1, 0.75]), st.floats(-3, 3)), max_size=12))
def test_gaps_and_late_messages_never_raise(steps: list[tuple[float, float]]) -> None:
    drive = Drive()
    for v, gap_s in steps:
        drive.go(0.5, v=v, ordered=v)
        drive.now += gap_s
    assert {each.answer for each in drive.auditor.report()} <= {*Answer}


def test_without_a_truth_a_contact_may_be_felt_and_none_felt_is_unknown() -> None:
    def verdict(*stalled: bool) -> Answer:
        auditor = Auditor([rule for rule in RULES if rule.promise is Promise.COLLISION])
        for number, each in enumerate(stalled):
            state = RobotState(Cycle(1, number), 0, 0, 0, 0, 0, 12, True, each)
            auditor.update(0.1 * number, "", state)
        (found,) = auditor.report()
        return found.answer

    assert verdict(False, True, True) is Answer.NO
    assert verdict(False, False) is Answer.UNKNOWN
