"""Scenarios: a world, start, goal and the participating agents.

Headings are in degrees in files and in rad in a `Scenario` (REP-103). The shipped experiments are
those of chapter 5 of the thesis.
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

from armadico.config.errands import Mission, load_mission
from armadico.config.lines import line_of
from armadico.config.loading import document, load, parse, read_text
from armadico.config.moving import Moving
from armadico.config.profile import Body, load_profile
from armadico.config.shipped import counted_from, find, folder, resource_path
from armadico.config.slots import slot
from armadico.config.worlds import DOCK_LANE_M, ROUNDING_M, World, apart, before, load_world
from armadico.config.worlds import Pose as WorldPose
from armadico.core.config_errors import ConfigError, ConfigNameError, advice
from armadico.core.discovery import AGENTS
from armadico.core.discovery import find as find_installed
from armadico.core.errors import UnknownNameError
from armadico.core.unseen import Rule

Metres = Annotated[float, Meta(ge=-1e4, le=1e4)]
Degrees = Annotated[float, Meta(ge=-360, le=360)]
ScenarioPose = tuple[Metres, Metres, Degrees]
"""x, y in m and a heading: degrees in a file, whose range this checks; rad in a `Scenario`."""

ROUNDING_RAD = 1e-6

Key = tuple[str | int, ...]
"""The path of a value in a scenario file."""

Fault = tuple[Key, str | ConfigError]
"""A fault of a scenario: the key, and the message or the error."""


class Ideal(Struct, frozen=True, forbid_unknown_fields=True):
    """The sensors without errors, and the agents left out with them."""

    sensors: str
    without: tuple[str, ...]


class Senses(Struct, frozen=True, forbid_unknown_fields=True):
    """The agent that publishes obstacles, for each kind of sensor."""

    sonar: str
    laser: str


class Society(Struct, frozen=True, forbid_unknown_fields=True):
    """The default agents, by their entry points."""

    robot: str
    agents: tuple[str, ...]
    watch: tuple[str, ...]
    senses: Senses
    ideal: Ideal


@cache
def society() -> Society:
    """The shipped `society.toml`."""
    return load(folder("") / "society.toml", Society)


class AlarmAt(Struct, frozen=True, forbid_unknown_fields=True):
    """An alarm of the building.

    It begins at a time of the run, or during a mission's task, optionally in a certain room.
    """

    room: str
    at_s: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    during: str | None = None  # a task
    within: str | None = None  # the room in which the robot is then
    lasts_s: Annotated[float, Meta(gt=0, le=1e6)] | None = None  # None: it does not end


class Battery(Struct, frozen=True, forbid_unknown_fields=True):
    """The simulated battery at the start: its charge and capacity."""

    charge: Annotated[float, Meta(ge=0, le=1)] = 1.0
    capacity_ah: Annotated[float, Meta(gt=0, le=1e4)] | None = None
    """None: the profile's."""


