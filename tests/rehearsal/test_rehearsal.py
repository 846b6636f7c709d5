"""A society under a virtual clock is forked, and its forks drive."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace as alike
from itertools import count
from math import hypot, inf
from random import Random

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from armadico.agents.interface.interface import NO_MISSION_PLANNING
from armadico.agents.supervision.messages import HostShare, Kept, KeptState
from armadico.bridge.simulator.broken import Broken
from armadico.cli.parsing import version
from armadico.config.grid_map import FREE, OCCUPIED, Cells, message_of
from armadico.config.moving import Moving
from armadico.config.profile import load_profile
from armadico.config.scenarios import load_scenario
from armadico.config.worlds import distance
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import agent_class
from armadico.core.judgement import Answer, Judgement
from armadico.core.messages import Card, Cycle, Message, MonitorReport, RobotState, Stop
from armadico.core.resources import WHEELS
from armadico.core.services import service_of
from armadico.launch.options import Options
from armadico.launch.society import prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import (
    COVARIANCE,
    BatteryLevel,
    Correction,
    FleetPose,
    LocalMap,
    Pose,
    Scan,
    Truth,
)
from armadico.mobile.obstacles import Obstacles
from armadico.observe.watching import Presence
from armadico.rehearsal import rehearse
from armadico.rehearsal.answer import SPREAD, Rehearsed, answer, interval, student
from armadico.rehearsal.fork import Errand, Fork, draw, drawn_wheels, fork
from armadico.rehearsal.picture import drawn
from armadico.rehearsal.present import Present, present, present_at
from armadico.rehearsal.rehearse import made_map
from armadico.rehearsal.sample import ARRIVED, BROKEN, REFUSED, UNENDED, Forked, Sample, sample
from armadico.rehearsal.sight import Rate, Ray, Sight, place
from armadico.rehearsal.virtual import Attended
from armadico.runtime.errors import AgentFailedError, MissionRefusedError

START = (3.4, 0.6)
NEAR = (3.2, 1.6, None)
"""A goal in the room where the robot stands."""

BOX = Moving(kind="box", at=(3.4, 2.0), size=(0.9, 0.2))
"""Stands before the robot, and is on no map."""


def attended(
    *sets: str,
    moving: tuple[Moving, ...] = (),
    besides: tuple[str, ...] = (),
    kind: type[Attended] = Attended,
) -> Attended:
    """A robot that stands in sc4, and what a guest has received for two seconds."""
    scenario = replace(load_scenario("sc4"), moving=moving)
    options = Options(seed=3, sets=sets, besides=besides)
    run = Rehearsal(prepared(scenario, options), options)
    found = kind(run)
    run.start()
    run.mesh.run(run.mesh.now + 2.0)
    return found


@pytest.fixture(scope="module")
def stands() -> Attended:
    return attended("goto.v_max=0.35", "interface.near_m=0.1")


@pytest.fixture(scope="module")
def now(stands: Attended) -> Present:
    return stands.now()


def forked(now: Present, **errand: object) -> Fork:
    found = fork(now, Errand(**errand))  # type: ignore[arg-type]
    assert isinstance(found, Fork), found
    return found


def told(of: Fork, *runs: Sample) -> Rehearsed:
    return answer(runs, lacks=of.lacks, unforked=of.unforked, rate=of.rate, world=of.scenario.world)


# The present --------------------------------------------------------------------------------------


def test_present_is_what_the_society_says(now: Present) -> None:
    assert now.ready.answer is Answer.YES
    assert (now.world, now.robot) == ("sc4", "pioneer-2dx")
    assert now.pose is not None
    assert hypot(now.pose[0] - START[0], now.pose[1] - START[1]) < 0.3
    assert len(now.covariance) == COVARIANCE
    assert {"robot", "encoder", "goto", "localization", "path-planning"} <= {*now.names}
    assert not now.lacks


def test_parameters_are_those_that_agents_were_launched_with(now: Present) -> None:
    """One of them can be changed live, the other cannot."""
    sets = forked(now, goal=NEAR).options.sets
    assert "goto.v_max=0.35" in sets
    assert "interface.near_m=0.1" in sets


def test_agent_with_parameters_can_be_left_out(now: Present) -> None:
    assert "goto" not in Forked(forked(now, goal=NEAR, without=("goto",)), 1, lambda: False).names


def test_goal_is_refused_without_the_path_planner(now: Present) -> None:
    """As `armadico goto` is: only `--direct` drives straight."""
    of = forked(now, goal=NEAR, without=("path-planning",))
    found = told(of, sample(of, 0))
    assert found.judgement.answer is Answer.NO
    assert [each.by for each in found.refused] == ["interface"]
    assert "no path planning agent" in found.refused[0].why


def test_battery_that_reports_no_charge_is_named(now: Present) -> None:
    assert any("battery" in each for each in now.unforked)


def test_kill_that_no_sample_reaches_is_named(now: Present) -> None:
    of = forked(now, goal=NEAR, kills=(("goto", 30.0), ("avoid", 5.0)))
    runs = [Sample(seed=0, end=ARRIVED, time_s=12.0), Sample(seed=1, end=ARRIVED, time_s=14.0)]
    (told,) = rehearse.unkilled(of, runs)
    assert "goto at 30 s" in told


def test_failed_sample_names_the_needed_agents_that_are_left_out(now: Present) -> None:
    """Without readings the behaviours do not drive: the time limit alone is no reason."""
    found = told(of := forked(now, goal=NEAR, without=("sonar",)), sample(of, 0))
    assert found.judgement.answer is Answer.NO
    assert any("without sonar" in why for why in found.fails)


def test_agent_that_is_in_every_society_cannot_be_left_out(now: Present) -> None:
    with pytest.raises(ConfigError, match="without robot"):
        fork(now, Errand(goal=NEAR, without=("robot",)))


@pytest.mark.parametrize(
    ("change", "expected", "words"),
    [
        ({"stop": Stop(1, True, "a person", 7)}, Answer.NO, "stopped by a person"),
        ({"motors": False}, Answer.NO, "motors are off"),
        ({"fault": "no packets"}, Answer.NO, "no packets"),
    ],
)
def test_robot_that_would_not_drive_gets_no(
    change: dict[str, object], expected: Answer, words: str
) -> None:
    stands = attended()
    stands.now()
    view = stands.account.view
    state = view.state
    assert isinstance(state, RobotState)
    stands.account.learn(replace(state, **change), stands.run.mesh.now)
    found = fork(present(stands.account, stands.run.mesh.now), Errand(goal=NEAR))
    assert isinstance(found, Judgement)
    assert found.answer is expected
    assert words in found.reason


def test_lost_robot_and_silent_one_are_unknown() -> None:
    stands = attended()
    later = present_of(stands, stands.run.mesh.now + 10.0)
    assert later.ready.answer is Answer.UNKNOWN
    assert "state is not known" in later.ready.reason
    pose = stands.account.view.pose
    assert isinstance(pose, Pose)
    lost = replace(pose, covariance=(1.0, 0.0, 0.0, 1.0, 0.0, 0.1))
    stands.account.learn(lost, stands.run.mesh.now)
    found = fork(present_of(stands, stands.run.mesh.now), Errand(goal=NEAR))
    assert isinstance(found, Judgement)
    assert found.answer is Answer.UNKNOWN
    assert "lost" in found.reason
    assert found.cure


def present_of(stands: Attended, at: float) -> Present:
    stands.now()
    return present(stands.account, at)


def test_what_is_seen_and_on_no_map_stands_in_the_fork() -> None:
    now = attended(moving=(BOX,)).now()
    of = forked(now, goal=NEAR)
    seen = [*of.walls, *(wall for _, own in of.people for wall in own)]
    assert BOX.at is not None
    near = [hypot(x - BOX.at[0], y - BOX.at[1]) for x, y, *_ in seen]
    assert near, "the box is seen"
    assert max(near) < 1.2, "and nothing else is, but for how its sides may go on"


def test_old_pose_is_unknown() -> None:
    stands = attended()
    stands.now()
    later, state = stands.run.mesh.now + 10.0, stands.account.view.state
    assert isinstance(state, RobotState)
    stands.account.learn(state, later)
    ready = present(stands.account, later).ready
    assert ready.answer is Answer.UNKNOWN
    assert "pose is not known" in ready.reason


class Deaf(Attended):
    """It receives no obstacles once it is deaf."""

    deaf = False

    def _on_message(self, key: str, message: Message, now: float) -> None:
        if not (self.deaf and isinstance(message, Obstacles | LocalMap)):
            super()._on_message(key, message, now)


def test_old_obstacles_or_none_at_all_leave_the_answer_unknown() -> None:
    stands = attended(moving=(BOX,), kind=Deaf)
    assert not stands.now().lacks
    assert stands.now().obstacles
    assert isinstance(stands, Deaf)
    stands.deaf = True
    stands.run.mesh.run(stands.run.mesh.now + 3.0)
    old = stands.now()
    assert not old.obstacles, "they may be gone"
    assert "what stands around the robot" in judged(old).reason
    stands.account.obstacles.clear()
    assert "what stands around the robot" in judged(stands.now()).reason, "they never came"


def judged(now: Present) -> Judgement:
    """The answer where all samples arrive."""
    found = told(forked(now, goal=NEAR), Sample(seed=0, end=ARRIVED)).judgement
    assert found.answer is Answer.UNKNOWN
    return found


@pytest.mark.parametrize("words", ["the wheels do not turn", "COLLISION"])
def test_fault_that_the_society_reports_leaves_the_answer_unknown(words: str) -> None:
    """Nothing holds the wheels in the samples. `doctor` finds the one, the monitor the other."""
    drives = attended(besides=("monitor",))
    run = drives.run
    run.begin()
    run.mesh.run(run.mesh.now + 3.0)
    assert drives.now().lacks == ()
    assert not any("no monitor" in each for each in drives.now().unforked)
    run.robot.plant.jammed = True
    for _ in range(100):
        run.mesh.run(run.mesh.now + 0.2)
        now = drives.now()
        if any(words in each for each in now.lacks):
            break
    assert words in judged(now).reason, "it is reported within 20 s"


def test_promise_that_a_monitor_saw_broken_leaves_the_answer_unknown() -> None:
    stands = attended(besides=("monitor",))
    stands.now()
    at, view = stands.run.mesh.now, stands.account.view
    (report,) = view.reports.values()
    broken = replace(report, broken=("SENSORS: sonar: the sonar repeats its readings",))
    stands.account.learn(broken, at)
    assert "sonar repeats" in judged(present(stands.account, at)).reason
    stands.account.learn(report, at)
    assert not present(stands.account, at).lacks


def test_fault_of_an_agent_leaves_the_answer_unknown() -> None:
    stands = attended()
    stands.now()
    at, view = stands.run.mesh.now, stands.account.view
    card = next(card for name, _, card in view.agents if name == "goto" and card is not None)
    for fault in ({"fault": "no fuzzy rules"}, {"doubts": "the battery's voltage is odd"}):
        stands.account.learn(replace(card, **fault), at)  # type: ignore[arg-type]
        assert next(iter(fault.values())) in judged(present(stands.account, at)).reason


@pytest.mark.parametrize("doubt", ["elsewhere", "off_map"])
def test_pose_that_the_readings_contradict_leaves_the_answer_unknown(doubt: str) -> None:
    stands = attended()
    stands.now()
    stands.account.learn(replace(CORRECTION, **{doubt: True}), stands.run.mesh.now)
    doubtful = present(stands.account, stands.run.mesh.now)
    assert judged(doubtful).reason
    stands.account.learn(CORRECTION, stands.run.mesh.now)
    assert not present(stands.account, stands.run.mesh.now).lacks


def test_society_in_which_nobody_watches_for_faults_is_named(now: Present) -> None:
    assert any("no monitor" in each for each in now.unforked)


def test_charge_that_an_agent_has_not_told_leaves_the_answer_unknown() -> None:
    stands = attended()
    now, sensor = stands.now(), "battery-sensor-00000000000000aa"
    assert not forked(now, goal=NEAR).charged, "nobody tells it, and no answer does"
    at, card = stands.run.mesh.now, next(iter(stands.account.view.cards.values()))
    stands.account.token(sensor, there=True, t=at)
    key = service_of(BatteryLevel).key
    stands.account.learn(replace(card, name="battery-sensor", instance=sensor, provides=(key,)), at)
    assert any("battery/level" in each for each in present(stands.account, at).lacks)
    level = BatteryLevel(Cycle(1, 1), 12.0, 0.5, 1e5)
    stands.account.learn(level, at)
    told_it = present(stands.account, at)
    assert not any("battery/level" in each for each in told_it.lacks)
    assert told_it.battery == 0.5


def test_agent_whose_token_is_gone_in_a_recording_takes_no_part() -> None:
    """A late reply to a query does not revive it."""
    card = Card("goto", "goto-00000000000000aa", "here", 1, "", 3, (), (), ())
    gone = Presence("armadico", card.name, card.instance, there=False, at=0)
    there = Presence("armadico", card.name, card.instance, there=True, at=0)
    rows: list[tuple[float, Message | Presence]] = [
        *((0.0, there), (0.1, card), (2.0, gone), (2.1, card)),
    ]
    assert present_at(rows, 1.0).names == ("goto",)
    assert present_at(rows, 3.0).names == ()


def without_goto(*, gone: bool) -> Attended:
    """A society in which goto is not alive, and was seen to end or not."""
    found = attended()
    found.now()
    view, at = found.account.view, found.run.mesh.now
    (instance,) = (each for each in view.alive if each.startswith("goto-"))
    found.account.token(instance, there=False, t=at)
    if not gone:
        del view.gone[instance]
    return found


def share(state: KeptState, *, leaving: bool = False) -> HostShare:
    return HostShare("wakeup-1", "here", (Kept(("goto",), state),), leaving=leaving)


@pytest.mark.parametrize(
    "tells",
    [
        None,  # its token disappeared a moment ago
        share(KeptState.WAITING),
        share(KeptState.STARTING),
        MonitorReport("monitor-1", 1, acts=True, missing=("goto",)),
    ],
)
def test_agent_that_may_be_restarted_leaves_a_failure_unknown(tells: Message | None) -> None:
    stands = without_goto(gone=tells is None)
    at = stands.run.mesh.now
    if tells is not None:
        stands.account.learn(tells, at)
    now = present(stands.account, at)
    fails = Sample(seed=0, end="failed", why="no agent drives")
    found = told(forked(now, goal=NEAR), fails)
    assert found.judgement.answer is Answer.UNKNOWN
    assert any("goto" in each and "not alive" in each for each in found.lacks)
    left_out = forked(now, goal=NEAR, without=("goto",))
    assert not left_out.lacks, "on purpose"
    assert told(left_out, fails).judgement.answer is Answer.NO
    later = present(stands.account, at + 100.0)
    assert ("goto" in later.absent) == isinstance(tells, MonitorReport)


@pytest.mark.parametrize("state", [share(KeptState.ENDED), share(KeptState.UP, leaving=True)])
def test_agent_that_was_ended_on_request_takes_no_part(state: HostShare) -> None:
    stands = without_goto(gone=True)
    stands.account.learn(state, stands.run.mesh.now)
    assert not present(stands.account, stands.run.mesh.now).absent


def test_society_without_an_agent_that_takes_goals_is_not_refused_by_it(now: Present) -> None:
    """The goal may be fine: if the interface agent is being restarted, nobody knows."""
    run = sample(forked(now, goal=NEAR, without=("interface",)), 0)
    assert told(forked(now, goal=NEAR), run).judgement.answer is Answer.NO
    assert answer([run], lacks=["interface"]).judgement.answer is Answer.UNKNOWN


def test_other_robot_that_was_seen_long_ago_is_named() -> None:
    stands = attended()
    at = stands.run.mesh.now
    other = FleetPose("second", 5.0, 2.0, 0.0, (0.0,) * 6, 0.0, 0.0, 0.2, 0.2, 0.2)
    stands.account.learn(other, at)
    assert not any("second" in each for each in present(stands.account, at).unforked)
    assert any("second" in each for each in present(stands.account, at + 30.0).unforked)


@pytest.mark.parametrize(
    ("ahead_m", "becomes"), [(0.15, "a thing"), (0.02, "unknown"), (-0.15, "the robot")]
)
def test_what_is_right_before_the_robot_counts(now: Present, ahead_m: float, becomes: str) -> None:
    """What is in its footprint is the robot; what its edge may cut cannot stand there."""
    x, y = 1.5, 0.0
    empty = replace(now, world="empty", pose=(x, y, 0.0))
    front = load_profile("pioneer-2dx").body.front_m
    of = forked(replace(empty, obstacles=((x + front + ahead_m, y),)), goal=(9.0, 0.0, 0.0))
    assert bool(of.walls or of.people) == (becomes == "a thing")
    assert any("within 0.1 m" in each for each in of.lacks) == (becomes == "unknown")
    if of.walls:
        near = alike(of, covariance=(1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6))
        starts = [draw(near, seed).start for seed in range(10)]
        assert len({*starts}) > 5, "it may be elsewhere, as without it"


def test_laser_that_goes_through_walls_of_the_map_leaves_the_answer_unknown(now: Present) -> None:
    """They are gone, or of glass, or the map is another one's."""
    assert now.pose is not None
    x, y, _ = now.pose
    ahead = [Ray(x, y, 0.05 * k, 9.0) for k in range(100)]
    as_mapped = [each._replace(range=0.4) for each in ahead]
    assert not forked(replace(now, rays=tuple(as_mapped)), goal=NEAR).lacks
    of = forked(replace(now, rays=tuple(ahead)), goal=NEAR)
    assert any("whether the map holds" in each for each in of.lacks)


