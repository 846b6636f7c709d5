"""Each injected fault leads to its own cause, in sort and subject.

The faults are injected into whole societies on the virtual mesh, and the queries are those of
`armadico why`. Texts of agents are reworded on the way: no explanation may depend on a wording.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import replace as alike
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.config.scenarios import Scenario, ideal, load_scenario
from armadico.core.exchange import Bid
from armadico.core.messages import PROTOCOL, Ack, Cycle, RobotState, Stop
from armadico.core.resources import WHEELS, Resource, declare
from armadico.mesh.link_faults import WHOLE
from armadico.mobile.obstacles import Obstacles
from armadico.observe.findings import Finding, Sort
from armadico.watch.why import Chronicle
from tests.robot.launch.test_blocked import ONE_DOOR, door
from tests.watch.broken import hang, kill
from tests.watch.observed import LINE, Observed


def standing(society: Observed) -> Finding | None:
    """Why it stands, as soon as it does."""
    while not society.standing.stands and society.mesh.now < 60.0:
        society.let_pass(1.0)
    return society.standing.cause


def exchange(society: Observed) -> Finding | None:
    """The cause of the first exchange of the wheels after the fault."""
    society.chronicle.finish()
    found = [each for each in society.chronicle.exchanges if each.resource == "wheels"]
    return next((each.cause for each in found if each.t > society.planted), None)


def collision(society: Observed) -> Finding | None:
    """The cause of the first collision, as soon as there is one."""
    while not society.chronicle.collisions and society.mesh.now < 60.0:
        society.let_pass(1.0)
    return society.chronicle.collisions[0].cause if society.chronicle.collisions else None


@dataclass(frozen=True)
class Incident:
    """An injected fault, the query, and the expected cause."""

    plant: Callable[[Observed], object]
    sort: Sort
    subject: str
    query: Callable[[Observed], Finding | None] = standing
    seconds: float = 3.0
    begin: Callable[[Path], Observed] = lambda _: Observed().drive()


def lost_between(source: str, *targets: str) -> Callable[[Observed], object]:
    """The router forwards nothing to the targets; there is no direct link to cut."""

    def plant(society: Observed) -> None:
        for target in targets:
            society.mesh.link(source, target).up = False

    return plant


def late_to_the_encoder(society: Observed) -> None:
    nodes = society.mesh.node("robot"), society.mesh.node("encoder")
    society.mesh.link(*(node.address for node in nodes)).faults = alike(WHOLE, delay=0.6)


def bids(v: float) -> Callable[[Observed], object]:
    def plant(society: Observed) -> None:
        society.agent("goto").propose = lambda *_: Bid(0.9, (v, 0.0))

    return plant


def foreign(society: Observed) -> None:
    """Goto restarts with another protocol."""
    society.mesh.node("goto").kill()
    goto = society.run.enter("goto").agent
    card = goto.kernel.card
    goto.kernel.card = lambda: replace(card(), protocol=PROTOCOL + 1)  # type: ignore[method-assign]


def blind(society: Observed) -> None:
    """The sonar agent reports that nothing is near, whatever it receives."""
    sonar, robot = society.agent("sonar"), society.agent("robot")
    robot.p = replace(robot.p, reflex=False)
    publish = sonar.publish

    def nothing(message: object, **names: str) -> None:
        if isinstance(message, Obstacles):
            message = Obstacles(message.cycle, None, None, None, None)
        publish(message, **names)

    sonar.publish = nothing


def heedless(society: Observed) -> None:
    """Goto ignores obstacles, and its bid is critical."""
    goto, robot = society.agent("goto"), society.agent("robot")
    robot.p = replace(robot.p, reflex=False)
    goto.propose = lambda *_: Bid(1.0, (0.7, 0.0), critical=True)


def shipped(name: str, seconds: float, *agents: str) -> Callable[[Path], Observed]:
    return lambda _: Observed(scenario=scenario(name, *agents)).drive(seconds)


def driven_by(name: str, scene: str) -> Callable[[Path], Observed]:
    """Run until the agent has held the wheels for a second."""

    def begin(_: Path) -> Observed:
        society = Observed(scenario=scenario(scene)).drive(1.0)
        held = 0
        while held < 10 and society.mesh.now < 60.0:
            society.let_pass(0.1)
            held = held + 1 if society.agent(name).holds(WHEELS) else 0
        assert held == 10, f"{name} never drove"
        return society

    return begin


def scenario(name: str, *agents: str) -> Scenario:
    """A shipped scenario with ideal sensors, and with these agents, if any are named."""
    found = ideal(load_scenario(name))
    return replace(found, agents=agents) if agents else found


def behind_a_door(folder: Path) -> Observed:
    """The only door to the goal closes."""
    (folder / "doors.map").write_text(ONE_DOOR + "\n")
    path = folder / "doors.toml"
    path.write_text(
        'world = "doors.map"\nstart = [1.5, 3.0, 0.0]\ngoal = [7.5, 3.0, 0.0]\n'
        f'plan = "rooms"\n{door(2.0)}'
    )
    return Observed(scenario=ideal(load_scenario(path))).drive(1.0)


def nothing(_: Observed) -> None:
    """No fault is injected."""


INCIDENTS: dict[str, Incident] = {
    "hung sonar": Incident(hang("sonar"), Sort.SILENT, "sonar"),
    "stale pose": Incident(late_to_the_encoder, Sort.STALE, "encoder"),
    "commands beyond the limits": Incident(bids(50.0), Sort.REFUSED, "goto"),
    "another protocol": Incident(foreign, Sort.FOREIGN, "goto", seconds=6.0),
    "lost on the way to the behaviours": Incident(
        lost_between("encoder", "goto", "avoid"), Sort.LINK, "encoder -> avoid"
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


def found(name: str, folder: Path) -> Finding | None:
    incident = INCIDENTS[name]
    society = incident.begin(folder)
    society.planted = society.mesh.now
    society.worded = False
    incident.plant(society)
    society.let_pass(incident.seconds)
    return incident.query(society)


@pytest.mark.long(but=("hung sonar",))
@pytest.mark.parametrize("name", INCIDENTS)
def test_the_planted_cause_is_named(name: str, tmp_path: Path) -> None:
    incident, cause = INCIDENTS[name], found(name, tmp_path)
    assert cause is not None
    assert (cause.sort, cause.who) == (incident.sort, incident.subject)


def test_an_agent_that_drives_at_an_obstacle_which_the_reflex_stops_is_blocked() -> None:
    society = shipped("sc2", 1.0)(Path())
    society.agent("goto").propose = lambda *_: Bid(1.0, (0.7, 0.0), critical=True)
    cause = standing(society)
    while cause is not None and cause.sort is Sort.STARTING:
        cause = standing(society.let_pass(0.3))
    assert cause is not None
    assert (cause.sort, cause.who) == (Sort.BLOCKED, "goto")


def test_an_agent_that_declares_the_wheels_differently_is_foreign() -> None:
    society = Observed().drive()
    society.worded = False
    society.mesh.node("goto").kill()
    goto = society.run.enter("goto").agent
    card = goto.kernel.card
    goto.kernel.card = lambda: replace(card(), declares=("wheels(left, right)",))  # type: ignore[method-assign]
    society.let_pass(6.0)
    cause = standing(society)
    assert cause is not None
    assert (cause.sort, cause.who) == (Sort.FOREIGN, "goto")
    assert "wheels(left, right)" in cause.what


def test_a_moment_has_the_refused_commands_and_the_reason() -> None:
    society = Observed().drive()
    bids(50.0)(society)
    society.let_pass(2.0)
    society.chronicle.mark(society.mesh.now)
    society.chronicle.finish()
    (moment,) = society.chronicle.moments
    (wheels,) = [each for each in moment.contests if each.resource == "wheels"]
    assert "50 m/s" in wheels.refused[0]
    assert any(wheels.refused[0] in sentence for sentence in moment.sentences)


@pytest.mark.long
def test_during_an_exchange_a_moment_names_the_agents_whose_actions_are_blended() -> None:
    society = Observed(scenario=scenario("sc4", *LINE.agents, "gothrough")).drive(6.0)
    for _ in range(300):
        society.let_pass(0.1)
        society.chronicle.mark(society.mesh.now)
    society.chronicle.finish()
    blended = [each for each in society.chronicle.exchanges if each.cycles > 1]
    during = [
        each.contests[0]
        for each in society.chronicle.moments
        if any(
            abs(each.t - change.t) < 1.0
            and each.contests[0].loser
            and each.contests[0].holder == change.winner
            for change in blended
        )
    ]
    assert during
    assert all(each.commanded != each.wanted for each in during)


def test_a_stop_before_the_observation_has_no_time_to_rest() -> None:
    chronicle = Chronicle()
    for number in (7, 8):
        state = RobotState(Cycle(1, number), 0, 0, 0, 0, 0, 12, True, False, Stop(1, True, "anna"))
        chronicle.update("robot/state", state, number / 10)
    (press,) = chronicle.presses
    assert (press.by, press.stood) == ("anna", None)


def test_a_stop_that_is_latched_again_before_its_release_names_the_second_sender() -> None:
    society = Observed().drive(1.0)
    for count, by in enumerate(("anna", "bert"), 1):
        society.mesh.publish(Stop(count, True, by, 10 + count))
        society.let_pass(0.5)
    anna, bert = society.chronicle.presses
    assert "bert" in anna.sentences[-1]
    assert f"{bert.t:.2f} s" in anna.sentences[-1]
    assert anna.released is bert.released is None


def test_acks_of_a_resource_with_long_cycles_are_no_pause() -> None:
    """Their exchanges are counted, and one that there was not is not unknown."""
    slow = declare(Resource("slow-of-why", ("a",), (1.0,), (0.0,), period_s=5.0))
    society = Observed().let_pass(0.5)
    chronicle, begun = society.chronicle, society.mesh.now
    ack = Ack(slow.name, Cycle(1, 1))
    for number in range(4):
        chronicle.update(slow.ack_key, ack, begun + 5.0 * number)
    assert not chronicle.uncounted("exchange", slow.name)
    chronicle.update(slow.ack_key, ack, begun + 60.0)
    assert chronicle.uncounted("exchange", slow.name)
