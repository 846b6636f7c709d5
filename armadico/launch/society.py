"""A scenario as a list of processes: who takes part, and with what parameters.

The same list is launched as real processes (`armadico.launch.local`) or put on the virtual mesh
(`armadico.launch.virtual`), so that both are the same society.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path

from msgspec import to_builtins
from msgspec.structs import replace

from armadico.config.discovery import AGENTS, ERRANDS, agent_class, find, installed, owners
from armadico.config.errands import Mission
from armadico.config.errors import ConfigError, ConfigNameError, advice
from armadico.config.hosts import Host, HostTable
from armadico.config.loading import load_parameters
from armadico.config.needs import minimum, needs, tasks
from armadico.config.parameters import load_set
from armadico.config.profile import load_profile
from armadico.config.scenarios import (
    Scenario,
    ScenarioPose,
    check_poses,
    known_sensors,
    mission_of,
    on_mission,
    planned,
    poses,
    scenario_from,
    sensing,
    society,
    unmapped,
    with_sensors,
)
from armadico.config.shipped import counted_from
from armadico.config.worlds import load_world
from armadico.core.agent import DeviceAgent
from armadico.core.resources import WHEELS, Resource
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mobile.errand import Order
from armadico.mobile.messages import MissionRequest, Waypoint
from armadico.observe.conditions import Conditions, digest, packages, software
from armadico.observe.measures import RunWatch

VIRTUAL, LIVE, ATTACHED = "virtual", "live", "attached"
"""How a run is driven."""

NOWHERE = Scenario(world="empty", start=(0, 0, 0), plan="seen")
"""Where no scenario is named, nobody knows the world."""

LIMIT_SPEED = 0.3
LIMIT_FACTOR = 5.0
LIMIT_LEAST = 60.0
MISSION_S = 3600.0
"""What a mission of several tasks may take that says nothing of it."""


@dataclass(frozen=True)
class Options:
    """What the command line may change about a scenario."""

    seed: int = 0
    controller: str | None = None
    exchange: str | None = None
    parameters: str | None = None  # a set of them, by name or path
    without: tuple[str, ...] = ()
    besides: tuple[str, ...] = ()  # agents that take part, too
    sensors: str | None = None  # how well the simulated robot senses; None: the scenario's
    redundant: bool = False  # two of each behaviour, whatever the scenario says
    robot: str | None = None  # the URL of something that is already there
    together: tuple[tuple[str, ...], ...] = ()  # agents that share a process
    resume: str | None = None  # a saved map that the mapping agent goes on with
    limit: float | None = None  # s that the run may take; None: as `time_limit` says
    namespace: str = DEFAULT_NAMESPACE  # the robot's
    priority: float | None = None  # of a mission of several tasks; None: its own
    journal: bool = False  # live: the agents publish what enters and leaves them
    margin: float | None = None  # by how much a bid must be better; None: the resource's own


@dataclass(frozen=True)
class Member:
    """One agent of the society, and what is set on its command line."""

    name: str
    sets: tuple[str, ...] = ()


def prepared(
    scenario: Scenario,
    options: Options,
    *,
    start: ScenarioPose | None = None,
    goal: ScenarioPose | None = None,
    profile: str | None = None,
    mission: str | None = None,
) -> Scenario:
    """The scenario with what was chosen for it: poses (m, m, rad), and the make of robot.

    Raises ConfigError for what cannot be driven, UnknownNameError for an agent that nobody has.
    """
    check_poses({"start": start, "goal": goal})
    check_poses(poses(scenario))
    if start is not None or goal is not None or profile is not None:
        checked = scenario_from(
            scenario.world,
            start or scenario.start,
            goal or scenario.goal,
            profile_of(profile) or scenario.robot,
        )
        scenario = replace(scenario, start=checked.start, goal=checked.goal, robot=checked.robot)
    if options.sensors is not None:
        scenario = with_sensors(scenario, options.sensors, options.besides)
    scenario = on_mission(scenario, mission)
    more = tuple(name for name in options.besides if name not in scenario.agents)
    scenario = replace(
        scenario,
        agents=(*scenario.agents, *more),
        sensors=known_sensors(scenario.sensors),
        redundant=options.redundant or scenario.redundant,
    )
    for name in (*scenario.agents, *options.without):
        find(AGENTS, name)
    _, *others = names(scenario)
    for name in options.without:
        if name not in others:
            taking = ", ".join(others)
            raise ConfigError(f"without {name}: only {taking} can be left out of {scenario.name}")
    if options.controller or options.parameters:
        check(members(scenario, options, ""))
    return scenario


def profile_of(name: str | None) -> str | None:
    """The make of robot that is named on the command line, a path from here."""
    return None if name is None else counted_from(Path.cwd() / "command line", name)


def names(scenario: Scenario, without: Sequence[str] = ()) -> tuple[str, ...]:
    """Everybody who takes part, the robot agent first: whoever owns the wheels.

    In a redundant society whoever competes for them is there twice.
    """
    robot = next(owners(scenario.agents, WHEELS), society().robot)
    agents = sensing(scenario.agents, scenario.robot)
    others = [name for name in agents if name not in (robot, *without)]
    if scenario.redundant:
        others = [name for name in others for _ in range(1 + (WHEELS in _competes_for(name)))]
    return (robot, *others)


def _competes_for(name: str) -> Collection[Resource]:
    return agent_class(name).competes_for


def members(scenario: Scenario, options: Options, port: str) -> tuple[Member, ...]:
    """The agents of a run, the robot agent first; `port` is the URL of the robot's controller."""
    known = options.robot is None  # the simulator puts it there
    told = facts(scenario, options, port, placed=known)
    return _launched(names(scenario, options.without), told, options)


