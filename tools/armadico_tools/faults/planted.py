"""Planted defects: mutants of the product, by which the promises are tested.

A defect is planted in an agent, or in two, when they join. The bed must find each by a broken
promise, and none in the product as it is.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from dataclasses import replace as alike
from math import hypot
from typing import Any, Final

import numpy as np
from msgspec.structs import replace

from armadico.core.agent import Agent
from armadico.core.exchange import Bid
from armadico.core.messages import Description, RobotState
from armadico.mobile.driven import Stage
from armadico.mobile.messages import (
    NO_POSE,
    Correction,
    MissionRequest,
    Plan,
    PlanRequest,
    Pose,
    Scan,
    Sonar,
)
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import packed, ranges_of
from armadico_tools.faults.plan import Outcome
from armadico_tools.faults.planted_senses import SENSES, without, without_reflex
from armadico_tools.faults.planting import Defect, Late, publishes, wrap

GIVES_UP_M: Final = 1.5
"""The lazy goto comes no nearer than this."""

EARLY_M: Final = 1.0
"""So far from its goal a mission counts as reached, early."""

LOST_AFTER_S: Final = 20.0
BLINKS, FOUND_CYCLES = 250, 50
"""Of so many cycles it is lost, but for the second."""

FLICKER: Final = 3
"""Cycles with a bid, and without one."""

PRESSES_M_S, RUNS_M_S = 0.3, 0.6
SURE: Final = 0.99
EACH_S: Final = 20.0
TRUE_S: Final = 10.0
"""The liar drives on at a speed with this utility, after a time of each such one, s."""

FAILS_AFTER_S: Final = 5.0
BIAS_M: Final = 0.3
LATE_S: Final = 0.8
SCALE: Final = 1.1
JUMP_M, JUMPS_EACH_S, JUMPS_S = 1.0, 15.0, 1.0
IDLE: Final = 0.01
"""The utility of an agent that keeps the wheels."""

STALE_CYCLES, LAG_CYCLES = 10, 5
FROZEN_CYCLES: Final = 20
SHIFT_M, ASIDE_M, SPINS = 0.3, 0.5, 2.0
BRAKES: Final = 3.0
"""The published deceleration, relative to the true one."""


def plant(name: str, agent: Agent) -> None:
    """Plant a defect in an agent that has joined, if it is one of those."""
    change = DEFECTS[name].plants.get(agent.name)
    if change is not None:
        change(agent)


def _lazy(goto: Any) -> None:
    def propose(method: Callable[..., Any], pose: Pose, *others: Any) -> Any:
        bid = method(pose, *others)
        far = goto.route.to_go(pose.x, pose.y) > GIVES_UP_M
        return bid if bid is None or far else alike(bid, action=(0.0, 0.0))

    wrap(goto, "propose", propose)


def _early(interface: Any) -> None:
    def arrived(method: Callable[..., bool], pose: Pose) -> bool:
        goal = interface._mission.route.goal
        near = goal is not None and hypot(goal.x - pose.x, goal.y - pose.y) < EARLY_M
        return near or method(pose)

    wrap(interface, "_arrived", arrived)


def _half(robot: Any) -> None:
    def obey(method: Callable[..., None], resource: Any, action: tuple[float, float]) -> None:
        method(resource, (0.5 * action[0], 0.5 * action[1]))

    wrap(robot, "obey", obey)


def _lies(goto: Any, v: float = PRESSES_M_S, *, critical: bool = False) -> None:
    def propose(method: Callable[..., Any], *inputs: Any) -> Any:
        bid = method(*inputs)
        if bid is None or goto.now % EACH_S <= TRUE_S:
            return bid
        return alike(bid, action=(v, 0.0), utility=SURE, critical=critical or bid.critical)

    wrap(goto, "propose", propose)


def _runs(goto: Any) -> None:
    """Only the robot agent is left to stop it: avoid would keep the wheels from a lesser bid."""
    _lies(goto, RUNS_M_S, critical=True)


def _fails(interface: Any) -> None:
    """Each tenth mission by its number, which is drawn."""
    begun: dict[int, float] = {}

    def arrived(method: Callable[..., bool], pose: Pose) -> bool:
        number = interface._mission.number
        at = begun.setdefault(number, interface.now)
        if number % 10 == 0 and interface.now - at > FAILS_AFTER_S:
            interface._fail("it did not work out")
            return False
        return method(pose)

    wrap(interface, "_arrived", arrived)


def _stands(goto: Any) -> None:
    def propose(method: Callable[..., Any], *inputs: Any) -> Any:
        bid = method(*inputs)
        return None if bid is None else alike(bid, action=(0.0, 0.0))

    wrap(goto, "propose", propose)


def _lost(encoder: Any) -> None:
    joined = encoder.now

    def change(pose: Pose) -> Pose:
        if encoder.now - joined <= LOST_AFTER_S:
            return pose
        return replace(pose, covariance=(1.0, 0.0, 0.0, 1.0, 0.0, 0.1))

    publishes(encoder, Pose, change)


def _blinks(encoder: Any) -> None:
    def change(pose: Pose) -> Pose:
        return pose if pose.cycle.number % BLINKS < FOUND_CYCLES else _doubtful(pose, 0.3)

    publishes(encoder, Pose, change)


def _doubtful(pose: Pose, variance: float) -> Pose:
    return replace(pose, covariance=(variance, 0.0, 0.0, variance, 0.0, 0.001))


def _unsure(encoder: Any) -> None:
    publishes(encoder, Pose, lambda pose: _doubtful(pose, 0.02))


def _flickers(goto: Any) -> None:
    calls = Counter[str]()

    def propose(method: Callable[..., Any], *inputs: Any) -> Any:
        calls["all"] += 1
        bid = method(*inputs)
        return bid if calls["all"] // FLICKER % 2 else None

    wrap(goto, "propose", propose)


def _biased(robot: Any) -> None:
    def farther(sonar: Sonar) -> Sonar:
        echoes = tuple(
            each if each.range is None else replace(each, range=each.range + BIAS_M)
            for each in sonar.echoes
        )
        return replace(sonar, echoes=echoes)

    def scanned_farther(scan: Scan) -> Scan:
        return replace(scan, packed=packed(ranges_of(scan) + BIAS_M, 0.0, scan.reach))

    publishes(robot, Sonar, farther)
    publishes(robot, Scan, scanned_farther)


def _brakes(robot: Any) -> None:
    publishes(robot, Description, lambda about: replace(about, v_decel=BRAKES * about.v_decel))


def _caps(robot: Any) -> None:
    def cap(method: Callable[..., tuple[float, float]], v: float, w: float) -> tuple[float, float]:
        safe_v, safe_w = method(v, w)
        robot._reflex.why = robot._reflex.why or "an obstacle is in the way"
        return min(safe_v, 0.4 * v) if v > 0.0 else safe_v, safe_w

    wrap(robot._reflex, "cap", cap)


def _late(robot: Any) -> None:
    waiting: deque[tuple[float, Any]] = deque()

    def obey(method: Callable[..., None], resource: Any, action: tuple[float, float]) -> None:
        waiting.append((robot.now, action))
        while robot.now - waiting[0][0] >= LATE_S:
            method(resource, waiting.popleft()[1])

    wrap(robot, "obey", obey)


def _scaled(robot: Any) -> None:
    publishes(robot, RobotState, lambda at: replace(at, x=SCALE * at.x, y=SCALE * at.y))


def _jumps(encoder: Any) -> None:
    def change(pose: Pose) -> Pose:
        return pose if encoder.now % JUMPS_EACH_S > JUMPS_S else replace(pose, x=pose.x + JUMP_M)

    publishes(encoder, Pose, change)


def _endless(interface: Any) -> None:
    wrap(interface, "_arrived", lambda _method, _pose: False)


def _straight(planner: Any) -> None:
    def plan(_method: Callable[..., Any], request: PlanRequest) -> Plan:
        far = hypot(request.goal.x - request.start.x, request.goal.y - request.start.y)
        return Plan((request.goal,), far)

    wrap(planner, "_plan", plan)


def _keeps(goto: Any) -> None:
    def bid(method: Callable[..., Any], message: object) -> Bid:
        return method(message) or Bid(IDLE, (0.0, 0.0), reason="it keeps the wheels")

    wrap(goto, "bid", bid)


def _hides(perception: Any) -> None:
    """As if one side's sensors were not read."""

    def change(obstacles: Obstacles) -> Obstacles:
        shown = tuple(p for p in obstacles.points if p.y < 0.0)
        nearest = min(shown, key=lambda p: hypot(p.x, p.y), default=None)
        return replace(obstacles, points=shown, closest=nearest, left=None)

    publishes(perception, Obstacles, change)


