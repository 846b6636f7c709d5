"""Whole societies on the virtual mesh: the thesis's scenarios, faults, and runs that repeat."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from math import pi
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.bridge.p2os.commands import Cmd, Command, decode_command
from armadico.bridge.p2os.packets import Decoder
from armadico.bridge.p2os.session import ZERO
from armadico.bridge.reflex import HELD_S
from armadico.bridge.simulator.walls import DEAD
from armadico.config import worlds
from armadico.config.loading import load_parameters
from armadico.config.scenarios import Scenario, ideal, load_scenario
from armadico.config.shipped import resource_path
from armadico.core.agent import Agent
from armadico.core.discovery import AGENTS, load
from armadico.core.messages import Ack, Description, Log, Message, RobotState, Stop, encode
from armadico.core.resources import WHEELS
from armadico.core.services import service_of, services
from armadico.launch.attached import AttachedRun
from armadico.launch.client import Client
from armadico.launch.society import Options, members
from armadico.launch.virtual import Rehearsal
from armadico.launch.virtual_session import VirtualSession
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Trajectory, Truth
from armadico.observe.measures import RunWatch
from armadico.observe.view import driver
from armadico.runtime.errors import RunFailedError
from tests.programs import call
from tests.robot.society import ballots_never_go_down

SCENARIOS = ("sc1", "sc2", "sc3", "sc4", "rooms-a", "rooms-b", "house", "offices", "floor")
EVERYBODY = ("encoder", "sonar", "goto", "avoid", "gothrough", "path-planning", "interface")
DRIVING = ("encoder", "sonar", "goto")
"""Whom a run on an empty floor cannot do without."""

STOP_S = 0.4
"""From the last command to the stop that the robot agent orders: 300 ms, and the way there."""

WATCHDOG_S = 2.0
BRAKING_S = 3.0
"""From top speed to rest with the motors on, by the profile, and room to spare."""

LINE = ideal(Scenario(name="line", world="sc1", start=(-1.5, 0.0, 0.0), goal=(6.5, 0.0, 0.0)))


@pytest.mark.long(but=("sc4",))
@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_reaches_its_goal_as_it_is_shipped(name: str) -> None:
    """With the sensors that its file names. On this seed sc1 and sc2 missed it with real ones."""
    result = Rehearsal(load_scenario(name), Options(seed=9101)).run()
    again = f"armadico run {name} --virtual --seed 9101"
    assert result.reached, again
    assert result.collisions == 0, again


@pytest.mark.long(but=("sc3",))
@pytest.mark.parametrize("name", ["sc3", "house"])
def test_another_robot_reaches_its_goal_too_and_touches_nothing(name: str) -> None:
    """Of another size, with sonars elsewhere and other limits: its owner describes it."""
    result = Rehearsal(replace(ideal(load_scenario(name)), robot="amigobot"), Options()).run()
    again = f"armadico run {name} --virtual --sensors ideal --profile amigobot"
    assert result.reached, again
    assert result.collisions == 0, again


def test_a_run_ends_at_its_time_limit_whatever_is_rounded_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is left of 0.2 s after a step of 0.2 s is too little to move the clock."""
    waits: list[float] = []
    wait = Rehearsal.wait

    def counted(run: Rehearsal, seconds: float) -> None:
        waits.append(seconds)
        assert len(waits) < 10, f"it would wait for ever: {waits}"
        wait(run, seconds)

    monkeypatch.setattr(Rehearsal, "wait", counted)
    for limit in (0.001, 0.2, 0.3):
        waits.clear()
        assert Rehearsal(LINE, Options(limit=limit)).run().limit_s == limit


@pytest.mark.long
def test_who_watches_and_stops_a_live_society_can_watch_and_stop_a_virtual_one() -> None:
    """The code of `armadico run --attach` and `armadico stop`, word for word, on the other mesh."""
    rehearsal = Rehearsal(LINE, Options())
    session = VirtualSession(rehearsal.mesh)
    with AttachedRun(LINE, Options(), session) as run:
        result = run.run()
    assert result.reached
    assert result.collisions == 0
    client = Client(session)
    client.stop(10.0, by="tester")
    state = client.latest(RobotState)
    assert state is not None
    assert state.stop.by == "tester"
    client.resume(10.0, by="tester")


