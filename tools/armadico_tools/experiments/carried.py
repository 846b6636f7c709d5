"""A robot that is lifted and put down elsewhere, or starts with no idea where it is."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, hypot, inf, radians
from random import Random
from statistics import median
from typing import TYPE_CHECKING, Final

from msgspec import Struct, structs

from armadico.agents.localization.localization import Localization
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.config.loading import load_parameters
from armadico.config.scenarios import Scenario, load_scenario
from armadico.config.worlds import load_world
from armadico.launch.society import Options, members, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose
from armadico_tools.experiments.other_maps import places
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from collections.abc import Sequence

SCENARIOS: Final = ("sc4", "rooms-a", "house", "offices", "floor")
ARMS: Final = ("kidnapped", "anywhere")
ROBOTS: Final = {"pioneer-2dx": "8 sonars", "jackal": "laser, 270 degrees"}
"""The robots that are carried, and by what they know where they are."""

WITHIN_S: Final = 60.0
"""So long it has to be found."""

RIGHT_M: Final = 0.5
"""A pose that is less off is right."""

SLOW_M_S: Final = 0.3
"""Faster than this is at speed; relocate drives at 0.25 m/s."""

NOTICED_S: Final = 5.0
"""A robot that is carried off cannot know it at once: so long it is granted in the second figure,
what its readings need to fit badly for a while, and its brakes."""

CYCLE_S: Final = 0.1

FROM_S, TO_S = 5.0, 20.0
"""When the robot is lifted, after its mission began."""

NOTE: Final = (
    f"*Kidnapped*: in mid-run, {FROM_S:g} to {TO_S:g} s after the mission began, the simulator puts"
    " the robot down somewhere else that it could drive to, at least 1 m away: place, heading and"
    " time are the seed's, the odometry notices nothing. *Anywhere*: it is put down so before it"
    " starts, the pose says the"
    ' scenario\'s start, and the localization agent begins with no idea (`start = "anywhere"`).'
    " Ways are planned by the grid or the rooms in all five. It is *found* when the published pose"
    f" is within {RIGHT_M:g} m of the true one and is said to be known (standard deviation up to"
    f" {LOST_M:g} m), from then on for good: until {WITHIN_S:g} s after it was put down are over or"
    " the goal is reached. The time is to the last moment in which that was not so. *Wrong and"
    f" sure*: more than {RIGHT_M:g} m off with the pose said to be known; how long in all, the"
    f" highest true speed meanwhile, and runs with more than {SLOW_M_S:g} m/s (nobody lost drives"
    " as fast) at any such moment: from the first on, in which nobody can know yet that the robot"
    f" was carried off, and from {NOTICED_S:g} s after it was put down on."
)


class Carried(Struct, frozen=True):
    """One run; times from when the robot was put down."""

    arm: str
    scenario: str
    robot: str
    seed: int
    found_s: float  # inf: not found
    wrong_s: float  # wrong and sure for so long,
    wrong_m_s: float  # so fast at most,
    late_m_s: float  # and so fast once there was time to notice
    collisions: int


class Kidnap:
    """One run under way on the virtual mesh."""

    def __init__(self, arm: str, name: str, robot: str, seed: int) -> None:
        self.arm, self.robot, self.seed = arm, robot, seed
        self._rng = Random(f"{arm}/{name}/{seed}")
        self.scenario = scenario_of(name, robot)
        x, y, _ = self.scenario.start
        self._places = places(load_world(self.scenario.world), (x, y))
        without = ("localization",) if arm == "anywhere" else ()
        self.rehearsal = Rehearsal(self.scenario, Options(seed=seed, without=without))
        if without:
            self._join_with_no_idea()
        self.rehearsal.mesh.watch(lambda _k, message, now: self._see(message, now), Pose)
        self._down_at = inf
        self._bad_until = 0.0
        self._wrong_s = self._wrong_m_s = self._late_m_s = 0.0

    def go(self) -> Carried:
        """Drive until it is found or not."""
        run, mesh = self.rehearsal, self.rehearsal.mesh
        if self.arm == "anywhere":
            self.put_down()
        run.start()
        run.begin()
        if self.arm == "kidnapped":
            mesh.run(mesh.now + self._rng.uniform(FROM_S, TO_S), lambda: run.watch.done)
            self.put_down()
        end = self._down_at + WITHIN_S
        mesh.run(end, lambda: run.watch.done)
        found = self._bad_until < mesh.now - 0.5
        return Carried(
            self.arm,
            self.scenario.name,
            self.robot,
            self.seed,
            round(self._bad_until - self._down_at, 1) if found else inf,
            round(self._wrong_s, 1),
            round(self._wrong_m_s, 3),
            round(self._late_m_s, 3),
            run.watch.result().collisions or 0,
        )

    def put_down(self) -> None:
        """Somewhere else; the robot is lifted, so that its odometry does not notice."""
        robot = self.rehearsal.robot
        assert isinstance(robot, SimulatedRobot), "the simulator is ours"
        x, y, _ = robot.plant.pose
        far = [place for place in self._places if hypot(place[0] - x, place[1] - y) >= 1.0]
        to = self._rng.choice(far)
        robot.plant.set_pose(*to, radians(self._rng.uniform(-180.0, 180.0)))
        self._down_at = self._bad_until = self.rehearsal.mesh.now

    def _join_with_no_idea(self) -> None:
        every = members(self.scenario, replace(self.rehearsal.options, without=()), "memory:")
        sets = next(member.sets for member in every if member.name == "localization")
        kind = Localization.parameters
        parameters = load_parameters(kind, None, [*sets, 'start="anywhere"'])
        self.rehearsal.add(Localization, parameters)

    def _see(self, pose: object, now: float) -> None:
        truth = self.rehearsal.watch.view.truth
        if not isinstance(pose, Pose) or truth is None or now <= self._down_at:
            return
        off, sure = hypot(pose.x - truth.x, pose.y - truth.y), pose.deviation <= LOST_M
        turned = abs(degrees(wrap(pose.theta - truth.theta)))
        if off > RIGHT_M or turned > 30.0 or not sure:
            self._bad_until = now
        if off > RIGHT_M and sure and self.rehearsal.watch.mission:
            self._wrong_s += CYCLE_S
            self._wrong_m_s = max(self._wrong_m_s, abs(truth.v))
            if now - self._down_at > NOTICED_S:
                self._late_m_s = max(self._late_m_s, abs(truth.v))


def scenario_of(name: str, robot: str) -> Scenario:
    """A shipped scenario for a make of robot, its ways planned."""
    scenario = structs.replace(load_scenario(name), plan="rooms", waypoints=())
    return prepared(scenario, Options(), profile=robot)


def drive(task: tuple[str, str, str, int]) -> Carried:
    """One run, whole: what the workers do."""
    return Kidnap(*task).go()


def section(runs: Sequence[Carried]) -> str:
    header = (
        *(
            "arm",
            "robot",
            "scenario",
            f"found in {WITHIN_S:g} s",
            "median s",
            "wrong and sure s, median",
        ),
        *("fastest so, m/s", "at speed so", f"after {NOTICED_S:g} s"),
    )
    rows = [
        (arm, f"{robot}: {by}", name or "all", *_row(some))
        for arm in ARMS
        for robot, by in ROBOTS.items()
        for name in (*SCENARIOS, "")
        if (
            some := [
                r for r in runs if (r.arm, r.robot) == (arm, robot) and name in ("", r.scenario)
            ]
        )
    ]
    return f"{NOTE}\n\n{table(header, rows)}"


def _row(runs: Sequence[Carried]) -> tuple[str, ...]:
    found = [one.found_s for one in runs if one.found_s < inf]
    return (
        f"{len(found)} of {len(runs)}",
        f"{median(found):.1f}" if found else "-",
        f"{median(one.wrong_s for one in runs):.1f}",
        f"{max(one.wrong_m_s for one in runs):.2f}",
        *(
            f"{sum(speed > SLOW_M_S for speed in speeds)} of {len(runs)}"
            for speeds in ([one.wrong_m_s for one in runs], [one.late_m_s for one in runs])
        ),
    )