def share(
    scenario: Scenario | None, options: Options, host: Host, more: Sequence[str] = ()
) -> tuple[Member, ...]:
    """The agents of one host: those of its entry that take part, and `more` beside them.

    Without a scenario all of the entry take part, with parameters of their own. So does whoever
    watches the others.
    """
    taken = host.agents if scenario is None else (*names(scenario), *society().watch)
    taking = Counter(name for name in taken if name not in options.without)
    scenario = scenario or NOWHERE
    here = (*(name for name in host.agents for _ in range(taking[name])), *more)
    told = facts(scenario, options, host.robot or "", placed=host.robot is None)
    return _launched(here, told, options)


def spare(
    scenario: Scenario | None, options: Options, host: Host, table: HostTable
) -> tuple[Member, ...]:
    """The agents that one host would start in place of another that is gone, or for a hand.

    Whoever owns a device is where the device is, and nowhere else.
    """
    by_hand = society().by_hand
    placed = dict.fromkeys(name for other in table.hosts.values() for name in other.agents)
    taken = placed if scenario is None else (*names(scenario, options.without), *society().watch)
    here = installed(AGENTS)
    able = [
        name
        for name in dict.fromkeys((*taken, by_hand))
        if name in (*placed, by_hand)
        and name in here
        and (host.takes is None or name in host.takes)
        if name not in host.agents and not issubclass(agent_class(name), DeviceAgent)
    ]
    scenario = scenario or NOWHERE
    return _launched(able, facts(scenario, options), options)


def needed(scenario: Scenario | None, options: Options, table: HostTable) -> tuple[str, ...]:
    """The agents of all hosts that a scenario cannot do without, of those that take part."""
    placed = {name for other in table.hosts.values() for name in other.agents}
    if scenario is None:
        return tuple(name for name in needs(tasks(None)) if name in placed)
    robot, *others = names(scenario, options.without)
    needed = sensing(needs(tasks(scenario)), scenario.robot)
    wanted = (robot, *(name for name in needed if name in others))
    return tuple(name for name in wanted if name in placed)


def least(scenario: Scenario) -> Scenario:
    """The scenario with nobody taking part but those whom its tasks need, and who helps them."""
    robot, *_ = names(scenario)
    taking = sensing(minimum(tasks(scenario))[1:], scenario.robot)
    return replace(scenario, agents=(robot, *(name for name in taking if name != robot)))


PLACED_M, PLACED_RAD = 0.05, radians(2.0)
"""Standard deviations of a start pose at which a simulator has put the robot; a person who puts a
robot down is less exact, and the agents' own defaults count."""


def facts(
    scenario: Scenario, options: Options, port: str = "", *, placed: bool = False
) -> dict[str, object]:
    """What an agent may be launched with, by the names of parameters; None: nothing is said.

    `social.` is for whoever competes for the wheels; the rest for whoever declares it
    (`Agent.launched_with`), whoever wrote it.
    """
    x, y, theta = scenario.start
    return {
        "port": port or None,
        "namespace": options.namespace,
        "profile": scenario.robot,
        "x": x,
        "y": y,
        "theta": theta,
        "start_m": PLACED_M if placed else None,
        "start_rad": PLACED_RAD if placed else None,
        "world": None if unmapped(scenario) else scenario.world,  # they are to find out
        "v_max": scenario.v_max,
        "safety.unmapped": "true" if _unmapped_by_sonar(scenario) else None,
        "capacity_ah": scenario.battery.capacity_ah,
        "resume": options.resume,
        "controller": options.controller,
        "social.exchange": options.exchange,
        "social.margin": options.margin,
    }


