"""Prepared incidents: each is planted by a fault of its own, and its cause is told from all others.

What agents say in sentences is reworded on the way: no explanation may hang on a wording.

The faults are planted in whole societies on the virtual mesh. What is asked is what `armadico why`
asks, and the answer's cause, its sort and who it is, is the one that was planted: no two incidents
have the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import replace as alike
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.bridge.p2os.commands import Cmd, command
from armadico.config.scenarios import Scenario, ideal, load_scenario
from armadico.core.exchange import Bid
from armadico.core.messages import PROTOCOL, Cycle, RobotState, Stop
from armadico.core.resources import WHEELS
from armadico.mesh.link_faults import WHOLE
from armadico.mobile.messages import Correction, MissionRequest, Waypoint
from armadico.mobile.obstacles import Obstacles
from armadico.observe import why
from armadico.observe.standing import Cause, Sort
from armadico.observe.why import Chronicle
from tests.launch.test_blocked import ONE_DOOR, door
from tests.observe.overheard import LINE, Overheard

BASE = ("robot", "encoder", "sonar")
LAB = ("goto", "avoid", "interface", "path-planning")


def two_hosts(name: str) -> str:
    return "base" if name in BASE else "lab"


def standing(heard: Overheard) -> Cause | None:
    """Why it stands, once it does."""
    while not heard.standing.stands and heard.mesh.now < 60.0:
        heard.let_pass(1.0)
    return heard.standing.cause


def exchange(heard: Overheard) -> Cause | None:
    """Why the wheels changed hands first since the fault was planted."""
    heard.chronicle.finish()
    found = [each for each in heard.chronicle.exchanges if each.resource == "wheels"]
    return next((each.cause for each in found if each.t > heard.planted), None)


def collision(heard: Overheard) -> Cause | None:
    """Why it touched something first, once it has."""
    while not heard.chronicle.collisions and heard.mesh.now < 60.0:
        heard.let_pass(1.0)
    return heard.chronicle.collisions[0].cause if heard.chronicle.collisions else None


@dataclass(frozen=True)
class Incident:
    """What is planted, what is asked, and what the answer must be."""

    plant: Callable[[Overheard], object]
    sort: Sort
    who: str
    ask: Callable[[Overheard], Cause | None] = standing
    seconds: float = 3.0
    begin: Callable[[Path], Overheard] = lambda _: Overheard().drive()


def kill(*names: str) -> Callable[[Overheard], object]:
    return lambda heard: [heard.mesh.node(name).kill() for name in names]


def hang(name: str) -> Callable[[Overheard], object]:
    return lambda heard: heard.mesh.node(name).hang()


def cut(sources: tuple[str, ...], targets: tuple[str, ...]) -> Callable[[Overheard], object]:
    return lambda heard: heard.mesh.cut(sources, targets)


def lost_between(source: str, *targets: str) -> Callable[[Overheard], object]:
    """The router between them forwards nothing to those: there is no link that could be cut."""

    def plant(heard: Overheard) -> None:
        for target in targets:
            heard.mesh.link(source, target).up = False

    return plant


def late_to_the_encoder(heard: Overheard) -> None:
    nodes = heard.mesh.node("robot"), heard.mesh.node("encoder")
    heard.mesh.link(*(node.address for node in nodes)).faults = alike(WHOLE, delay=0.6)


def bids(v: float) -> Callable[[Overheard], object]:
    def plant(heard: Overheard) -> None:
        heard.agent("goto").propose = lambda *_: Bid(0.9, (v, 0.0))

    return plant


def foreign(heard: Overheard) -> None:
    """Goto is started again, and speaks otherwise than before."""
    heard.mesh.node("goto").kill()
    goto = heard.run.enter("goto").agent
    said = goto.card
    goto.card = lambda: replace(said(), protocol=PROTOCOL + 1)  # type: ignore[method-assign]


def sees_no_way(heard: Overheard) -> None:
    heard.agent("goto").propose = lambda *_: Bid(0.9, (0.0, 0.0), reason="shut in")


def lost(heard: Overheard) -> None:
    """Whoever localizes has no idea."""

    def say(_a: object, _b: object) -> None:
        state = heard.view.state
        assert state is not None
        wide = (4.0, 0.0, 0.0, 4.0, 0.0, 1.0)
        heard.mesh.publish(Correction(state.cycle, 0, 0, 0, wide, 0.0))
        heard.mesh.call_at(heard.mesh.now + 0.1, say)

    say(None, None)


def motors_off(heard: Overheard) -> None:
    heard.run.robot.receive(command(Cmd.ENABLE, 0), heard.mesh.now)


def blind(heard: Overheard) -> None:
    """The sonar agent says that nothing is near, whatever it hears."""
    sonar, robot = heard.agent("sonar"), heard.agent("robot")
    robot.p = replace(robot.p, reflex=False)
    publish = sonar.publish

    def nothing(message: object, **names: str) -> None:
        if isinstance(message, Obstacles):
            message = Obstacles(message.cycle, None, None, None, None)
        publish(message, **names)

    sonar.publish = nothing


def heedless(heard: Overheard) -> None:
    """Goto drives as if nothing were there, and says that it matters more than anything."""
    goto, robot = heard.agent("goto"), heard.agent("robot")
    robot.p = replace(robot.p, reflex=False)
    goto.propose = lambda *_: Bid(1.0, (0.7, 0.0), critical=True)


def into_the_wall(heard: Overheard) -> None:
    heard.mesh.ask(MissionRequest(Waypoint(0.0, 0.0, 0.0)), lambda _: None)


def shipped(name: str, seconds: float, *agents: str) -> Callable[[Path], Overheard]:
    return lambda _: Overheard(scenario=scenario(name, *agents)).drive(seconds)


def driven_by(name: str, scene: str) -> Callable[[Path], Overheard]:
    """Driven until the agent has held the wheels for a second."""

    def begin(_: Path) -> Overheard:
        heard = Overheard(scenario=scenario(scene)).drive(1.0)
        held = 0
        while held < 10 and heard.mesh.now < 60.0:
            heard.let_pass(0.1)
            held = held + 1 if heard.agent(name).holds(WHEELS) else 0
        assert held == 10, f"{name} never drove"
        return heard

    return begin


def without(name: str) -> Scenario:
    return replace(LINE, agents=tuple(agent for agent in LINE.agents if agent != name))


def scenario(name: str, *agents: str) -> Scenario:
    """A shipped one with ideal sensors, and with these agents, if any are named."""
    found = ideal(load_scenario(name))
    return replace(found, agents=agents) if agents else found


def behind_a_door(folder: Path) -> Overheard:
    """The only door to the goal shuts."""
    (folder / "doors.map").write_text(ONE_DOOR + "\n")
    path = folder / "doors.toml"
    path.write_text(
        'world = "doors.map"\nstart = [1.5, 3.0, 0.0]\ngoal = [7.5, 3.0, 0.0]\n'
        f'plan = "rooms"\n{door(2.0)}'
    )
    return Overheard(scenario=ideal(load_scenario(path))).drive(1.0)


def nothing(_: Overheard) -> None:
    """What happens by itself."""


INCIDENTS: dict[str, Incident] = {
    "dead sonar": Incident(kill("sonar"), Sort.ABSENT, "sonar"),
    "hung sonar": Incident(hang("sonar"), Sort.SILENT, "sonar"),
    "dead encoder": Incident(kill("encoder"), Sort.ABSENT, "encoder"),
    "stale pose": Incident(late_to_the_encoder, Sort.STALE, "encoder"),
    "dead goto": Incident(kill("goto"), Sort.ABSENT, "goto"),
    "hung goto": Incident(hang("goto"), Sort.SILENT, "goto"),
    "hung robot agent": Incident(hang("robot"), Sort.SILENT, "robot"),
    "dead controller": Incident(cut(("device",), ("robot",)), Sort.DEVICE, "robot"),
    "NaN bids": Incident(bids(float("nan")), Sort.UNSOUND, "goto"),
    "commands beyond the limits": Incident(bids(50.0), Sort.REFUSED, "goto"),
    "another protocol": Incident(foreign, Sort.FOREIGN, "goto", seconds=6.0),
    "cut to the robot": Incident(cut(("goto",), ("robot",)), Sort.LINK, "goto -> robot"),
    "lost on the way to the behaviours": Incident(
        lost_between("encoder", "goto", "avoid"), Sort.LINK, "encoder -> avoid"
    ),
    "cut host": Incident(
        lambda heard: [heard.mesh.cut(BASE, LAB), heard.mesh.cut(LAB, BASE)],
        Sort.HOST,
        "base",
        begin=lambda _: Overheard(hosts=two_hosts).drive(),
    ),
    "host switched off": Incident(
        kill(*LAB), Sort.HOST, "lab", begin=lambda _: Overheard(hosts=two_hosts).drive()
    ),
    "stop by a person": Incident(
        lambda heard: heard.mesh.publish(Stop(1, True, "anna", 5)), Sort.STOP, "anna"
    ),
    "motors off": Incident(motors_off, Sort.STOP, "the motors being off at the robot"),
    "lost": Incident(lost, Sort.LOST, ""),
    "no way for who drives": Incident(
        sees_no_way,
        Sort.BLOCKED,
        "goto",
        begin=lambda _: Overheard(scenario=without("avoid")).drive(),
    ),
    "deaf controller": Incident(cut(("robot",), ("device",)), Sort.STALLED, "robot", seconds=6.0),
    "goal in a wall": Incident(
        into_the_wall,
        Sort.REFUSED_GOAL,
        "",
        begin=lambda _: Overheard(scenario=load_scenario("rooms-a")),
    ),
    "shut door": Incident(nothing, Sort.NO_WAY, "", seconds=25.0, begin=behind_a_door),
    "outbid": Incident(
        nothing, Sort.OUTBID, "avoid", exchange, 9.0, shipped("sc3", 0.1, *LINE.agents)
    ),
    "killed as it drives": Incident(
        kill("gothrough"), Sort.ABSENT, "gothrough", exchange, 3.0, driven_by("gothrough", "sc4")
    ),
    "blind sonar": Incident(blind, Sort.UNSEEN, "sonar", collision, 1.0, shipped("sc2", 1.0)),
    "heedless goto": Incident(heedless, Sort.DRIVEN, "goto", collision, 1.0, shipped("sc2", 1.0)),
}


def found(name: str, folder: Path) -> Cause | None:
    incident = INCIDENTS[name]
    heard = incident.begin(folder)
    heard.planted = heard.mesh.now
    heard.worded = False
    incident.plant(heard)
    heard.let_pass(incident.seconds)
    return incident.ask(heard)


@pytest.mark.parametrize("name", INCIDENTS)
def test_the_planted_cause_is_named(name: str, tmp_path: Path) -> None:
    incident, cause = INCIDENTS[name], found(name, tmp_path)
    assert cause is not None
    assert (cause.sort, cause.who) == (incident.sort, incident.who)


def test_no_two_incidents_have_the_same_cause() -> None:
    causes = {(each.sort, each.who) for each in INCIDENTS.values()}
    assert len(causes) == len(INCIDENTS) >= 20


def test_who_drives_at_what_the_robot_heeds_by_itself_is_blocked() -> None:
    heard = shipped("sc2", 1.0)(Path())
    heard.agent("goto").propose = lambda *_: Bid(1.0, (0.7, 0.0), critical=True)
    cause = standing(heard)
    while cause is not None and cause.sort is Sort.STARTING:
        cause = standing(heard.let_pass(0.3))
    assert cause is not None
    assert (cause.sort, cause.who) == (Sort.BLOCKED, "goto")
    assert "slowed for what is ahead" in cause.what


def test_an_agent_that_means_something_else_by_the_wheels_is_foreign() -> None:
    heard = Overheard().drive()
    heard.worded = False
    heard.mesh.node("goto").kill()
    goto = heard.run.enter("goto").agent
    said = goto.card
    goto.card = lambda: replace(said(), declares=("wheels(left, right)",))  # type: ignore[method-assign]
    heard.let_pass(6.0)
    cause = standing(heard)
    assert cause is not None
    assert (cause.sort, cause.who) == (Sort.FOREIGN, "goto")
    assert "wheels(left, right)" in cause.what


def test_a_moment_tells_what_the_owner_refuses_and_why() -> None:
    heard = Overheard().drive()
    bids(50.0)(heard)
    heard.let_pass(2.0)
    heard.chronicle.mark(heard.mesh.now)
    heard.chronicle.finish()
    (moment,) = heard.chronicle.moments
    (wheels,) = [each for each in moment.contests if each.resource == "wheels"]
    assert "50 m/s, 0 rad/s is beyond" in wheels.refused[0]
    assert any(said.startswith("By its owner, commands refused: ") for said in moment.sentences)


def test_while_an_exchange_goes_on_a_moment_tells_whose_actions_are_blended() -> None:
    heard = Overheard(scenario=scenario("sc4", *LINE.agents, "gothrough")).drive(6.0)
    for _ in range(100):
        heard.let_pass(0.1)
        heard.chronicle.mark(heard.mesh.now)
    heard.chronicle.finish()
    first = next(each for each in heard.chronicle.exchanges if each.t > 7.0 and each.cycles > 1)
    during = [
        each.contests[0]
        for each in heard.chronicle.moments
        if each.contests[0].loser and each.contests[0].holder == first.winner
    ]
    assert during
    assert all(each.loser == first.loser for each in during)
    assert all(each.commanded != each.wanted for each in during)


def test_what_is_kept_does_not_grow_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page shows things to one for days; what is left keeps its number."""
    monkeypatch.setattr(why, "MOST", 2)
    chronicle = Chronicle()
    for number in range(1, 6):
        press = Stop(2 * number - 1, True, f"hand {number}", number)
        chronicle.update("robot/stop", press, float(number))
        chronicle.update("robot/stop", Stop(2 * number, False, "", number), number + 0.5)
        chronicle.mark(number + 0.6)
    chronicle.finish()
    assert [(each.number, each.by) for each in chronicle.presses] == [(4, "hand 4"), (5, "hand 5")]
    assert len(chronicle.moments) == 2


def test_a_stop_that_was_there_before_anybody_listened_is_told_as_that() -> None:
    chronicle = Chronicle()
    for number in (7, 8):
        state = RobotState(Cycle(1, number), 0, 0, 0, 0, 0, 12, True, False, Stop(1, True, "anna"))
        chronicle.update("robot/state", state, number / 10)
    (press,) = chronicle.presses
    assert press.stood is None
    assert press.sentences[:2] == (
        "Before it was listened anna latched the stop.",
        "How soon the robot stood then nobody heard.",
    )


def test_a_stop_that_was_latched_anew_before_its_release_says_by_whom() -> None:
    heard = Overheard().drive(1.0)
    for count, by in enumerate(("anna", "bert"), 1):
        heard.mesh.publish(Stop(count, True, by, 10 + count))
        heard.let_pass(0.5)
    anna, bert = heard.chronicle.presses
    assert anna.sentences[-1] == f"Before it was released bert latched another at {bert.t:.2f} s."
    assert bert.sentences[-1] == "Nobody has released it."
