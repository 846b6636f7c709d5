"""Why the robot stands: planted faults on the virtual mesh, each with its own cause."""

from __future__ import annotations

from msgspec.structs import replace

from armadico.config.discovery import providers
from armadico.config.scenarios import load_scenario
from armadico.core.messages import Cycle, Message, MonitorReport, RobotState, Stop
from armadico.core.services import service_of
from armadico.mobile.messages import (
    MissionRequest,
    MissionState,
    MissionStatus,
    Trajectory,
    Waypoint,
)
from armadico.observe.standing import Cause, Sort, standing
from armadico.observe.view import View
from armadico.observe.why import Chronicle
from tests.observe.overheard import Overheard


def test_a_robot_that_moves_has_no_cause_and_one_without_a_goal_says_so() -> None:
    heard = Overheard()
    idle = heard.standing
    assert idle.stands
    assert idle.cause is not None
    assert idle.cause.sort is Sort.NO_GOAL
    moving = heard.drive().standing
    assert not moving.stands
    assert moving.cause is None
    assert "goto drives" in moving.sentences[0]


def test_the_chain_ends_at_the_agent_that_is_not_alive() -> None:
    heard = Overheard().drive()
    heard.mesh.node("sonar").kill()
    found = heard.let_pass(3.0).standing
    assert found.cause is not None
    assert (found.cause.sort, found.cause.who) == (Sort.ABSENT, "sonar")
    assert "goto: no bid (no fresh sonar/obstacles)." in found.sentences


def test_while_the_robots_router_cannot_be_reached_that_is_the_cause() -> None:
    heard = Overheard().drive()
    heard.view.router(there=False, t=heard.mesh.now)
    found = standing(heard.view, heard.mesh.now + 4.0)
    assert found.cause is not None
    assert (found.cause.sort, found.cause.who) == (Sort.UNREACHABLE, "robot")
    assert "for 4.0 s" in found.cause.what
    heard.view.router(there=True, t=heard.mesh.now + 4.0)
    assert heard.standing.cause is None


def test_who_listens_since_lately_is_told_who_would_provide_what_is_lacking() -> None:
    """Whoever was gone before has left no card; the agents that are installed are known."""
    heard = Overheard().drive()
    heard.mesh.node("sonar").kill()
    heard.let_pass(3.0)
    heard.chronicle = Chronicle()
    heard.let_pass(2.0)
    unknown = heard.standing.cause
    known = standing(heard.view, heard.mesh.now, providers).cause
    assert unknown is not None
    assert known is not None
    assert (unknown.sort, unknown.who) == (Sort.ABSENT, "sonar/obstacles")
    assert (known.sort, known.who) == (Sort.ABSENT, "sonar")


def test_a_host_of_the_table_that_is_away_is_named_with_how_its_share_is_started() -> None:
    heard = Overheard().drive()
    heard.mesh.node("sonar").kill()
    heard.let_pass(3.0)
    heard.chronicle = Chronicle()
    heard.let_pass(2.0)
    here = [name for name in heard.view.names if name != "sonar"]
    table = {"lab1": here, "lab2": ("sonar",)}
    found = standing(heard.view, heard.mesh.now, providers, table)
    assert found.cause is not None
    assert (found.cause.sort, found.cause.who) == (Sort.HOST, "lab2")
    assert found.sentences[-1] == "lab2 is to run sonar, and no agent of lab2 is alive."
    assert "`armadico up --host lab2`" in found.cause.todo


def test_where_no_agent_is_left_the_hosts_of_the_table_are_named() -> None:
    view = View()
    view.token("goto-1", there=True, t=0.0)
    view.token("goto-1", there=False, t=1.0)
    cause = standing(view, 2.0, providers, {"lab1": ("goto",), "lab2": ("sonar",)}).cause
    assert cause is not None
    assert "--host lab1" in cause.todo
    assert "--host lab2" in cause.todo
    assert standing(view, 2.0, providers).cause == replace(
        cause, todo="`armadico up` starts a whole society"
    )


def test_what_several_have_in_common_is_said_once_and_the_cause_comes_last() -> None:
    heard = Overheard().drive()
    heard.mesh.node("sonar").hang()
    found = heard.let_pass(3.0).standing
    assert found.cause is not None
    assert found.sentences[-1] == found.cause.what
    assert len(set(found.sentences)) == len(found.sentences)