def test_what_is_off_the_map_in_sight_raises_what_is_expected_elsewhere(now: Present) -> None:
    things = tuple((3.0 + 0.8 * k, 2.6) for k in range(2))
    clean, cluttered = (forked(replace(now, obstacles=o), goal=NEAR).rate for o in ((), things))
    assert cluttered.things == 2
    assert 0.0 < clean.chance(5.0) < cluttered.chance(5.0) < 1.0
    assert clean.chance(0.0) == 0.0


# The fork -----------------------------------------------------------------------------------------


def test_top_speed_that_the_guard_or_the_mission_admits_is_kept(now: Present) -> None:
    assert now.described is not None
    slow = replace(now, described=replace(now.described, v_max=0.2))
    run = Forked(forked(slow, goal=NEAR), 1, lambda: False)
    run.start()
    about = run.watch.view.description
    assert about is not None
    assert about.v_max == 0.2
    by_mission = replace(slow, mission_v_max=0.2, goal=(3.2, 1.6, 0.0))
    assert "robot.v_max=0.2" in forked(by_mission).options.sets, "it goes on"
    other = forked(by_mission, goal=NEAR)
    assert "robot.v_max=0.2" not in other.options.sets, "the limit ends with that mission"
    assert any("top speed" in each for each in other.unforked)