def _unmapped_by_sonar(scenario: Scenario) -> bool:
    """Whether a robot drives by sonars through a world that it has no map of."""
    return scenario.plan == "seen" and load_profile(scenario.robot).laser is None


def _launched(
    names: Sequence[str], known: Mapping[str, object], options: Options
) -> tuple[Member, ...]:
    """The agents, set as the options' set of parameters and then the facts say."""
    given = load_set(options.parameters) if options.parameters else {}
    return tuple(Member(name, given.get(name, ()) + _settings(name, known)) for name in names)


def _settings(name: str, known: Mapping[str, object]) -> tuple[str, ...]:
    kind = agent_class(name)
    wanted = [*kind.launched_with]
    for fact in wanted:
        if fact not in known:
            message = f"{kind.__name__}.launched_with: {fact!r}; {advice(fact, known)}"
            raise ConfigNameError("fact", fact, known, message=message)
    if WHEELS in kind.competes_for:
        wanted += [fact for fact in known if fact.startswith("social.")]
    return tuple(f"{fact}={known[fact]}" for fact in wanted if known[fact] is not None)


def check(members: Sequence[Member]) -> None:
    """Raises ConfigError if an agent would refuse what is set of it."""
    for member in members:
        try:
            load_parameters(agent_class(member.name).parameters, None, member.sets)
        except ConfigError as error:
            raise ConfigError(f"{member.name}: {error}") from None


def processes(
    members: Sequence[Member], together: Sequence[Sequence[str]]
) -> dict[str, tuple[Member, ...]]:
    """The members of each process by its name: one alone, or those of a group that take part.

    Who is there twice has two processes: avoid, and avoid-2.
    """
    group_of = {name: "+".join(group) for group in together for name in group}
    found: dict[str, tuple[Member, ...]] = {}
    often: Counter[str] = Counter()
    for member in members:
        often[member.name] += 1
        label = group_of.get(member.name, member.name)
        if often[member.name] > 1:
            label += f"-{often[member.name]}"
        found[label] = (*found.get(label, ()), member)
    return found


def errand(scenario: Scenario, options: Options) -> Order | None:
    """What the robot is sent off for; None: it is not."""
    tasks = mission_of(scenario)
    if tasks is not None:
        return tasks.order(options.priority, "armadico mission run")
    ordering = installed(ERRANDS).get(scenario.plan or "")
    if ordering is not None and scenario.goal is not None:
        order: Order = ordering.load()(scenario)
        return order
    return mission(scenario)


def mission(scenario: Scenario) -> MissionRequest | None:
    """What the interface agent is asked for; None: nobody is sent anywhere."""
    if scenario.goal is None:
        return None
    return MissionRequest(
        goal=_waypoint(scenario.goal),
        waypoints=tuple(map(_waypoint, scenario.waypoints)) if scenario.plan == "waypoints" else (),
        planned=planned(scenario),
    )


def watch(
    scenario: Scenario, options: Options, mode: str, namespace: str | None = None
) -> RunWatch:
    known = conditions(scenario, options, mode, namespace)
    return RunWatch(scenario.name, scenario.goal, options.seed, known)


def conditions(
    scenario: Scenario, options: Options, mode: str, namespace: str | None = None
) -> Conditions:
    """What the run's result depends on besides its seed."""
    taking = names(scenario, options.without)
    driven = {**to_builtins(scenario), "agents": taking}
    unnamed = replace(
        scenario, name="", title="", seed=0, world="", robot="", mission="", agents=()
    )
    tasks = mission_of(scenario)
    brought = packages(find(AGENTS, name).package for name in taking)
    return Conditions(
        mode=mode,
        namespace=None if mode == VIRTUAL else namespace,
        robot=options.robot,
        scenario=driven,
        scenario_hash=digest((unnamed, taking, *(() if tasks is None else (tasks.text,)))),
        world_hash=digest(replace(load_world(scenario.world), name="")),
        profile_hash=digest(load_profile(scenario.robot)),
        agents={} if mode == ATTACHED else {m.name: m.sets for m in members(scenario, options, "")},
        software=replace(software(), packages=software().packages | brought),
    )


def time_limit(length: float, options: Options, tasks: Mission | None = None) -> float:
    """Seconds that a run may take: as asked, or 5 times the way over 0.3 m/s, at least 60 s.

    A mission of several tasks may take as long as it says itself.
    """
    if options.limit is None and tasks is not None:
        return MISSION_S if tasks.timeout_s is None else tasks.timeout_s + LIMIT_LEAST
    return options.limit or max(LIMIT_FACTOR * length / LIMIT_SPEED, LIMIT_LEAST)


def _waypoint(pose: tuple[float, float, float]) -> Waypoint:
    return Waypoint(*pose)