def test_an_agent_that_is_installed_is_found_by_what_it_publishes() -> None:
    assert providers("encoder/pose") == ("encoder",)
    assert providers("sonar/obstacles") == ("sonar",)
    assert providers("resource/wheels/ack") == ("robot",)
    assert providers("no/such/key") == ()


def test_a_society_that_has_ended_or_that_is_not_heard_is_blamed_on_nobody() -> None:
    heard = Overheard().drive()
    gap = standing(heard.view, heard.mesh.now + 10.0).cause
    assert gap is not None
    assert (gap.sort, gap.who) == (Sort.UNKNOWN, "")
    assert "for 10.0 s" in gap.what
    for node in heard.mesh.nodes:
        node.leave()
    ended = heard.let_pass(3.0).standing
    assert ended.sentences == ("No agent is alive any more.",)


WELL = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, motors=True, stalled=False)


def told(*said: Message, t: float = 0.0) -> Cause | None:
    """Of a robot that has said this, and stands."""
    view = View()
    for message in (WELL, *said):
        view.update(service_of(type(message)).key, message, t)
    return standing(view, t + 0.1).cause


def test_a_goal_that_was_refused_is_told_to_who_comes_late_too() -> None:
    """By the mission's note; whoever was there has heard it logged."""
    heard = Overheard(scenario=load_scenario("rooms-a"))
    heard.mesh.ask(MissionRequest(Waypoint(0.0, 0.0, 0.0)), lambda _: None)
    heard.let_pass(1.0)
    before = heard.standing.cause
    heard.chronicle = Chronicle()
    after = heard.let_pass(2.0).standing.cause
    assert before == after
    assert before is not None
    assert before.sort is Sort.REFUSED_GOAL
    assert "inside a wall" in before.what


def test_what_a_mission_says_of_itself() -> None:
    def status(state: MissionState, note: str = "") -> MissionStatus:
        return MissionStatus(1, state, 2.0, 0, note)

    waits = Trajectory(1, 1, (Waypoint(1, 1, 0),), waits=True)
    causes = {
        Sort.NO_GOAL: told(status(MissionState.NONE)),
        Sort.REACHED: told(status(MissionState.REACHED)),
        Sort.PLANNING: told(status(MissionState.PLANNING)),
        Sort.FAILED: told(status(MissionState.FAILED, "no nearer for 140 s")),
        Sort.NO_WAY: told(waits, status(MissionState.DRIVING, "waits: door D is shut")),
        Sort.CHARGING: told(replace(WELL, charging=True)),
        Sort.MOTORS: told(replace(WELL, motors=False)),
    }
    assert all(cause is not None and cause.sort is sort for sort, cause in causes.items())
    assert "140 s" in causes[Sort.FAILED].what  # type: ignore[union-attr]
    assert "door D is shut" in causes[Sort.NO_WAY].what  # type: ignore[union-attr]


def test_what_the_monitor_misses_is_told_with_its_stop() -> None:
    stop = Stop(1, stopped=True, by="monitor: no sonar for 20 s")
    view = View()
    view.update("robot/state", replace(WELL, stop=stop), 0.0)
    view.update("monitor/m-1", MonitorReport("m-1", 90, True, ("sonar",)), 0.0)
    found = standing(view, 0.1)
    assert found.sentences[1:] == (
        "The society lacks sonar.",
        "It is stopped by monitor: no sonar for 20 s.",
    )


def test_who_has_just_come_has_not_failed_yet() -> None:
    known = Overheard().view
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


def test_a_robot_agent_that_reports_a_fault_is_quoted_long_after_it_logged_it() -> None:
    known = Overheard().view
    robot = next(each for each in known.agents if each.name == "robot")
    assert robot.card is not None
    view = View()
    view.token(robot.instance, there=True, t=0.0)
    view.learn(replace(robot.card, fault="Rob is a p3dx, and not a p2dx"), 100.0)
    found = standing(view, 100.1)
    assert found.cause is not None
    assert found.cause.sort is Sort.DEVICE
    assert "not a p2dx" in found.cause.what


def test_what_has_just_come_again_is_not_said_not_to_arrive() -> None:
    """Bids are asked for once a second: what they lacked then may be there by now."""
    heard = Overheard().drive()
    heard.mesh.node("sonar").kill()
    heard.let_pass(3.3)
    heard.run.enter("sonar")
    found = []
    while heard.standing.stands and len(found) < 60:
        found.append(heard.standing.cause)
        heard.let_pass(0.05)
    sorts = {cause.sort for cause in found if cause is not None}
    assert len(found) < 60
    assert sorts == {Sort.ABSENT, Sort.STARTING}