def test_robot_that_is_not_as_its_profile_here_leaves_the_answer_unknown(now: Present) -> None:
    assert now.described is not None
    longer = replace(now, described=replace(now.described, front=0.4, v_decel=0.1))
    assert "front 0.4, here" in judged(longer).reason
    assert "v_decel 0.1, here" in judged(longer).reason


def test_delays_that_nobody_measures_are_named() -> None:
    stands = attended()
    stands.now()
    at, view = stands.run.mesh.now, stands.account.view
    assert not any("delays" in each for each in stands.now().unforked), "it is a simulator, too"
    card = next(card for name, _, card in view.agents if name == "robot" and card is not None)
    stands.account.learn(replace(card, version=version()), at)
    assert any("delays" in each for each in present(stands.account, at).unforked)


def test_samples_begin_at_poses_drawn_from_the_covariance(now: Present) -> None:
    of = alike(forked(now, goal=NEAR), covariance=(0.04, 0.0, 0.0, 0.0001, 0.0, 0.0001))
    starts = [draw(of, seed).start for seed in range(40)]
    assert draw(of, 3) == draw(of, 3)
    spread = [max(each) - min(each) for each in zip(*starts, strict=True)]
    assert 0.3 < spread[0] < 1.5
    assert spread[1] < 0.1


