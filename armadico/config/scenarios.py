"""Scenarios: a world, where the robot starts, where it is sent, and who takes part.

Files are what people write and read, so their headings are in degrees; those of a `Scenario` are in
rad, as everywhere in Python (REP-103). The experiments are those of the thesis's chapter 5.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import pairwise
from math import cos, isfinite, radians, sin, tau
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct
from msgspec.structs import force_setattr, replace

from armadico.config.discovery import AGENTS
from armadico.config.discovery import find as find_installed
from armadico.config.errands import Mission, load_mission
from armadico.config.errors import ConfigError, ConfigNameError, advice
from armadico.config.lines import line_of
from armadico.config.loading import document, load, parse, read_text
from armadico.config.moving import Moving
from armadico.config.profile import Body, load_profile
from armadico.config.shipped import counted_from, find, folder, resource_path
from armadico.config.worlds import DOCK_LANE_M, ROUNDING_M, World, apart, before, load_world
from armadico.config.worlds import Pose as WorldPose
from armadico.core.errors import UnknownNameError

Metres = Annotated[float, Meta(ge=-1e4, le=1e4)]
Degrees = Annotated[float, Meta(ge=-360, le=360)]
ScenarioPose = tuple[Metres, Metres, Degrees]
"""x, y in m and a heading: degrees in a file, whose range this checks, and rad in a `Scenario`."""

ROUNDING_RAD = 1e-6

Key = tuple[str | int, ...]
"""Where a value is in a scenario file."""

Fault = tuple[Key, str | ConfigError]
"""What is wrong with a scenario: the key, and the message or the error."""


class Exploring(Struct, frozen=True, forbid_unknown_fields=True):
    """Who takes no part where the world is explored, and who does besides those that drive."""

    without: tuple[str, ...]
    besides: tuple[str, ...]


class OnMissions(Struct, frozen=True, forbid_unknown_fields=True):
    """Who takes part besides where a mission of several tasks is done."""

    besides: tuple[str, ...]


class Ideal(Struct, frozen=True, forbid_unknown_fields=True):
    """The sensors that have no error, and who is not needed with them."""

    sensors: str
    without: tuple[str, ...]


class Senses(Struct, frozen=True, forbid_unknown_fields=True):
    """Who tells where obstacles are, by each sensor that a robot may have."""

    sonar: str
    laser: str


class Society(Struct, frozen=True, forbid_unknown_fields=True):
    """Who takes part unless a scenario says otherwise, by entry points: the robot, the others."""

    robot: str
    agents: tuple[str, ...]
    watch: tuple[str, ...]
    by_hand: str
    """Who takes a stick; a hand that finds nobody has it started."""

    assistant: str
    """Of whom programs ask what they want done."""

    senses: Senses
    ideal: Ideal
    exploring: Exploring
    missions: OnMissions


@cache
def society() -> Society:
    """The shipped one, `society.toml`."""
    return load(folder("") / "society.toml", Society)


class AlarmAt(Struct, frozen=True, forbid_unknown_fields=True):
    """An alarm of the building: when it begins, and how long it lasts.

    That is at a time of the run, or while a mission's task is done, perhaps in a certain room.
    """

    room: str
    at_s: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    during: str | None = None  # a task
    within: str | None = None  # and where the robot is then
    lasts_s: Annotated[float, Meta(gt=0, le=1e6)] | None = None  # none: for ever


class Battery(Struct, frozen=True, forbid_unknown_fields=True):
    """How the run begins: what is left of the battery, and how large it is; in the simulator."""

    charge: Annotated[float, Meta(ge=0, le=1)] = 1.0
    capacity_ah: Annotated[float, Meta(gt=0, le=1e4)] | None = None
    """None: the profile's."""