class Scenario(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One run, live or virtual. Poses are x, y in m and a heading in rad."""

    title: str = ""
    world: str
    start: ScenarioPose
    goal: ScenarioPose | None = None
    """None: the robot is not sent anywhere, as with an agent that wanders."""
    waypoints: tuple[ScenarioPose, ...] = ()
    """Poses before the goal; only with plan = "waypoints"."""
    plan: Literal["direct", "waypoints", "rooms", "seen", "frontiers"] | None = None
    """The path: straight to the goal ("direct"), over the waypoints ("waypoints"), by the path
    planning agent with the map ("rooms") or from what the sensors detected ("seen"), or exploring
    an unknown world ("frontiers"). None: "rooms" in a world with barriers, else "direct"."""
    within: tuple[Metres, Metres, Metres, Metres] | None = None
    """The rectangle to explore: x1, y1, x2, y2 in m; None: the world's."""
    agents: tuple[str, ...] = ()
    """The participating agents; by default those of `society.toml` for these sensors."""
    redundant: bool = False
    """Two of each behaviour, so that any one may fail."""
    robot: str = "pioneer-2dx"
    sensors: str = "real"
    """The errors of the simulated sensors, from robots/sensors.toml."""
    mission: str | None = None
    """A mission instead of a goal: a shipped one, or a file."""
    alarms: tuple[AlarmAt, ...] = ()
    moving: tuple[Moving, ...] = ()
    """People, doors and boxes; in the simulator only."""
    others: tuple[ScenarioPose, ...] = ()
    """Start poses of further robots of a fleet."""
    tasks: Annotated[tuple[ScenarioPose, ...], Meta(max_length=256)] = ()
    """Poses that a fleet is to visit."""
    look_s: Annotated[float, Meta(ge=0, le=3600)] = 5.0
    """Time that a robot stays at each of them."""
    battery: Battery = Battery()
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None
    """Speed limit of this scenario, m/s; None: the agents' own."""
    unseen: Rule | None = None
    """Whether a path may lead through what nobody has seen, where no other leads to the goal.
    None: as the map's file says, else "drive"."""
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    name: str = ""
    """By default the file's name."""

    def __post_init__(self) -> None:
        """Set the default agents."""
        if not self.agents:
            force_setattr(self, "agents", _default_agents(self.sensors))


def _default_agents(sensors: str) -> tuple[str, ...]:
    """The agents of a scenario that names none; ideal sensors need no localization."""
    agents, ideal = society().agents, society().ideal
    if sensors != ideal.sensors:
        return agents
    return tuple(name for name in agents if name not in ideal.without)


def load_scenario(name_or_path: str | Path) -> Scenario:
    """A shipped scenario by its name, or a TOML file. Raises ConfigError.

    Paths in it are relative to its folder. Every pose must be in the world, and far enough from
    walls for the robot to turn.
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
    for key, fault in (*_unknown_agents(scenario), *_faults(scenario, world)):
        raise _error(fault).at(path, line_of(text, key))
    return replace(scenario, name=scenario.name or path.stem)


def _in_rad(scenario: Scenario) -> Scenario:
    """The scenario with its headings converted from degrees to rad."""

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
    """All poses of a scenario by their names in errors."""
    found = {"start": scenario.start, "goal": scenario.goal}
    for name, one in _ONE_OF.items():
        found |= {f"{one} {k + 1}": pose for k, pose in enumerate(getattr(scenario, name))}
    return found


def check_poses(given: Mapping[str, Sequence[float] | None]) -> None:
    """Raises ConfigError for an invalid pose, and for a heading that is not in rad."""
    for name, pose in given.items():
        if pose is None:
            continue
        if len(pose) != 3 or not all(map(isfinite, pose)):
            raise ConfigError(f"{name} {pose}: expected finite x and y in m and a heading in rad")
        if abs(pose[2]) > tau + ROUNDING_RAD:
            raise ConfigError(
                f"{name} {pose}: expected a heading in rad, -2 pi to 2 pi; from degrees use"
                f" math.radians({pose[2]:g})"
            )


def planned(scenario: Scenario) -> bool:
    """Whether the path planning agent plans the path."""
    if scenario.plan is None:
        return bool(load_world(scenario.world).barriers)
    return scenario.plan in ("rooms", "seen")


def unmapped(scenario: Scenario) -> bool:
    """Whether the agents have no map."""
    return scenario.plan in ("seen", "frontiers")


def blind(scenario: Scenario) -> bool:
    """Whether the robot drives straight at a goal behind a barrier, without a plan."""
    if scenario.goal is None or scenario.plan in ("waypoints", "frontiers") or planned(scenario):
        return False
    return load_world(scenario.world).crossed(scenario.start[:2], scenario.goal[:2])


def sensing(agents: Sequence[str], robot: str) -> tuple[str, ...]:
    """The agents, with the obstacle agents replaced by those for the robot's sensors."""
    senses, profile = society().senses, load_profile(robot)
    by_sensor = ((profile.sonar, senses.sonar), (profile.laser, senses.laser))
    suitable = [name for sensor, name in by_sensor if sensor is not None]
    found: list[str] = []
    for name in agents:
        if name not in (senses.sonar, senses.laser):
            found.append(name)
        else:
            found += [one for one in suitable if one not in found]
    return tuple(found)


def ideal(scenario: Scenario, keeping: Sequence[str] = ()) -> Scenario:
    """The scenario as in the thesis: with ideal sensors and without the agents they replace.

    The agents in `keeping` stay.
    """
    changes = society().ideal
    gone = set(changes.without) - set(keeping)
    agents = tuple(name for name in scenario.agents if name not in gone)
    return replace(scenario, sensors=changes.sensors, agents=agents)


def with_sensors(scenario: Scenario, sensors: str, keeping: Sequence[str] = ()) -> Scenario:
    """The scenario with other sensors, a table of sensors.toml.

    A scenario that names no agents gets the default ones for these sensors. Ideal sensors remove
    the agents that they replace, except `keeping`. Raises ConfigNameError.
    """
    if sensors == society().ideal.sensors:
        return ideal(scenario, keeping)
    unnamed = scenario.agents == _default_agents(scenario.sensors)
    agents = () if unnamed else scenario.agents
    return replace(scenario, sensors=known_sensors(sensors), agents=agents)


def slams(robot: str) -> bool:
    """Whether a robot can map with sensors that have errors: it needs a laser."""
    return load_profile(robot).laser is not None


def with_slam(agents: Sequence[str]) -> tuple[str, ...]:
    """The agents, with slam in place of those whose messages it publishes."""
    changes = slot("slam")
    others = (name for name in agents if name not in changes.without + changes.besides)
    return (*others, *changes.besides)


def exploring(scenario: Scenario, within: Sequence[float] | None = None) -> Scenario:
    """The scenario as an exploration: the robot has no map, makes one and returns.

    A mission of the scenario is left out with its agents, since it needs the rooms of a map. A
    robot with a laser localizes on the map that it makes. Without one the map is as good as the
    odometry, so sensors are ideal.
    """
    changes = slot("exploring")
    by_slam = scenario.sensors != society().ideal.sensors and slams(scenario.robot)
    if not by_slam:
        scenario = ideal(scenario)
    gone = changes.besides if by_slam else changes.without + changes.besides
    if scenario.mission is not None:
        gone += slot("missions").besides
        scenario = replace(scenario, mission=None, alarms=())
    agents = (*(name for name in scenario.agents if name not in gone), *changes.besides)
    if by_slam:
        agents = with_slam(agents)
    title = f"{scenario.name}: exploration and return"
    changed = replace(scenario, title=title, goal=scenario.start, plan="frontiers", agents=agents)
    return changed if within is None else replace(changed, within=tuple(within))


def on_mission(scenario: Scenario, mission: str | None = None) -> Scenario:
    """The scenario with the agents for missions, and with `mission` if it is given.

    Raises ConfigError if the mission cannot be done there.
    """
    if mission is not None:
        scenario = replace(scenario, mission=mission, goal=None, waypoints=())
    if scenario.mission is None:
        return scenario
    mission_of(scenario)
    besides = (name for name in slot("missions").besides if name not in scenario.agents)
    return replace(scenario, agents=(*scenario.agents, *besides))


def mission_of(scenario: Scenario) -> Mission | None:
    """The mission of a scenario, or None. Raises ConfigError if it cannot be done there."""
    if scenario.mission is None:
        return None
    from armadico.config.places import Places

    places = Places(load_world(scenario.world), load_profile(scenario.robot).body)
    return load_mission(scenario.mission, places, scenario.start[:2])


def _error(fault: str | ConfigError) -> ConfigError:
    return fault if isinstance(fault, ConfigError) else ConfigError(fault)


def _unknown_agents(scenario: Scenario) -> Iterator[Fault]:
    for index, name in enumerate(scenario.agents):
        try:
            find_installed(AGENTS, name)
        except UnknownNameError as error:
            yield ("agents", index), ConfigNameError(error.kind, name, error.known)


def _world(scenario: Scenario, path: Path, text: str) -> World:
    try:
        return load_world(scenario.world)
    except ConfigError as error:
        if error.file is not None:  # the fault is in the world's file
            raise
        raise error.at(path, line_of(text, ("world",))) from None


def scenario_from(
    world: str | Path,
    start: ScenarioPose | None = None,
    goal: ScenarioPose | str | None = None,
    robot: str | None = None,
) -> Scenario:
    """A scenario from a world, a start and a goal. Raises ConfigError.

    The default start is the world's `RobotHome`; a goal may be a name of the world's goals.
    """
    place = load_world(world)
    begin = start if start is not None else _home(place)
    end = _goal(place, goal) if isinstance(goal, str) else goal
    scenario = Scenario(
        name=place.name,
        title=f"{place.name}: command line",
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
        raise ConfigError(f"world {world.name!r} has no start; give --start X Y DEG")
    return world.start


def _goal(world: World, name: str) -> ScenarioPose:
    if name not in world.goals:
        message = f"no goal {name!r} in {world.name!r}; {advice(name, world.goals)}"
        raise ConfigNameError("goal", name, world.goals, message=message)
    return world.goals[name]


def _unfound(kind: str, name: str | None) -> Iterator[Fault]:
    """The fault of a named robot or mission that is not there."""
    try:
        if name is not None:
            find(f"{kind}s", name)
    except ConfigError as error:
        yield (kind,), error


def _faults(scenario: Scenario, world: World) -> Iterator[Fault]:
    """The faults of a scenario in its world."""
    if unfound := [*_unfound("robot", scenario.robot)]:
        yield from unfound
        return
    body = load_profile(scenario.robot).body
    radius = body.circle_m
    charged = set(slot("missions").besides) & set(scenario.agents)
    for name, dock in world.docks.items() if charged else ():
        if not _may_dock(world, dock, body):
            message = f"a {scenario.robot} cannot drive into dock {name!r} of {world.name!r}"
            yield ("world",), f"{message}: a wall is in the way"
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
    yield from _unfound("mission", scenario.mission)
    for agent in scenario.agents:
        if scenario.agents.count(agent) > 1:
            yield ("agents",), f"agent {agent!r} is listed twice; expected once"
    yield from _mission_faults(scenario, world)
    if scenario.plan == "waypoints" and not scenario.waypoints:
        message = 'plan = "waypoints": expected waypoints = [[x, y, degrees], ...]'
        yield ("plan",), message


def _fleet_faults(scenario: Scenario, world: World, body: Body) -> Iterator[tuple[Key, str]]:
    """The faults of waypoints, other robots' starts and a fleet's tasks."""
    for name in _ONE_OF:
        for index, pose in enumerate(getattr(scenario, name)):
            yield from _misplaced(world, (name, index), pose, body)
    if scenario.others and scenario.moving:
        yield ("moving",), "moving is for one robot; expected either moving or others"


def _mission_faults(scenario: Scenario, world: World) -> Iterator[Fault]:
    """The faults of a mission and alarms in a scenario; the mission's file is checked elsewhere."""
    if scenario.mission is not None and scenario.goal is not None:
        yield ("goal",), "expected either a mission or a goal"
    rooms = [room.name for room in world.rooms]
    for index, alarm in enumerate(scenario.alarms):
        for name in ("room", "within"):
            room = getattr(alarm, name)
            if room is not None and room not in rooms:
                yield ("alarms", index, name), ConfigNameError("room", room, rooms)
        if (alarm.at_s is None) == (alarm.during is None):
            yield ("alarms", index), "expected either at_s, a time, or during, a task"
        if alarm.within is not None and alarm.during is None:
            yield ("alarms", index, "within"), "within needs during, a task"


def _may_dock(world: World, dock: WorldPose, body: Body) -> bool:
    """Whether a docked robot and its lane before the dock are clear of walls."""
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
    """The name, checked against robots/sensors.toml. Raises ConfigNameError."""
    known = document(read_text(resource_path("robots", "sensors")), "sensors.toml")
    if name not in known:
        raise ConfigNameError("sensors", name, known)
    return name


_STOPS = ("goal", "tasks")
"""Where the robot stops by its estimated pose, which needs more clearance."""

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
        ("a forbidden line of", world.clearance_of_forbidden(x, y)),
    ):
        if away < radius - ROUNDING_M:
            near, least = apart(away, radius)
            expected = f"expected at least {least} m{why}"
            yield key, f"{at} is {near} m from {near_what} {world.name!r}; {expected}"
            return


def _cut_off(scenario: Scenario, world: World, body: Body) -> Iterator[tuple[Key, str]]:
    """The fault of a goal that cannot be reached from the start."""
    (x, y), goal = scenario.start[:2], scenario.goal
    if goal is None or not world.crossed((x, y), goal[:2]):
        return
    from armadico.config.places import Places

    if not Places(world, body).joined((x, y), goal[:2]):
        yield (
            ("goal",),
            f"goal ({goal[0]:g}, {goal[1]:g}): walls of {world.name!r} leave no path from start"
            f" ({x:g}, {y:g}) that is as wide as the robot, {body.width_m:g} m",
        )