@pytest.mark.parametrize(
    ("errand", "words"),
    [
        ({"without": ("avoit",)}, "avoid"),
        ({"sets": ("goto.v_maxx=1",)}, "v_max"),
        ({"sets": ("nobody.x=1",)}, "nobody"),
        ({"kills": (("nobody", 1.0),)}, "nobody"),
        ({"goal": None}, "name a goal"),
    ],
)
def test_impossible_errand_is_refused(now: Present, errand: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        fork(now, Errand(**{"goal": NEAR, **errand}))  # type: ignore[arg-type]


def test_map_that_is_not_here_is_unknown(now: Present) -> None:
    found = fork(replace(now, maps=("89abcdef",)), Errand(goal=NEAR))
    assert isinstance(found, Judgement)
    assert (found.answer, "another map" in found.reason) == (Answer.UNKNOWN, True)
    found = fork(replace(now, world="/nowhere/else.map"), Errand(goal=NEAR))
    assert isinstance(found, Judgement)
    assert found.answer is Answer.UNKNOWN
    assert "else.map" in found.reason


def test_a_map_of_another_name_is_not_compared_with_theirs() -> None:
    """Such as that of an agent that was started by hand without one; doctor reports it."""
    stands = attended()
    stands.now()
    at, view = stands.run.mesh.now, stands.account.view
    card = next(card for name, _, card in view.agents if name == "sonar" and card is not None)
    for world, maps in (("empty", ()), ("sc4", ("89abcdef",))):
        stands.account.learn(replace(card, world=world, map="89abcdef"), at)
        of = present(stands.account, at)
        assert (of.world, of.maps) == ("sc4", maps)


def test_map_that_slam_makes_is_driven_on(now: Present) -> None:
    """A room of 6 m by 5 m, as far as it was seen: a part of it was not."""
    pytest.importorskip("armadico.agents.slam")
    pytest.importorskip("armadico.agents.missions")
    states = np.full((102, 122), FREE, dtype=np.uint8)
    states[[0, -1], :] = states[:, [0, -1]] = OCCUPIED
    states[60:80, 60:80] = 0
    cells = Cells(-0.05, -0.05, 0.05, states)
    agents = tuple(
        replace(each, name="slam", sets=()) if each.name == "localization" else each
        for each in now.agents
        if each.name != "path-planning"
    )
    slams = replace(now, world="", grid=message_of(cells), agents=agents, pose=(1.5, 1.5, 0.0))
    with made_map(slams) as made:
        of = fork(slams, Errand(goal=(2.5, 1.5, 0.0)), made=made)
        assert isinstance(of, Fork), of
        assert {"localization", "path-planning"} <= {*of.scenario.agents}
        assert "slam" not in of.scenario.agents
        run = sample(of, 1)
        assert run.end == ARRIVED, run.why
        assert told(of, run).judgement.answer is Answer.UNKNOWN
        assert "slam" in told(of, run).judgement.reason
    with made_map(now) as made:
        assert made is None, "its map is known"


# Samples ------------------------------------------------------------------------------------------


def test_near_goal_is_reached_and_nothing_of_the_society_changes(stands: Attended) -> None:
    before = stands.run.mesh.now, stands.run.robot.plant.pose
    now = stands.now()
    of = forked(now, goal=NEAR)
    run = sample(of, 5)
    assert run.end == ARRIVED, run.why
    assert hypot(run.path[-1][1] - NEAR[0], run.path[-1][2] - NEAR[1]) < 0.3
    assert run == sample(of, 5), "one seed gives one sample"
    found = told(of, run)
    assert found.judgement.passed
    assert (found.arrives, found.samples) == (1, 1)
    assert "arrives in 1 of 1" in found.says
    assert len(msgspec.json.encode(found.small)) < 1500
    assert msgspec.json.encode(found.full)
    assert "<polyline" in drawn(found)
    assert (stands.run.mesh.now, stands.run.robot.plant.pose) == before


Driven = Generator[tuple[int, Sample], None, None]

FAR = (7.4, 0.7, None)
"""Behind a wall, seen from where the robot stands."""


def test_something_is_put_on_the_way_out_of_sight(now: Present) -> None:
    of = forked(now, goal=FAR)
    assert of.sight.sees(3.4, 1.6)
    assert not of.sight.sees(6.0, 1.0)
    calls = count()
    run = sample(of, 1, lambda: next(calls) > 5, patience_s=inf)
    assert run.put is not None
    assert not of.sight.sees(*run.put) or hypot(run.put[0] - START[0], run.put[1] - START[1]) > 1.0
    assert not run.holds
    unbegun = sample(of, 1, lambda: True, patience_s=inf)
    assert unbegun.put is None
    assert not unbegun.holds, "it might have met something"
    in_sight = forked(now, goal=(3.4, 1.8, None))
    seen = sample(in_sight, 1, lambda: next(calls) > 12, patience_s=inf)
    assert seen.put is None, "all of this way is in sight"


def test_robot_that_does_not_get_past_is_not_awaited(now: Present) -> None:
    of = forked(now, goal=FAR)
    run = sample(of, 1, patience_s=0.5)
    assert (run.end, run.why, run.holds) == ("failed", "not past it", False)
    assert run.time_s < 1.5


@pytest.mark.parametrize(
    ("error", "end"),
    [
        (AgentFailedError("goto\n  no brakes"), BROKEN),
        (MissionRefusedError("it moves"), REFUSED),
    ],
)
def test_sample_that_ends_early_keeps_what_was_put_on_its_way(
    now: Present, monkeypatch: pytest.MonkeyPatch, error: Exception, end: str
) -> None:
    def goes_on(run: Forked, _: float) -> bool:
        if run.put is not None:
            raise error
        return True

    monkeypatch.setattr(Forked, "goes_on", goes_on)
    run = sample(forked(now, goal=FAR), 1, patience_s=inf)
    assert (run.end, run.holds) == (end, False)


class Half:
    """Samples that take no time, by their seeds: in the first half the map holds."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, hidden_m: float, end: str = ARRIVED):
        self.patience: dict[int, float | None] = {}
        self.hidden_m, self.end = hidden_m, end
        monkeypatch.setattr(rehearse, "sample", self.sample)

    def sample(self, _of: Fork, seed: int, _over: object, *, patience_s: float | None) -> Sample:
        self.patience[seed] = patience_s
        return Sample(seed=seed, end=self.end, time_s=10.0 + seed, hidden_m=self.hidden_m)


def in_turn(drives: Callable[[int], Sample], seeds: Sequence[int]) -> Driven:
    yield from enumerate(map(drives, seeds))


@pytest.mark.parametrize(
    ("things", "hidden_m", "end", "patience_s"),
    [
        (9, 8.0, ARRIVED, 3 * 12.0),
        (9, 0.0, ARRIVED, None),
        (0, 3.0, ARRIVED, None),
        (9, 8.0, "failed", None),
    ],
)
def test_something_is_put_only_where_it_may_change_the_answer(
    now: Present,
    monkeypatch: pytest.MonkeyPatch,
    things: int,
    hidden_m: float,
    end: str,
    patience_s: float | None,
) -> None:
    """The samples in which the map holds come first: none waits for one that is stuck."""
    half = Half(monkeypatch, hidden_m, end)
    of = alike(forked(now, goal=FAR), rate=Rate(things, 30.0))
    ended: list[int] = []
    runs = rehearse.driven(of, range(1, 6), in_turn, done=ended.append)
    assert [*half.patience.items()] == [
        *((seed, None) for seed in (1, 2, 3)),
        *((seed, patience_s) for seed in (4, 5)),
    ]
    assert [run.seed for run in runs] == ended == [1, 2, 3, 4, 5]


def test_samples_that_never_began_are_of_their_kind(
    now: Present, monkeypatch: pytest.MonkeyPatch
) -> None:
    Half(monkeypatch, 8.0)
    of = alike(forked(now, goal=FAR), rate=Rate(9, 30.0))

    def stops(drives: Callable[[int], Sample], seeds: Sequence[int]) -> Driven:
        yield from (each for each in enumerate(map(drives, seeds)) if each[1].seed < 2)

    runs = rehearse.driven(of, range(4), stops)
    assert [run.end for run in runs] == [ARRIVED, ARRIVED, UNENDED, UNENDED]
    found = answer(runs, rate=of.rate)
    assert (found.arrives, found.samples, found.despite) == (2, 2, (0, 0))
    assert found.judgement.answer is Answer.UNKNOWN, "nothing was tried there"
    assert "2 with something there did not end" in found.says


@pytest.mark.parametrize(("robot", "speed"), [("pioneer-2dx", 0.7), ("jackal", 0.5)])
def test_moving_robot_goes_on_at_its_speed(now: Present, robot: str, speed: float) -> None:
    """Nobody brakes it before an agent drives, and then nothing but the ramp does."""
    if robot == "jackal":
        pytest.importorskip("armadico.bridge.ros2")
    moving = replace(now, speeds=(speed, 0.0), robot=robot, profile=robot)
    run = Forked(forked(moving, goal=(3.4, 2.6, None)), 1, lambda: False)
    speeds: list[float] = []
    drivers: list[str] = []

    def on(_key: str, message: Message, _now: float) -> None:
        if isinstance(message, Truth) and message.v:
            speeds.append(message.v)
        elif isinstance(message, RobotState):
            drivers.append(message.driver)

    run.start()
    run.mesh.watch(on, Truth, RobotState, namespace=run.namespace)
    run.begin()
    run.mesh.run(run.mesh.now + 0.5)
    assert speeds[0] > 0.95 * speed
    assert speeds[1] > speed - 0.2 * load_profile("pioneer-2dx").limits.v_decel
    assert drivers[-1].startswith("goto"), "whom it obeys now"


def test_nobody_who_drives_leaves_a_moving_robot_at_rest(now: Present) -> None:
    """The command in force expires."""
    moving = replace(now, speeds=(0.3, 0.0))
    of = forked(moving, goal=NEAR, without=("goto", "gothrough", "avoid"))
    run = Forked(of, 1, lambda: False)
    run.start()
    run.begin()
    run.mesh.run(run.mesh.now + 2.0)
    truth = run.watch.view.truth
    assert truth is not None
    assert truth.v == 0.0


def test_sensor_that_reports_nothing_is_silent_in_the_samples(now: Present) -> None:
    assert not now.silent
    stands = attended()
    stands.run.robot.plant.sonar_readings.fail(Broken.SILENT)
    stands.run.mesh.run(stands.run.mesh.now + 3.0)
    broken = stands.now()
    assert broken.silent == ("sonar",)
    seen, dark = (forked(each, goal=NEAR).sight for each in (now, broken))
    assert seen.sees(3.4, 1.6)
    assert not dark.sees(3.4, 1.6), "it has not seen that this floor is empty"
    assert dark.area == 0.0
    run = Forked(forked(broken, goal=NEAR), 1, lambda: False)
    assert run.robot.plant.sonar_readings.silent
    assert not Forked(forked(now, goal=NEAR), 1, lambda: False).robot.plant.sonar_readings.silent


CORRECTION = Correction(
    Cycle(1, 1), 0.0, 0.0, 0.0, (0.0,) * COVARIANCE, 1.0, wheels=(0.01, -0.05, 0.01, 0.1, 0.1, 0.1)
)


@pytest.mark.parametrize("odd", [(0.1,), (0.01,) * 5, (-1.0, *[0.0] * 5), (0.01,) * 5 + (0.9,)])
def test_odd_errors_of_the_wheels_are_not_known(odd: tuple[float, ...]) -> None:
    stands = attended()
    stands.account.learn(CORRECTION, 0.0)
    assert stands.account.wheels == CORRECTION.wheels
    stands.account.learn(replace(CORRECTION, wheels=odd), 0.1)
    assert stands.account.wheels == ()


def test_what_localization_has_learnt_is_named_as_left_out() -> None:
    """In a sample it begins without."""
    stands = attended()
    stands.now()
    at, view = stands.run.mesh.now, stands.account.view
    card = next(c for name, _, c in view.agents if name == "localization" and c is not None)
    assert stands.account.wheels
    stands.account.learn(replace(card, learnt="the left wheel is worn"), at)
    assert any("left wheel is worn" in each for each in present(stands.account, at).unforked)


def test_laser_that_meets_nothing_goes_through_walls_too() -> None:
    stands = attended()
    at = stands.run.mesh.now
    mm = np.array([0, 65535, 2500], dtype="<u2")
    stands.account.learn(Scan(Cycle(1, 1), 0.2, 0.0, -0.1, 0.1, 8.0, mm.tobytes()), at)
    assert [ray.range for ray in present(stands.account, at).rays] == [8.0, 2.5]


def test_odometry_errs_as_is_estimated_and_as_far_as_that_may_be_off(now: Present) -> None:
    assert len(now.wheels) == 6, "localization tells it"
    sure = forked(replace(now, wheels=(0.02, -0.05, 0.01, 0.0, 0.0, 0.0)), goal=NEAR)
    vague = forked(replace(now, wheels=(0.02, -0.05, 0.01, 9.0, 9.0, 9.0)), goal=NEAR)
    odometry = Forked(sure, 1, lambda: False).robot.plant.wheels
    assert drawn_wheels(sure, odometry.usual, 7) == (0.02, -0.05, 0.01)
    odometry.reset()
    way = 0.0
    for _ in range(4000):  # 20 m ahead, on patches of floor that differ
        odometry.move(5e-3, 5e-3)
        way += odometry.v * 5e-3
    assert way == pytest.approx(20.0 / 1.01, rel=0.005)
    assert odometry.theta / 20.0 == pytest.approx(0.05, abs=0.02), "and 0.05 rad/m less is true"
    drawn = [drawn_wheels(vague, odometry.usual, k) for k in range(200)]
    for k, most in enumerate(odometry.usual):
        mean = sum(each[k] for each in drawn) / len(drawn)
        assert abs(mean - sure.wheels[k]) < 0.5 * most
        assert max(each[k] for each in drawn) - mean > 0.5 * most
    assert not drawn_wheels(forked(replace(now, exact=True), goal=NEAR), odometry.usual, 7)


def test_goal_in_a_wall_is_refused_by_the_planner(now: Present) -> None:
    of = forked(now, goal=(4.6, 0.5, None))
    run = sample(of, 0)
    assert run.end == REFUSED
    found = told(of, run)
    assert found.judgement.answer is Answer.NO
    assert found.refused[0].by == "path-planning"


def test_interface_agent_refuses_a_mission_that_nobody_plans() -> None:
    found = answer([Sample(seed=0, end=REFUSED, why=NO_MISSION_PLANNING)])
    assert found.refused[0].by == "interface"


def test_sample_without_time_is_unknown_and_not_failed(now: Present) -> None:
    of, calls = forked(now, goal=NEAR), count()
    run = sample(of, 0, lambda: next(calls) > 3)
    assert run.end == UNENDED
    found = told(of, run)
    assert found.judgement.answer is Answer.UNKNOWN
    assert found.judgement.cure


def test_killed_agents_do_not_drive(now: Present) -> None:
    calls = count()
    of = forked(now, goal=NEAR, kills=(("goto", 0.0), ("avoid", 0.0), ("gothrough", 0.0)))
    run = sample(of, 0, lambda: next(calls) > 30)
    assert run.way_m < 0.3
    assert not run.shares.keys() & {"goto", "gothrough"} or run.time_s < 8.0


def test_agent_that_is_not_installed_leaves_the_answer_unknown() -> None:
    """It may drive, and nobody knows how."""
    stands = attended()
    now = stands.run.mesh.now
    strange = "stranger-00000000000000aa"
    stands.now()
    stands.account.token(strange, there=True, t=now)
    card = Card("stranger", strange, "there", 1, "9", 3, (), (), (WHEELS.name,))
    stands.account.learn(card, now)
    of = fork(present(stands.account, now), Errand(goal=NEAR))
    assert isinstance(of, Fork)
    found = told(of, Sample(seed=0, end=ARRIVED))
    assert found.judgement.answer is Answer.UNKNOWN
    assert "stranger" in found.judgement.reason
    left_out = fork(present(stands.account, now), Errand(goal=NEAR, without=("stranger",)))
    assert isinstance(left_out, Fork)
    assert not left_out.lacks, "it is known what an agent does that is left out"


def test_agent_of_another_version_leaves_the_answer_unknown() -> None:
    stands = attended()
    stands.now()
    view, at = stands.account.view, stands.run.mesh.now
    card = next(card for name, _, card in view.agents if name == "goto" and card is not None)
    stands.account.learn(replace(card, version="0.0.1"), at)
    of = fork(present(stands.account, at), Errand(goal=NEAR))
    assert isinstance(of, Fork)
    assert "goto 0.0.1" in told(of, Sample(seed=0, end=ARRIVED)).judgement.reason


def test_agent_that_raises_leaves_the_answer_unknown(
    now: Present, monkeypatch: pytest.MonkeyPatch
) -> None:
    def raises(self: object, _: object) -> None:
        raise ValueError("it has no brakes")

    monkeypatch.setattr(agent_class("goto"), "on_robot_state", raises)
    of = forked(now, goal=NEAR)
    found = told(of, sample(of, 0), Sample(seed=1, end=ARRIVED))
    assert found.judgement.answer is Answer.UNKNOWN
    assert "goto" in found.judgement.reason
    assert "no brakes" in found.judgement.reason


# The answer ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("long", [2000 * "x", 2000 * "ä", 2000 * '"'])
def test_answer_counts_and_stays_small(long: str) -> None:
    runs = [
        *(Sample(seed=k, end=ARRIVED, time_s=40.0 + k, way_m=10.0) for k in range(3)),
        Sample(seed=3, end="failed", why=long, clearance=(0.0, 1.0, 2.0)),
    ]
    runs = [replace(run, shares={f"agent-{k}": 9 for k in range(30)}) for run in runs]
    found = answer(runs, lacks=[long] * 9, unforked=[long] * 9)
    assert (found.arrives, found.samples) == (3, 4)
    least, most = interval([40.0, 41.0, 42.0])
    assert found.time_s == (least, 41.0, most)
    assert found.judgement.answer is Answer.UNKNOWN
    assert len(json.dumps(found.small)) < 1500
    assert found.small["fails"]


@pytest.mark.parametrize(
    ("end", "lacks", "expected"),
    [
        ("failed", (), Answer.NO),
        ("failed", ("dock: it is not installed here",), Answer.UNKNOWN),
        (REFUSED, ("dock: it is not installed here",), Answer.NO),
    ],
)
def test_samples_of_another_society_than_the_robot_s_do_not_show_that_it_fails(
    end: str, lacks: tuple[str, ...], expected: Answer
) -> None:
    found = answer([Sample(seed=k, end=end, why="lost for 60 s") for k in range(2)], lacks=lacks)
    assert found.judgement.answer is expected
    assert "lost for 60 s" in found.judgement.reason
    if expected is Answer.UNKNOWN:
        assert all(each in found.judgement.reason for each in lacks)
        assert found.says.startswith("not known: 2 of 2 did not arrive; 2 of 2: lost")


def test_sentence_begins_with_what_did_not_end() -> None:
    runs = [Sample(seed=k, end=UNENDED, why="not ended") for k in range(4)]
    assert answer(runs, took_s=30.0).says.startswith("not known: 4 of 4 had not ended after 30 s")
    both = answer([*runs[:2], put(8, UNENDED), put(9, UNENDED)], took_s=30.0)
    assert both.says.startswith("not known: 2 of 2 had not ended"), (
        "of those in which the map holds"
    )
    one = [*runs[1:], Sample(seed=0, end=ARRIVED, time_s=9.0)]
    assert answer(one, took_s=30.0).says.startswith(
        "not known: 3 of 4 had not ended after 30 s; arr"
    )


def put(k: int, end: str) -> Sample:
    return Sample(seed=k, end=end, why="lost for 60 s", time_s=35.0, put=(5.0, 1.0), hidden_m=6.0)


PLAIN = Sample(seed=0, end=ARRIVED, time_s=20.0, way_m=8.0, hidden_m=6.0)


@pytest.mark.parametrize(
    ("things", "ends", "expected"),
    [
        (0, (ARRIVED, ARRIVED), Answer.YES),
        (9, (ARRIVED, ARRIVED), Answer.YES),
        (9, (ARRIVED, "failed"), Answer.UNKNOWN),
        (9, ("failed", UNENDED), Answer.UNKNOWN),
        (1, (UNENDED, ARRIVED), Answer.YES),
        (1, (UNENDED, UNENDED), Answer.UNKNOWN),
    ],
)
def test_way_out_of_sight_is_unknown_if_what_may_stand_there_would_stop_the_robot(
    things: int, ends: tuple[str, ...], expected: Answer
) -> None:
    rate = Rate(things, 30.0)
    found = answer([PLAIN, *(put(k, end) for k, end in enumerate(ends))], rate=rate)
    assert found.judgement.answer is expected
    assert (found.arrives, found.samples) == (1, 1), "of those in which the map holds"
    assert found.despite == (ends.count(ARRIVED), sum(end != UNENDED for end in ends))
    assert ("did not end" in found.says) == (UNENDED in ends), "that is not known"
    least, middle, most = found.time_s
    assert (least, middle) == (interval([20.0])[0], 20.0)
    longest_s = [35.0] * ends.count(ARRIVED) or [20.0]
    assert most == interval(longest_s)[1], "of a drive that meets something, too"
    assert found.despite_s == (35.0 if ARRIVED in ends else None)
    assert "6.0 of 8.0 m are out of sight" in found.says
    assert found.chance is not None
    fewer = answer([PLAIN, put(1, "failed"), put(2, "failed")], rate=rate).chance
    assert fewer is not None
    assert fewer <= found.chance < 1.0


@pytest.mark.parametrize("spread", [0.05, 0.2])
@pytest.mark.parametrize("samples", [1, 2, 4, 8])
def test_time_told_holds_that_of_one_more_drive_however_few_samples_there_are(
    samples: int, spread: float
) -> None:
    """The least to the most of four samples would hold 60 %."""
    rng = Random(samples)

    def drawn() -> float:
        return 30.0 * rng.lognormvariate(0.0, spread)

    held = 0
    for _ in range(2000):
        least, most = interval([drawn() for _ in range(samples)])
        held += least <= drawn() <= most
    assert held / 2000 > (0.9 if spread <= SPREAD else 0.8), "few do not show a large spread"


@pytest.mark.parametrize(("free", "expected"), [(2, 2.920), (3, 2.353), (5, 2.015), (9, 1.833)])
def test_quantile_is_that_of_the_tables(free: int, expected: float) -> None:
    assert student(free) == pytest.approx(expected, rel=0.015)


def test_way_in_sight_owes_nothing_to_the_map() -> None:
    found, many = (answer(n * [replace(PLAIN, hidden_m=0.0)], rate=Rate(9, 30.0)) for n in (1, 9))
    assert found.judgement.answer is Answer.YES
    assert found.chance is not None
    assert many.chance is not None
    assert 0.7 < found.chance < 0.9 < many.chance < 1.0, "few samples show little"
    assert found.stands == 0.0
    assert "out of sight" not in found.says


@pytest.mark.parametrize(
    ("ends", "chance"),
    [
        ((UNENDED, UNENDED), None),
        ((BROKEN,), None),
        ((REFUSED, REFUSED), 0.0),
        ((ARRIVED, UNENDED, BROKEN), 0.75),
        (("failed", "failed"), 1 / 6),
        ((ARRIVED, ARRIVED, ARRIVED, ARRIVED), 0.9),
    ],
)
def test_chance_is_of_the_samples_that_ended(ends: tuple[str, ...], chance: float | None) -> None:
    runs = [Sample(seed=k, end=end) for k, end in enumerate(ends)]
    assert answer(runs).chance == (chance and pytest.approx(chance))


def test_chance_and_answer_weigh_what_may_stand_there_alike() -> None:
    """The share of the samples with something put there counts as often as something stands."""
    rate = Rate(9, 30.0)
    stands = rate.chance(6.0)
    runs = [PLAIN, replace(PLAIN, end="failed"), put(1, ARRIVED), put(2, "failed")]
    assert answer(runs, rate=rate).chance == pytest.approx(0.5)
    alone = answer([PLAIN], rate=rate)
    assert alone.chance == pytest.approx((1 - stands) * 0.75 + stands * 0.5)
    assert alone.judgement.answer is Answer.UNKNOWN, "nothing was tried"


def test_tidy_ways_are_a_yes_whatever_would_be_put_there() -> None:
    for hidden_m in (5.0, 8.0, 13.0):
        plain = replace(PLAIN, hidden_m=hidden_m)
        runs = [plain, plain, put(2, "failed"), put(3, "failed")]
        assert answer(runs, rate=Rate(0, 9.8)).judgement.answer is Answer.YES


class Blind(Sight):
    """It sees nothing."""

    def __init__(self) -> None:
        super().__init__((), ())


def test_nothing_is_put_on_the_robot() -> None:
    keep_m = 0.34
    bent = ((0.0, 0.0), (1.2, 0.0), (1.2, 1.2), (-3.0, 1.2), (-6.0, 1.2))
    sides = []
    for k in range(500):
        found = place(bent, Blind(), keep_m, Random(k))
        assert found is not None
        sides += found[1]
    assert min(distance(*bent[0], side) for side in sides) > keep_m
    assert min(distance(*bent[-1], side) for side in sides) > keep_m


def test_failure_among_things_whose_size_is_not_known_is_unknown() -> None:
    runs = [Sample(seed=1, end="failed", why="no way that keeps clear")]
    assert answer(runs).judgement.answer is Answer.NO
    vague = answer(runs, vague=1).judgement
    assert vague.answer is Answer.UNKNOWN
    assert "no way that keeps clear" in vague.reason
    assert vague.cure
    refused = [Sample(seed=0, end=REFUSED, why="the goal is in a wall")]
    assert answer(refused, vague=1).judgement.answer is Answer.NO


def test_things_are_vague_by_sonars_and_those_like_people_by_laser(now: Present) -> None:
    pytest.importorskip("armadico.bridge.ros2")
    pieces = tuple((3.0 + 0.1 * k, 2.6) for k in range(12))
    sonars = forked(replace(now, obstacles=pieces), goal=NEAR)
    laser = forked(replace(now, obstacles=pieces, robot="jackal", profile="jackal"), goal=NEAR)
    assert (sonars.rate.things, sonars.vague) == (1, 1)
    assert (laser.rate.things, laser.vague) == (1, 0), "larger than a person"
    assert forked(replace(now, obstacles=()), goal=NEAR).vague == 0


def test_yes_needs_all_samples_and_no_needs_none_of_them() -> None:
    fails = Sample(seed=1, end="failed", why="touched")
    assert answer([PLAIN, PLAIN]).judgement.answer is Answer.YES
    assert answer([fails, fails]).judgement.answer is Answer.NO
    found = answer([*[PLAIN] * 7, fails])
    assert found.judgement.answer is Answer.UNKNOWN
    assert "1 of 8: touched" in found.judgement.reason
    assert found.chance == pytest.approx(7.5 / 9)
    refused = Sample(seed=2, end=REFUSED, why="something stands on the goal")
    assert answer([PLAIN, refused]).judgement.answer is Answer.UNKNOWN


def test_failure_beside_an_agent_that_raises_names_both() -> None:
    runs = [Sample(seed=0, end="failed", why="touched"), Sample(seed=1, end=BROKEN, why="goto: no")]
    judgement = answer(runs).judgement
    assert judgement.answer is Answer.UNKNOWN
    assert "touched" in judgement.reason
    assert "goto: no" in judgement.reason


def test_nothing_driven_is_unknown() -> None:
    assert answer([]).judgement.answer is Answer.UNKNOWN


def test_unseen_way_is_never_a_yes() -> None:
    from armadico.mobile.messages import Stretch

    run = Sample(seed=0, end=ARRIVED, unseen=(Stretch(0.0, 0.0, 2.0, 0.0),))
    found = answer([run])
    assert found.judgement.answer is Answer.UNKNOWN
    assert found.unseen_m == 2.0