def _mirrors(robot: Any) -> None:
    def swapped(sonar: Sonar) -> Sonar:
        echoes = tuple(replace(e, y=-e.y, bearing=-e.bearing) for e in sonar.echoes)
        return replace(sonar, echoes=echoes)

    def swapped_scan(scan: Scan) -> Scan:
        return replace(scan, y=-scan.y, bearing=-scan.bearing, step=-scan.step)

    publishes(robot, Sonar, swapped)
    publishes(robot, Scan, swapped_scan)


def _stale(encoder: Any) -> None:
    late = Late[Pose](STALE_CYCLES)
    publishes(encoder, Pose, lambda pose: replace(late.of(pose), cycle=pose.cycle))


def _drives(robot: Any, change: Callable[[float, float], tuple[float, float]]) -> None:
    """Order other speeds than are published."""

    def linked(method: Callable[..., None], up: bool, why: str) -> None:
        begins = robot._session is None
        method(up, why)
        if begins and robot._session is not None:
            wrap(robot._session, "drive", lambda drive, v, w: drive(*change(v, w)))

    wrap(robot, "on_link", linked)


def _spins(robot: Any) -> None:
    _drives(robot, lambda v, w: (v, SPINS * w))


def _lags(robot: Any) -> None:
    late = Late[RobotState](LAG_CYCLES)

    def change(state: RobotState) -> RobotState:
        old = late.of(state)
        return replace(state, x=old.x, y=old.y, theta=old.theta)

    publishes(robot, RobotState, change)


