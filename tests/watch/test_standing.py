"""Why the robot stands: chains of reasons in societies on the virtual mesh, and in views."""

from __future__ import annotations

from msgspec.structs import replace

from armadico.config.scenarios import load_scenario
from armadico.core.discovery import providers
from armadico.core.judgement import Answer
from armadico.core.messages import Cycle, Message, MonitorReport, RobotState, Stop
from armadico.core.services import service_of
from armadico.mobile.messages import (
    MissionRequest,
    MissionState,
    MissionStatus,
    Pose,
    Trajectory,
    Waypoint,
)
from armadico.observe.findings import Demand, Finding, Sort
from armadico.observe.standing import lost, standing
from armadico.observe.view import View
from armadico.watch.why import Chronicle
from tests.watch.broken import cut
from tests.watch.observed import Observed


def test_a_moving_robot_has_no_cause_and_a_robot_without_a_goal_has_that_cause() -> None:
    society = Observed()
    idle = society.standing
    assert idle.stands
    assert idle.cause is not None
    assert idle.cause.sort is Sort.NO_GOAL
    moving = society.drive().standing
    assert not moving.stands
    assert moving.cause is None
    assert "goto drives" in moving.sentences[0]


def test_a_robot_that_stays_lost_by_laser_is_told_how_to_measure_the_mounting_of_its_scanner() -> (
    None
):
    about = Observed().view.description
    assert about is not None
    for sensors, stays_s, told in (
        (("laser",), 61.0, 1),
        (("laser",), 5.0, 0),
        (("sonar",), 61, 0),
    ):
        view = View()
        view.update("robot/description", replace(about, sensors=sensors), 0.0)
        unsure = (4.0, 0.0, 0.0, 4.0, 0.0, 1.0)
        view.update("encoder/pose", Pose(Cycle(1, 1), 0, 0, 0, unsure), 0.0)
        found = lost(view, stays_s)
        assert found is not None
        assert found.todo.count("`armadico mounting`") == told


def test_a_new_observer_names_the_installed_agent_or_the_host_that_provides_the_missing_key() -> (
    None
):
    """It has no card of an agent that ended before."""
    society = Observed().drive()
    society.mesh.node("sonar").kill()
    society.let_pass(3.0)
    society.chronicle = Chronicle()
    society.let_pass(2.0)
    here = [name for name in society.view.names if name != "sonar"]
    table = {"lab1": here, "lab2": ("sonar",)}

    def cause(demand: Demand) -> Finding:
        found = standing(society.view, society.mesh.now, demand).cause
        assert found is not None
        return found

    unknown, known = cause(Demand()), cause(Demand(installed=providers))
    assert (unknown.sort, unknown.who) == (Sort.ABSENT, "sonar/obstacles")
    assert (known.sort, known.who) == (Sort.ABSENT, "sonar")
    host = cause(Demand(table, "a1b2", providers))
    assert (host.sort, host.who) == (Sort.HOST, "lab2")
    assert "lab2" in host.what
    assert "sonar" in host.what
    assert "`armadico up --host lab2`" in host.todo


def test_if_no_agent_is_alive_the_hosts_of_the_table_are_named() -> None:
    view = View()
    view.token("goto-1", there=True, t=0.0)
    view.token("goto-1", there=False, t=1.0)
    table = {"lab1": ("goto",), "lab2": ("sonar",)}
    cause = standing(view, 2.0, Demand(table, "a1b2", providers)).cause
    assert cause is not None
    assert "--host lab1" in cause.todo
    here = standing(view, 2.0, Demand({"lab1": ("goto",)}, installed=providers)).cause
    assert here is not None
    assert here.todo == "`armadico up`, run on lab1, starts its agents", "it has no table"
    assert "--host lab2" in cause.todo
    without_table = standing(view, 2.0, Demand(installed=providers)).cause
    assert without_table is not None
    assert (without_table.sort, without_table.who) == (cause.sort, cause.who)
    assert "--host" not in without_table.todo


def test_a_society_that_has_ended_or_is_out_of_reach_has_no_agent_as_its_cause() -> None:
    society = Observed().drive()
    gap = standing(society.view, society.mesh.now + 10.0).cause
    assert gap is not None
    assert (gap.sort, gap.who) == (Sort.UNKNOWN, "")
    assert "for 10.0 s" in gap.what
    for node in society.mesh.nodes:
        node.leave()
    ended = society.let_pass(3.0).standing
    assert len(ended.sentences) == 1
    assert ended.cause is not None
    assert (ended.cause.sort, ended.cause.who) == (Sort.ABSENT, "")


WELL = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, motors=True, stalled=False)


def cause_after(*messages: Message, t: float = 0.0) -> Finding | None:
    """The cause for a robot that stands, after some messages."""
    view = View()
    for message in (WELL, *messages):
        view.update(service_of(type(message)).key, message, t)
    return standing(view, t + 0.1).cause