def test_a_robot_that_is_sent_elsewhere_drives_on_when_an_attached_run_ends() -> None:
    rehearsal = Rehearsal(replace(LINE, goal=None), Options())
    other = Client(VirtualSession(rehearsal.mesh))
    sent: list[int] = []

    def send(watch: RunWatch) -> None:
        if not sent and watch.elapsed > 3.0:
            sent.append(other.goto(6.5, 1.0, direct=True).number)

    with AttachedRun(LINE, Options(), VirtualSession(rehearsal.mesh)) as run:
        result = run.run(send)
    assert sent
    assert not result.reached
    assert result.limit_s is None, "it ends at once, not at its time limit"
    assert "another mission" in result.why
    status, state = other.latest(MissionStatus, 1.0), other.latest(RobotState, 1.0)
    assert status is not None
    assert (status.mission, status.state) == (sent[0], MissionState.DRIVING)
    assert state is not None
    assert not state.stop.stopped


@pytest.mark.parametrize("rooms", [ideal(load_scenario("rooms-a")), load_scenario("rooms-a")])
def test_a_run_of_another_world_than_the_societys_is_refused(rooms: Scenario) -> None:
    """Also where it has agents that this society has not, and that would be waited for."""
    rehearsal = Rehearsal(replace(ideal(load_scenario("house")), goal=None), Options())
    with (
        pytest.raises(RunFailedError, match="world 'house'"),
        AttachedRun(rooms, Options(), VirtualSession(rehearsal.mesh)) as run,
    ):
        run.run()


def test_a_run_on_another_map_of_the_same_name_is_refused() -> None:
    """As after one of two computers got a newer map."""
    rooms = ideal(load_scenario("rooms-a"))
    rehearsal = Rehearsal(replace(rooms, goal=None), Options())
    for name, found in (
        ("sonar", worlds.digest(worlds.load_world(rooms.world))),
        ("path-planning", "89abcdef"),
    ):
        identity = rehearsal.mesh.node(name).agent.identity
        object.__setattr__(identity, "map", found)
    with (
        pytest.raises(RunFailedError, match="path-planning of the society has another map"),
        AttachedRun(rooms, Options(), VirtualSession(rehearsal.mesh)) as run,
    ):
        run.run()


def test_a_run_whose_robot_has_another_controller_now_ends_with_the_reason() -> None:
    rehearsal = Rehearsal(replace(LINE, goal=None), Options())
    there = VirtualSession(rehearsal.mesh)

    def exchange(watch: RunWatch) -> None:
        about = watch.view.description
        assert about is not None
        there.publish(service_of(Description).key, replace(about, controller="another"))

    with (
        pytest.raises(RunFailedError, match=r"controller is another now, .* of two robots"),
        AttachedRun(LINE, Options(), VirtualSession(rehearsal.mesh)) as run,
    ):
        run.run(exchange)


def test_a_goal_without_a_heading_is_looked_at_from_where_the_robot_is() -> None:
    rehearsal = Rehearsal(replace(LINE, goal=None), Options())
    client = Client(VirtualSession(rehearsal.mesh))
    rehearsal.start()
    client.goto(1.5, 3.0, direct=True)
    trajectory = client.latest(Trajectory, timeout=2.0)
    assert trajectory is not None
    assert trajectory.waypoints[-1].theta == pytest.approx(pi / 4, abs=0.01)


def test_a_robot_that_is_sent_where_it_stands_is_there() -> None:
    """The line to the goal is that of an error of the pose: it is no heading to turn to."""
    rehearsal = Rehearsal(replace(LINE, goal=None), Options())
    client = Client(VirtualSession(rehearsal.mesh))
    rehearsal.start()
    pose = client.latest(Pose, timeout=2.0)
    assert pose is not None
    assert client.goto(pose.x - 0.02, pose.y - 0.02, direct=True).wait(1.0)


@pytest.mark.long(but=("sc3-pioneer-2dx-0.15",))
@pytest.mark.parametrize(
    ("name", "robot", "cycle_s"),
    [("sc4", "amigobot", 0.05), ("sc3", "pioneer-2dx", 0.15)],
)
def test_a_robot_of_another_cycle_reaches_its_goal_too_and_touches_nothing(
    name: str, robot: str, cycle_s: float, tmp_path: Path
) -> None:
    """Nothing but the profile says how long a cycle is."""
    text = resource_path("robots", robot).read_text()
    assert "cycle_s = 0.1\n" in text
    profile = tmp_path / "other.toml"
    profile.write_text(text.replace("cycle_s = 0.1\n", f"cycle_s = {cycle_s}\n"))
    rehearsal = Rehearsal(replace(ideal(load_scenario(name)), robot=str(profile)), Options())
    states: list[float] = []
    rehearsal.mesh.watch(lambda _key, _state, now: states.append(now), RobotState)
    result = rehearsal.run()
    assert result.reached
    assert result.collisions == 0
    assert (states[-1] - states[0]) / (len(states) - 1) == pytest.approx(cycle_s, rel=0.05)
    clocks = {node.name: node.agent.cycles for node in rehearsal.mesh.nodes}
    periods = {name: clock.period for name, clock in clocks.items() if clock.newest is not None}
    assert set(periods) == {"robot", *EVERYBODY}
    assert set(periods.values()) == {cycle_s}, periods