def _shifts(localization: Any) -> None:
    publishes(localization, Correction, lambda found: replace(found, x=found.x + SHIFT_M))


def _refuses(interface: Any) -> None:
    def consider(method: Callable[..., Any], *asked: Any) -> Any:
        return interface._refuse(NO_POSE) if interface._mission.number else method(*asked)

    wrap(interface, "_consider", consider)


def _no_way(planner: Any) -> None:
    def plan(method: Callable[..., Plan], request: PlanRequest) -> Plan:
        return Plan((), refusal="no way") if request.why else method(request)

    wrap(planner, "_plan", plan)


def _impatient(interface: Any) -> None:
    interface.p = replace(interface.p, nearer_s=0.5)


def _misses(interface: Any) -> None:
    def consider(method: Callable[..., Any], question: Any, asked: MissionRequest) -> Any:
        goal = replace(asked.goal, x=asked.goal.x + ASIDE_M)
        return method(question, replace(asked, goal=goal))

    wrap(interface, "_consider", consider)


def _blinds(robot: Any) -> None:
    """As if the cable of one side were off."""

    def half(sonar: Sonar) -> Sonar:
        echoes = (e if e.bearing <= 0.0 else replace(e, range=None) for e in sonar.echoes)
        return replace(sonar, echoes=tuple(echoes))

    publishes(robot, Sonar, half)
    publishes(robot, Scan, lambda scan: without(scan, lambda bearings: np.sin(bearings) > 0.0))


def _doubles(robot: Any) -> None:
    _drives(robot, lambda v, w: (2.0 * v, w))


def _freezes(perception: Any) -> None:
    kept: list[Obstacles] = []

    def change(obstacles: Obstacles) -> Obstacles:
        if not kept or obstacles.cycle.number % FROZEN_CYCLES == 0:
            kept[:] = [obstacles]
        return replace(kept[0], cycle=obstacles.cycle)

    publishes(perception, Obstacles, change)


def _skips(planning: Any) -> None:
    def drive(method: Callable[..., None], entry: Any, wants: Any, *others: Any) -> None:
        method(entry, wants, *others)
        if planning.errand.stage in (Stage.PLANNING, Stage.DRIVING):
            wants.done()

    wrap(planning, "_drive", drive)


def _is_sure(localization: Any) -> None:
    """By readings that it does not use: it is moved, and certain."""

    def change(found: Correction) -> Correction:
        small = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
        return replace(found, theta=found.theta + 0.1, covariance=small)

    publishes(localization, Correction, change)