def test_a_refused_goal_is_known_to_a_new_observer_too() -> None:
    """From the mission's note; earlier observers also have the log line."""
    society = Observed(scenario=load_scenario("rooms-a"))
    society.mesh.query(MissionRequest(Waypoint(0.0, 0.0, 0.0)), lambda _: None)
    society.let_pass(1.0)
    before = society.standing.cause
    society.chronicle = Chronicle()
    after = society.let_pass(2.0).standing.cause
    assert before == after
    assert before is not None
    assert before.sort is Sort.REFUSED_GOAL


def test_the_state_of_the_mission_is_the_cause() -> None:
    def status(state: MissionState, note: str = "") -> MissionStatus:
        return MissionStatus(1, state, 2.0, 0, note)

    waits = Trajectory(1, 1, (Waypoint(1, 1, 0),), waits=True)
    causes = {
        Sort.NO_GOAL: cause_after(status(MissionState.NONE)),
        Sort.REACHED: cause_after(status(MissionState.REACHED)),
        Sort.UNSURE: cause_after(status(MissionState.REACHED, "+-0.30 m")),
        Sort.PLANNING: cause_after(status(MissionState.PLANNING)),
        Sort.FAILED: cause_after(status(MissionState.FAILED, "no nearer for 140 s")),
        Sort.NO_WAY: cause_after(waits, status(MissionState.DRIVING, "waits: door D is shut")),
        Sort.CHARGING: cause_after(replace(WELL, charging=True)),
        Sort.MOTORS: cause_after(replace(WELL, motors=False)),
    }
    assert all(cause is not None and cause.sort is sort for sort, cause in causes.items())
    assert causes[Sort.UNSURE].answer is Answer.UNKNOWN  # type: ignore[union-attr]
    assert "140 s" in causes[Sort.FAILED].what  # type: ignore[union-attr]
    assert "door D is shut" in causes[Sort.NO_WAY].what  # type: ignore[union-attr]


def test_a_stop_by_the_monitor_comes_with_the_missing_agents() -> None:
    stop = Stop(1, stopped=True, by="monitor: no sonar for 20 s")
    view = View()
    view.update("robot/state", replace(WELL, stop=stop), 0.0)
    view.update("monitor/m-1", MonitorReport("m-1", 90, True, ("sonar",)), 0.0)
    found = standing(view, 0.1)
    assert "sonar" in found.sentences[1]
    assert stop.by in found.sentences[2]


def test_which_agents_compete_is_not_known_before_all_have_been_received() -> None:
    """Until then none is called missing."""
    society = Observed().drive()
    view = View()
    view.begin(society.mesh.now)
    state = society.view.state
    assert state is not None
    view.update(service_of(RobotState).key, replace(state, v=0.0, w=0.0), society.mesh.now)
    for way in (society.view.trajectory, society.view.mission):
        assert way is not None
        view.update(service_of(type(way)).key, way, society.mesh.now)
    cause = standing(view, society.mesh.now + 0.1, Demand()).cause
    assert cause is not None
    assert (cause.sort, cause.answer) == (Sort.STARTING, Answer.UNKNOWN)


def test_an_agent_that_has_just_started_has_not_failed_yet() -> None:
    known = Observed().view
    robot = next(each for each in known.agents if each.name == "robot")
    assert robot.card is not None
    view = View()
    sorts = []
    for at in (0.0, 0.5, 5.0):
        view.token(robot.instance, there=True, t=at)
        view.learn(robot.card, at)
        cause = standing(view, at + 0.1).cause
        assert cause is not None
        sorts.append(cause.sort)
    assert sorts == [Sort.STARTING, Sort.STARTING, Sort.DEVICE]


def test_a_fault_on_the_robot_agents_card_is_quoted() -> None:
    known = Observed().view
    robot = next(each for each in known.agents if each.name == "robot")
    assert robot.card is not None
    view = View()
    view.token(robot.instance, there=True, t=0.0)
    view.learn(replace(robot.card, fault="Rob is a p3dx, and not a p2dx"), 100.0)
    found = standing(view, 100.1)
    assert found.cause is not None
    assert found.cause.sort is Sort.DEVICE
    assert "not a p2dx" in found.cause.what


def test_an_input_that_has_just_returned_is_not_reported_as_missing() -> None:
    """Bids are queried once per second: a missing input may have arrived since."""
    society = Observed().drive()
    society.mesh.node("sonar").kill()
    society.let_pass(3.3)
    society.run.enter("sonar")
    found = []
    while society.standing.stands and len(found) < 60:
        found.append(society.standing.cause)
        society.let_pass(0.05)
    sorts = {cause.sort for cause in found if cause is not None}
    assert len(found) < 60
    assert sorts == {Sort.ABSENT, Sort.STARTING}


def test_a_new_observer_says_nothing_of_what_was_published_before_it_began() -> None:
    society = Observed().drive()
    cut(("device",), ("robot",))(society)
    society.let_pass(3.0)
    society.chronicle = Chronicle()
    found = society.let_pass(5.0).standing
    (said,) = (each for each in found.sentences if "robot provides robot/state" in each)
    assert said.endswith("none was received for 4.9 s, since this observation began.")
    assert found.cause is not None
    assert found.cause.sort is Sort.DEVICE