# Repeatable ---------------------------------------------------------------------------------------


def digest(name: str, seed: int) -> str:
    """Of every publication of a run: key, bytes and time, in order."""
    rehearsal = Rehearsal(ideal(load_scenario(name)), Options(seed=seed))
    digest = hashlib.sha256()

    def take(key: str, message: Message, now: float) -> None:
        digest.update(f"{key} {now!r} ".encode() + encode(message))

    rehearsal.mesh.watch(take, *{service.message for service in services()})
    rehearsal.run()
    return digest.hexdigest()


def test_the_same_seed_is_the_same_run_byte_for_byte_in_any_process() -> None:
    script = f"from {__name__} import digest; print(digest('sc3', 3))"
    hash_seed = "1" if os.environ.get("PYTHONHASHSEED") != "1" else "2"  # another than here
    env = os.environ | {"PYTHONHASHSEED": hash_seed}
    other = call("-c", script, program=sys.executable, env=env)
    assert other.stdout.strip() == digest("sc3", 3), other.stderr


# Faults -------------------------------------------------------------------------------------------


class Faulty:
    """A run in which something goes wrong, and what was said meanwhile."""

    def __init__(self, options: Options | None = None, scenario: Scenario = LINE) -> None:
        self.options = options or Options()
        self.rehearsal = Rehearsal(scenario, self.options)
        self.mesh = self.rehearsal.mesh
        self.acks: list[Ack] = []
        self.truths: list[Truth] = []
        self.commands: list[tuple[float, Command]] = []
        self.mesh.watch(self._keep, Ack, Truth)
        self._tap()

    def drive(self, condition: Callable[[], bool] | None = None) -> None:
        """Begin, and go on until the robot is on its way."""
        self.rehearsal.start()
        self.rehearsal.begin()
        self.mesh.run(60.0, condition or (lambda: self.truths[-1].v > 0.4))
        assert self.truths[-1].v > 0.1, "it is on its way"

    def pass_s(self, seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds)

    def finish(self) -> None:
        """To the goal, within the limit."""
        end = self.mesh.now + self.rehearsal.limit
        self.mesh.run(end, lambda: self.rehearsal.watch.done)
        result = self.rehearsal.watch.result()
        assert result.reached
        assert result.collisions == 0

    def restart(self, name: str) -> None:
        """A new instance, as the first was."""
        (member,) = (m for m in members(LINE, self.options, "memory:") if m.name == name)
        kind = load(AGENTS, name, Agent)
        self.rehearsal.add(kind, load_parameters(kind.parameters, None, list(member.sets)), 1)

    def at_rest(self) -> bool:
        return abs(self.truths[-1].v) < 0.01 and abs(self.truths[-1].w) < 0.01

    def orders_to_move_after(self, when: float) -> list[float]:
        return [at for at, command in self.commands if at > when and _moves(command)]

    def _keep(self, _key: str, message: Message, _now: float) -> None:
        if isinstance(message, Ack) and message.resource == WHEELS.name:
            self.acks.append(message)
        elif isinstance(message, Truth):
            self.truths.append(message)

    def _tap(self) -> None:
        """Keep what the controller is told, and when."""
        decoder, receive = Decoder(), self.rehearsal.robot.receive

        def tapped(data: bytes, now: float) -> None:
            self.commands += [(now, decode_command(p)) for p in decoder.feed(data, now)]
            receive(data, now)

        self.rehearsal.robot.receive = tapped


def _moves(command: Command) -> bool:
    return command.number in (Cmd.VEL, Cmd.RVEL) and command.value != 0