class Scenario(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One run, whatever it runs on. Poses are x, y in m and a heading in rad."""

    title: str = ""
    world: str
    start: ScenarioPose
    goal: ScenarioPose | None = None
    """None: nobody is sent anywhere, as where an agent wanders."""
    waypoints: tuple[ScenarioPose, ...] = ()
    """On the way to the goal; used with plan = "waypoints" only."""
    plan: Literal["direct", "waypoints", "rooms", "seen", "frontiers"] | None = None
    """Straight to the goal, over the waypoints, as the path planning agent says, with rooms or
    without, as it says that is told of no world and goes by what was seen, or all over the world,
    which nobody knows; None: planned where there are barriers."""
    within: tuple[Metres, Metres, Metres, Metres] | None = None
    """The rectangle that is explored: x1, y1, x2, y2 in m; none: the world's."""
    agents: tuple[str, ...] = ()
    """The agents that take part; none named: those of `society.toml` for these sensors."""
    redundant: bool = False
    """Two of each behaviour: the mission outlives any one of them."""
    robot: str = "pioneer-2dx"
    sensors: str = "real"
    """How well the simulated robot senses, of robots/sensors.toml."""
    mission: str | None = None
    """What is done there instead of driving to a goal: a shipped mission, or a file."""
    alarms: tuple[AlarmAt, ...] = ()
    moving: tuple[Moving, ...] = ()
    """People, doors that shut, boxes put down; in the simulator only."""
    others: tuple[ScenarioPose, ...] = ()
    """Where further robots start: a fleet."""
    tasks: Annotated[tuple[ScenarioPose, ...], Meta(max_length=256)] = ()
    """Places that a fleet is to look at."""
    look_s: Annotated[float, Meta(ge=0, le=3600)] = 5.0
    """How long each is looked at."""
    battery: Battery = Battery()
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None
    """A speed limit of this scenario, m/s; none: the agents' own."""
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    name: str = ""
    """What it is called: the file's name, unless it is given."""

    def __post_init__(self) -> None:
        """Resolve the default agents, so that every reader gets the same ones."""
        if not self.agents:
            force_setattr(self, "agents", _default_agents(self.sensors))


def _default_agents(sensors: str) -> tuple[str, ...]:
    """The agents of a scenario that names none; with sensors without error nobody localizes."""
    everybody, spared = society().agents, society().ideal
    if sensors != spared.sensors:
        return everybody
    return tuple(name for name in everybody if name not in spared.without)


def load_scenario(name_or_path: str | Path) -> Scenario:
    """A shipped scenario by its name, or a TOML file. Raises ConfigError with file and line.

    A world or a robot profile that is a file counts from the scenario's folder. Every pose must be
    in the world, and so far from its walls that the robot may turn there.
    """
    path = find("scenarios", name_or_path)
    text = read_text(path)
    scenario = parse(text, Scenario, path)
    scenario = replace(
        scenario, world=counted_from(path, scenario.world), robot=counted_from(path, scenario.robot)
    )
    if scenario.mission is not None:
        scenario = replace(scenario, mission=counted_from(path, scenario.mission))
    scenario = _in_rad(scenario)
    world = _world(scenario, path, text)
    for key, fault in (*_strangers(scenario), *_faults(scenario, world)):
        raise _error(fault).at(path, line_of(text, key))
    return replace(scenario, name=scenario.name or path.stem)


def _in_rad(scenario: Scenario) -> Scenario:
    """The scenario of a file, whose headings are in degrees, with headings in rad."""

    def turned(pose: ScenarioPose) -> ScenarioPose:
        return pose[0], pose[1], radians(pose[2])

    return replace(
        scenario,
        start=turned(scenario.start),
        goal=None if scenario.goal is None else turned(scenario.goal),
        waypoints=tuple(map(turned, scenario.waypoints)),
        others=tuple(map(turned, scenario.others)),
        tasks=tuple(map(turned, scenario.tasks)),
    )


def poses(scenario: Scenario) -> dict[str, ScenarioPose | None]:
    """All poses of a scenario, by what an error calls them."""
    found = {"start": scenario.start, "goal": scenario.goal}
    for name, one in _ONE_OF.items():
        found |= {f"{one} {k + 1}": pose for k, pose in enumerate(getattr(scenario, name))}
    return found


def check_poses(given: Mapping[str, Sequence[float] | None]) -> None:
    """Check poses that a program gives. Raises ConfigError for what is none, or in degrees."""
    for name, pose in given.items():
        if pose is None:
            continue
        if len(pose) != 3 or not all(map(isfinite, pose)):
            raise ConfigError(f"{name} {pose}: expected finite x and y in m and a heading in rad")
        if abs(pose[2]) > tau + ROUNDING_RAD:
            raise ConfigError(
                f"{name} {pose}: the heading is in rad, from -2 pi to 2 pi; of degrees it is"
                f" math.radians({pose[2]:g})"
            )


def planned(scenario: Scenario) -> bool:
    """Whether the path planning agent is asked for the way."""
    if scenario.plan is None:
        return bool(load_world(scenario.world).barriers)
    return scenario.plan in ("rooms", "seen")


def unmapped(scenario: Scenario) -> bool:
    """Whether nobody is told of the world."""
    return scenario.plan in ("seen", "frontiers")


def blind(scenario: Scenario) -> bool:
    """Whether it is driven straight at a goal that is behind a barrier, by nobody's plan."""
    if scenario.goal is None or scenario.plan in ("waypoints", "frontiers") or planned(scenario):
        return False
    return load_world(scenario.world).crossed(scenario.start[:2], scenario.goal[:2])


def sensing(agents: Sequence[str], robot: str) -> tuple[str, ...]:
    """The agents, with those for the sensors that a robot has where one for any sensor stood."""
    senses, profile = society().senses, load_profile(robot)
    by_sensor = ((profile.sonar, senses.sonar), (profile.laser, senses.laser))
    mine = [name for sensor, name in by_sensor if sensor is not None]
    found: list[str] = []
    for name in agents:
        if name not in (senses.sonar, senses.laser):
            found.append(name)
        else:
            found += [one for one in mine if one not in found]
    return tuple(found)


def ideal(scenario: Scenario, keeping: Sequence[str] = ()) -> Scenario:
    """The scenario as the thesis ran it: sensors without error, and whom that makes needless gone.

    Those that are named take part all the same.
    """
    changes = society().ideal
    gone = set(changes.without) - set(keeping)
    agents = tuple(name for name in scenario.agents if name not in gone)
    return replace(scenario, sensors=changes.sensors, agents=agents)


def with_sensors(scenario: Scenario, sensors: str, keeping: Sequence[str] = ()) -> Scenario:
    """Return the scenario with other sensors, by the name of their table in sensors.toml.

    A scenario that names no agents gets the default ones for these sensors. From one that does, and
    with sensors without error, those are removed that are not needed then, except `keeping`.
    Raises ConfigError for an unknown name.
    """
    if sensors == society().ideal.sensors:
        return ideal(scenario, keeping)
    unnamed = scenario.agents == _default_agents(scenario.sensors)
    agents = () if unnamed else scenario.agents
    return replace(scenario, sensors=known_sensors(sensors), agents=agents)


def exploring(scenario: Scenario, within: Sequence[float] | None = None) -> Scenario:
    """The scenario with a robot that is told nothing of the world, maps it and comes back.

    Nobody localizes on a map in the making, so the map is as good as the odometry: ideal.
    """
    changes, scenario = society().exploring, ideal(scenario)
    others = (name for name in scenario.agents if name not in changes.without + changes.besides)
    agents = (*others, *changes.besides)
    title = f"{scenario.name}: explored from here, and back"
    changed = replace(scenario, title=title, goal=scenario.start, plan="frontiers", agents=agents)
    return changed if within is None else replace(changed, within=tuple(within))


def on_mission(scenario: Scenario, mission: str | None = None) -> Scenario:
    """The scenario with those who do missions taking part, and the mission that they do.

    Raises ConfigError if the mission, or the one that is the scenario's, cannot be done there.
    """
    if mission is not None:
        scenario = replace(scenario, mission=mission, goal=None, waypoints=())
    if scenario.mission is None:
        return scenario
    mission_of(scenario)
    besides = (name for name in society().missions.besides if name not in scenario.agents)
    return replace(scenario, agents=(*scenario.agents, *besides))


def mission_of(scenario: Scenario) -> Mission | None:
    """The mission that is done in a scenario. Raises ConfigError if it cannot be."""
    if scenario.mission is None:
        return None
    from armadico.config.places import Places

    places = Places(load_world(scenario.world), load_profile(scenario.robot).body)
    return load_mission(scenario.mission, places, scenario.start[:2])


def _error(fault: str | ConfigError) -> ConfigError:
    return fault if isinstance(fault, ConfigError) else ConfigError(fault)


def _strangers(scenario: Scenario) -> Iterator[Fault]:
    """Agents that are not installed, each with its key."""
    for index, name in enumerate(scenario.agents):
        try:
            find_installed(AGENTS, name)
        except UnknownNameError as error:
            yield ("agents", index), ConfigNameError(error.kind, name, error.known)


def _world(scenario: Scenario, path: Path, text: str) -> World:
    try:
        return load_world(scenario.world)
    except ConfigError as error:
        if error.file is not None:  # the fault is within the world's file
            raise
        raise error.at(path, line_of(text, ("world",))) from None


def scenario_from(
    world: str | Path,
    start: ScenarioPose | None = None,
    goal: ScenarioPose | str | None = None,
    robot: str | None = None,
) -> Scenario:
    """A scenario of the command line: a world, and from where to where. Raises ConfigError.

    Without a start it is the world's own (`RobotHome`); a goal may be the name of one of the
    world's goals.
    """
    place = load_world(world)
    begin = start if start is not None else _home(place)
    end = _goal(place, goal) if isinstance(goal, str) else goal
    scenario = Scenario(
        name=place.name,
        title=f"{place.name}: from the command line",
        world=str(world),
        start=begin,
        goal=end,
    )
    if robot is not None:
        scenario = replace(scenario, robot=robot)
    for _, fault in _faults(scenario, place):
        raise _error(fault)
    return scenario


def _home(world: World) -> ScenarioPose:
    if world.start is None:
        raise ConfigError(f"world {world.name!r} has no start: --start X Y DEG says where")
    return world.start


def _goal(world: World, name: str) -> ScenarioPose:
    if name not in world.goals:
        message = f"no goal {name!r} in {world.name!r}; {advice(name, world.goals)}"
        raise ConfigNameError("goal", name, world.goals, message=message)
    return world.goals[name]


def _unfound_mission(scenario: Scenario) -> Iterator[Fault]:
    try:
        if scenario.mission is not None:
            find("missions", scenario.mission)
    except ConfigError as error:
        yield ("mission",), error


def _faults(scenario: Scenario, world: World) -> Iterator[Fault]:
    """What is wrong with a scenario, and with which key."""
    try:
        profile = find("robots", scenario.robot)
    except ConfigError as error:
        yield ("robot",), error
        return
    body = load_profile(profile).body
    radius = body.circle_m
    charged = set(society().missions.besides) & set(scenario.agents)
    for name, dock in world.docks.items() if charged else ():
        if not _may_dock(world, dock, body):
            message = f"a {scenario.robot} cannot drive into dock {name!r} of {world.name!r}"
            yield ("world",), f"{message}: a wall is in its way"
    for key, pose in (("start", scenario.start), ("goal", scenario.goal)):
        if pose is not None:
            yield from _misplaced(world, (key,), pose, body)
    yield from _cut_off(scenario, world, body)
    yield from _fleet_faults(scenario, world, body)
    for index, moving in enumerate(scenario.moving):
        for name, message in moving.faults(world, scenario.start[:2], radius):
            yield ("moving", index, name), message
    try:
        known_sensors(scenario.sensors)
    except ConfigError as error:
        yield ("sensors",), error
    yield from _unfound_mission(scenario)
    for agent in scenario.agents:
        if scenario.agents.count(agent) > 1:
            yield ("agents",), f"agent {agent!r} is there twice; expected once"
    yield from _mission_faults(scenario, world)
    if scenario.plan == "waypoints" and not scenario.waypoints:
        message = 'plan = "waypoints", but there are none; give waypoints = [[x, y, degrees], ...]'
        yield ("plan",), message


def _fleet_faults(scenario: Scenario, world: World, body: Body) -> Iterator[tuple[Key, str]]:
    """What is wrong with waypoints, other robots' starts, and what they are to look at."""
    for name in _ONE_OF:
        for index, pose in enumerate(getattr(scenario, name)):
            yield from _misplaced(world, (name, index), pose, body)
    if scenario.others and scenario.moving:
        yield ("moving",), "what moves does in the world of one robot; expected this, or others"


def _mission_faults(scenario: Scenario, world: World) -> Iterator[Fault]:
    """What is wrong with a mission's place in a scenario; the mission has a file of its own."""
    if scenario.mission is not None and scenario.goal is not None:
        yield ("goal",), "a mission and a goal: expected one of both"
    rooms = [room.name for room in world.rooms]
    for index, alarm in enumerate(scenario.alarms):
        for name in ("room", "within"):
            room = getattr(alarm, name)
            if room is not None and room not in rooms:
                yield ("alarms", index, name), ConfigNameError("room", room, rooms)
        if (alarm.at_s is None) == (alarm.during is None):
            yield (
                ("alarms", index),
                "an alarm begins at a time (at_s) or during a task: one of both",
            )
        if alarm.within is not None and alarm.during is None:
            yield ("alarms", index, "within"), "within is for an alarm during a task"


def _may_dock(world: World, dock: WorldPose, body: Body) -> bool:
    """Whether no wall is where a robot stands that is charged, nor where it lines up for it."""
    (x, y, theta), lane = dock, before(dock)
    c, s = cos(theta), sin(theta)
    half = body.width_m / 2
    corners = [
        (x + c * ahead - s * aside, y + s * ahead + c * aside)
        for ahead, aside in (
            *((body.front_m, half), (body.front_m, -half)),
            *((-body.rear_m - DOCK_LANE_M, -half), (-body.rear_m - DOCK_LANE_M, half)),
        )
    ]
    sides = pairwise([*corners, corners[0]])
    free = not any(world.crossed(a, b) for a, b in sides)
    return free and world.clearance(lane[0], lane[1]) >= body.goal_room_m


def known_sensors(name: str) -> str:
    """The name, if robots/sensors.toml has it. Raises ConfigError."""
    known = document(read_text(resource_path("robots", "sensors")), "sensors.toml")
    if name not in known:
        raise ConfigNameError("sensors", name, known)
    return name


_STOPS = ("goal", "tasks")
"""Where the robot is to stop by its pose; it stands at a start, and drives past a waypoint."""

_ONE_OF = {"waypoints": "waypoint", "others": "robot", "tasks": "task"}


def _misplaced(world: World, key: Key, pose: ScenarioPose, body: Body) -> Iterator[tuple[Key, str]]:
    x, y, _ = pose
    what = str(key[-1])
    if isinstance(key[-1], int):
        what = f"{_ONE_OF[str(key[0])]} {key[-1] + 1}"
    at = f"{what} ({x:g}, {y:g})"
    stops = key[0] in _STOPS
    radius = body.goal_room_m if stops else body.circle_m
    why = f" ({body.goal_needs})" if stops else ""
    if not world.inside(x, y):
        x1, y1, x2, y2 = world.bounds
        span = f"x {x1:g} to {x2:g}, y {y1:g} to {y2:g}"
        yield key, f"{at} is outside the world {world.name!r}; expected {span}"
        return
    for near_what, away in (
        ("a wall of", world.clearance(x, y)),
        ("what is forbidden in", world.clearance_of_forbidden(x, y)),
    ):
        if away < radius - ROUNDING_M:
            near, least = apart(away, radius)
            expected = f"expected at least {least} m{why}"
            yield key, f"{at} is {near} m from {near_what} {world.name!r}; {expected}"
            return


def _cut_off(scenario: Scenario, world: World, body: Body) -> Iterator[tuple[Key, str]]:
    """A goal to which no way leads from the start, whoever drives."""
    (x, y), goal = scenario.start[:2], scenario.goal
    if goal is None or not world.crossed((x, y), goal[:2]):
        return
    from armadico.config.places import Places

    if not Places(world, body).joined((x, y), goal[:2]):
        yield (
            ("goal",),
            f"goal ({goal[0]:g}, {goal[1]:g}): no way from start ({x:g}, {y:g}) in"
            f" {world.name!r} is as wide as the robot, {body.width_m:g} m; expected a goal that"
            " walls do not shut off",
        )