DEFECTS: Final = {
    "lazy": Defect(f"goto stops {GIVES_UP_M:g} m before its goal", {"goto": _lazy}),
    "early": Defect(f"a mission is reached {EARLY_M:g} m before its goal", {"interface": _early}),
    "half-speed": Defect("the robot agent orders half the speed", {"robot": _half}),
    "caps": Defect("the robot agent says that something is always ahead", {"robot": _caps}),
    "no-reflex": Defect(
        "the robot agent lets every command through, of a liar, too",
        {"robot": without_reflex, "goto": _runs},
    ),
    "lies": Defect("goto bids high and drives on, whatever is ahead", {"goto": _lies}),
    "fails": Defect("each tenth mission fails without a cause", {"interface": _fails}),
    "refuses": Defect("a second goal is refused, as without a pose", {"interface": _refuses}),
    "stands": Defect("goto takes the wheels and stands", {"goto": _stands}),
    "lost": Defect(f"the robot is lost for ever after {LOST_AFTER_S:g} s", {"encoder": _lost}),
    "blinks": Defect("the robot says that it is lost, mostly", {"encoder": _blinks}),
    "unsure": Defect("the robot is never certain of its place", {"encoder": _unsure}),
    "flickers": Defect(f"goto withdraws its bid every {FLICKER} cycles", {"goto": _flickers}),
    "biased": Defect(f"ranges are published {BIAS_M:g} m too long", {"robot": _biased}),
    "slow-brake": Defect(f"it brakes {BRAKES:g} times as slowly as described", {"robot": _brakes}),
    "late": Defect(f"the robot agent obeys each command {LATE_S:g} s late", {"robot": _late}),
    "scaled": Defect(f"the odometry counts {SCALE:g} times the way", {"robot": _scaled}),
    "jumps": Defect(
        f"the pose jumps by {JUMP_M:g} m for {JUMPS_S:g} s at times", {"encoder": _jumps}
    ),
    "endless": Defect("a mission does not end at its goal", {"interface": _endless}),
    "straight": Defect(
        "paths lead straight to the goal, through walls", {"path-planning": _straight}
    ),
    "no-way": Defect(
        "the planner finds no other path, ever",
        {"path-planning": _no_way, "interface": _impatient},
    ),
    "keeps": Defect("goto never releases the wheels", {"goto": _keeps}),
    "hides": Defect("obstacles on the left are not published", {"sonar": _hides, "laser": _hides}),
    "mirrored": Defect("readings are published with their sides swapped", {"robot": _mirrors}),
    "stale-pose": Defect(f"each pose is {STALE_CYCLES} cycles old", {"encoder": _stale}),
    "spins": Defect(f"the base turns {SPINS:g} times as fast as is ordered", {"robot": _spins}),
    "late-odometry": Defect(f"the odometry is {LAG_CYCLES} cycles late", {"robot": _lags}),
    "shifted": Defect(f"the map is shifted by {SHIFT_M:g} m", {"localization": _shifts}),
    "blind": Defect("the sensors of the left read nothing", {"robot": _blinds}),
    "doubled": Defect("the base drives twice as fast as is ordered", {"robot": _doubles}),
    "frozen": Defect(
        f"obstacles are published anew every {FROZEN_CYCLES} cycles",
        {"sonar": _freezes, "laser": _freezes},
    ),
    "turned": Defect("the pose is turned, and certain", {"localization": _is_sure}),
    "skips": Defect("a mission's task is done once it is under way", {"mission-planning": _skips}),
    "aside": Defect(f"a mission leads {ASIDE_M:g} m beside its goal", {"interface": _misses}),
    **SENSES,
}
"""The defects by name."""


@dataclass
class Found:
    """In which seeds a defect was found, and by what.

    Attributes:
        seeds: The number of seeds that were run.
        found: Those with a broken promise.
        by: How often each promise was the first.
        first_s: When the first promise was broken, in each of these, s.
    """

    seeds: int = 0
    found: int = 0
    by: Counter[str] = field(default_factory=Counter)
    first_s: list[float] = field(default_factory=list)

    def add(self, outcome: Outcome, alone: Outcome | None = None) -> None:
        """Add a seed. What the product itself, `alone`, breaks so soon shows no defect."""
        self.seeds += 1
        known = () if alone is None else alone.violations
        promise, at, _ = min(outcome.violations, key=lambda each: each[1], default=("", 0.0, ""))
        if promise and not any(each == promise and when <= at for each, when, _ in known):
            self.found += 1
            self.by[promise] += 1
            self.first_s.append(at)