@pytest.mark.parametrize("name", EVERYBODY)
def test_any_agent_may_be_killed_the_rest_drive_on_or_the_robot_stops(name: str) -> None:
    run = Faulty()
    run.drive()
    killed_at = run.mesh.now
    run.mesh.node(name).kill()
    run.pass_s(3.0)
    if name in DRIVING:
        last = max(run.orders_to_move_after(0.0))
        stop = min(at for at, c in run.commands if at > last and c.number == Cmd.VEL)
        assert stop - last <= STOP_S
        assert last - killed_at <= STOP_S, "3 cycles are fresh"
        assert run.at_rest()
    else:
        assert run.orders_to_move_after(run.mesh.now - STOP_S)
    assert run.truths[-1].collisions == 0
    ballots_never_go_down(run.acks)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_of_two_of_each_behaviour_whoever_holds_the_wheels_may_be_killed(seed: int) -> None:
    run = Faulty(Options(seed=seed), replace(ideal(load_scenario("sc4")), redundant=True))
    run.drive()
    run.pass_s(2.0 + 5.0 * seed)  # goto holds them, or gothrough
    held = run.acks[-1].obeyed
    assert held is not None
    (holder,) = (node for node in run.mesh.nodes if node.agent.instance == held.instance)
    holder.kill()
    run.finish()
    ballots_never_go_down(run.acks)


@pytest.mark.long(but=("avoid",))
@pytest.mark.parametrize("name", [*DRIVING, "avoid", "interface"])
def test_any_agent_may_hang_and_on_its_return_the_goal_is_reached(name: str) -> None:
    run = Faulty()
    run.drive()
    run.mesh.node(name).hang()
    run.pass_s(3.0)
    assert run.at_rest() == (name in DRIVING)
    run.mesh.node(name).resume()
    run.finish()
    ballots_never_go_down(run.acks)


@pytest.mark.long(but=("encoder",))
@pytest.mark.parametrize("name", DRIVING)
def test_who_was_killed_and_started_again_drives_to_the_goal(name: str) -> None:
    run = Faulty()
    run.drive()
    run.mesh.node(name).kill()
    run.pass_s(3.0)
    assert run.at_rest()
    run.restart(name)
    run.finish()
    ballots_never_go_down(run.acks)


@pytest.mark.long
def test_motors_that_come_on_again_drive_nobody_off_until_the_stop_is_released() -> None:
    run = Faulty()
    run.drive()
    motion = run.rehearsal.robot.controller._motion
    motion.enable(False)
    run.pass_s(3.0)
    assert run.at_rest()
    motion.enable(True)
    on_at = run.mesh.now
    run.pass_s(3.0)
    assert run.orders_to_move_after(on_at) == []
    state = run.rehearsal.watch.view.state
    assert state is not None
    assert state.motors
    assert state.stop.stopped
    run.mesh.publish(Stop(state.stop.counter + 1, stopped=False, by="us", press=state.stop.press))
    run.finish()


@pytest.mark.long(but=("2",))
@pytest.mark.parametrize("seed", [1, 2])
def test_what_no_sonar_hears_is_touched_once_and_driven_round(seed: int) -> None:
    run = Faulty(Options(seed=seed))
    run.rehearsal.robot.plant._walls.add([(2.0, 0.05, 2.0, 0.6)], [DEAD])
    touched: list[tuple[float, str]] = []
    run.mesh.watch(
        lambda _key, log, now: touched.append((now, log.text)) if "touched" in log.text else None,
        Log,
    )
    result = run.rehearsal.run()
    assert result.reached
    assert result.collisions == 1
    ((at, text),) = touched
    assert " ahead" in text
    zero = [when for when, command in run.commands if when >= at and command.number == Cmd.VEL]
    assert zero[0] - at < 0.01
    held = (c for when, c in run.commands if at < when < at + HELD_S and _moves(c))
    assert not any(command.value > 0 for command in held)


def test_a_robot_agent_that_hung_returns_with_zero_speeds_and_drives_to_the_goal() -> None:
    run = Faulty()
    run.drive()
    run.mesh.node("robot").hang()
    run.pass_s(WATCHDOG_S + BRAKING_S)
    resumed_at = run.mesh.now
    run.mesh.node("robot").resume()
    run.finish()
    first = [command for at, command in run.commands if at >= resumed_at][:2]
    assert first == [decode_command(payload) for payload in Decoder().feed(ZERO)]
    ballots_never_go_down(run.acks)


@pytest.mark.long(but=("sc3-avoid",))
@pytest.mark.parametrize(("scenario", "name"), [("sc3", "avoid"), ("sc4", "gothrough")])
def test_the_holder_among_walls_may_be_killed_and_nothing_is_touched(
    scenario: str, name: str
) -> None:
    run = Faulty(scenario=ideal(load_scenario(scenario)))
    victim = run.mesh.node(name).agent.instance

    def holds() -> bool:
        return driver(run.acks[-1]) == victim and run.truths[-1].v > 0.1

    run.drive(holds)
    run.mesh.node(name).kill()
    run.pass_s(10.0)
    assert run.truths[-1].collisions == 0
    assert driver(run.acks[-1]) not in (None, victim) or run.at_rest()
    ballots_never_go_down(run.acks)
