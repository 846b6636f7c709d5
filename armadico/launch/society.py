"""A scenario as a list of agents with their parameters.

The same list is launched as real processes (`armadico.launch.local`) or on the virtual mesh
(`armadico.launch.virtual`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path

from msgspec import to_builtins
from msgspec.structs import replace

from armadico.config.errands import Mission
from armadico.config.hosts import Host, HostTable
from armadico.config.loading import load_parameters
from armadico.config.needs import needs, tasks
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
    with_slam,
)
from armadico.config.shipped import counted_from
from armadico.config.slots import slot
from armadico.config.worlds import load_world
from armadico.core.agent import DeviceAgent, Identity
from armadico.core.config_errors import ConfigError, ConfigNameError, advice
from armadico.core.discovery import AGENTS, ERRANDS, agent_class, find, installed, owners
from armadico.core.discovery import agents as installed_agents
from armadico.core.individual import Individual
from armadico.core.mechanisms import (
    Coordination,
    all_coordinations,
    coordinations,
    decides,
    differing,
    idle,
    lacks,
    preset_of,
    rivalled,
    vain,
)
from armadico.core.parameters import names_set
from armadico.core.resources import WHEELS
from armadico.launch.options import Options as Options  # noqa: PLC0414 - for importers
from armadico.mobile.errand import Order
from armadico.mobile.messages import MissionRequest, Waypoint
from armadico.observe.conditions import Conditions, digest, packages, software
from armadico.observe.contention import Contention
from armadico.observe.measures import RunWatch
from armadico.runtime.blame import attributed

VIRTUAL, LIVE, ATTACHED = "virtual", "live", "attached"
"""The modes of a run."""

NOWHERE = Scenario(world="empty", start=(0, 0, 0), plan="seen")
"""The default scenario, without a map."""

LIMIT_SPEED = 0.3
LIMIT_FACTOR = 5.0
LIMIT_LEAST = 60.0
MISSION_S = 3600.0
"""Default time limit of a mission of several tasks, s."""


@dataclass(frozen=True)
class Member:
    """One agent of the society, with its settings (`--set`)."""

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
    change: Callable[[Scenario], Scenario] | None = None,
) -> Scenario:
    """The scenario with the options, poses (m, m, rad), profile and mission applied.

    `change` comes last, such as `exploring`; agents that it removes cannot be added by `options`.
    Raises ConfigError if it cannot be driven, UnknownNameError for an agent that is not installed.
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
        unseen=options.unseen or scenario.unseen,
    )
    for name in (*scenario.agents, *options.without):
        find(AGENTS, name)
    required: Sequence[str] = ()
    if change is not None:
        scenario = change(scenario)
        required = necessary(scenario)
    _, *others = names(scenario)
    for name in options.besides:
        if name not in scenario.agents:
            taking = ", ".join(others)
            raise ConfigError(f"with {name}: it has no part in an exploration by {taking}")
    free = [name for name in others if name not in required]
    for name in options.without:
        if name not in free:
            taking = ", ".join(free)
            raise ConfigError(f"without {name}: {scenario.name} can be without {taking}")
    scenario = coordinated(scenario, options)
    if any((options.controller, options.parameters, options.sets, options.exchange, options.told)):
        check(started := members(scenario, options, ""))
        for error in strangers(started):
            raise error
    if options.coordination or options.parameters or options.sets:
        check_decided(members(scenario, options, ""), options)
    return scenario


def coordinated(scenario: Scenario, options: Options) -> Scenario:
    """The scenario with the arbiters of the chosen coordinations, if they have any.

    Raises UnknownNameError, and ConfigError if an agent lacks what a coordination needs.
    """
    taking = names(scenario, options.without)
    more = checked_arbiters(options, taking, taking)
    more = tuple(arbiter for arbiter in more if arbiter not in scenario.agents)
    return replace(scenario, agents=(*scenario.agents, *more)) if more else scenario


def checked_arbiters(
    options: Options, taking: Sequence[str], everywhere: Collection[str]
) -> tuple[str, ...]:
    """The arbiters of the chosen coordinations, which may have none.

    The agents of this host are `taking`, those of all hosts `everywhere`. Raises UnknownNameError,
    and ConfigError if one of the agents lacks what a coordination needs, if two decide about the
    same, or one about nothing, or another arbiter takes part.
    """
    known = coordinations(options.coordination)
    found = tuple(each.arbiter for each in known.values() if each.arbiter)
    deciding = {each.arbiter for each in all_coordinations().values()}
    for name in taking:
        if name in deciding and name not in found:
            mechanism = f"--coordination {options.coordination}" if known else "ballots"
            raise ConfigError(
                f"agent {name} is the arbiter of another mechanism than {mechanism}, which is"
                " chosen: leave it out, or choose its own"
            )
    if options.told and not found:
        raise ConfigError("--told needs a --coordination with an arbiter, such as auction")
    if not known:
        return ()
    for arbiter in found:
        find(AGENTS, arbiter)
    driving = {
        name: agent_class(name) for name in taking if WHEELS in agent_class(name).competes_for
    }
    here = installed(AGENTS)
    strange = any(name not in here for name in everywhere)  # what those compete for is unknown
    agents = {name: agent_class(name) for name in everywhere if name in here}
    by: dict[str, str] = {}
    for name, each in known.items():
        about = decides(each)
        if about and (other := by.setdefault(about, name)) != name:
            raise ConfigError(f"--coordination: {other} and {name} both decide about {about}")
        if wrong := lacks(each, driving) or ("" if strange else _idle(each, agents)):
            raise ConfigError(f"--coordination {name}: {wrong}")
    return found


def check_decided(members: Sequence[Member], options: Options, *, whole: bool = True) -> None:
    """Raises ConfigError if a chosen coordination decides nothing among all agents of a society.

    Their settings count, by which each may have chosen one, and what they know of the world. It
    raises the same for agents that compete for the same by different mechanisms, or that lack what
    theirs needs, which is all that it checks unless the members are the `whole` society.
    """
    competing = {}
    for member in members:
        kind = agent_class(member.name)
        if kind.competes_for or kind.competes_later:
            given = load_parameters(kind.parameters, None, member.sets)
            identity = Identity(member.name)
            with attributed(kind):
                competing[member.name] = kind(identity, given)
    if different := differing(competing):
        raise ConfigError(f"{different}; choose for all of them: --coordination NAME")
    driving = {name: type(one) for name, one in competing.items() if WHEELS in one.competes_for}
    known = coordinations(options.coordination)
    for agent in competing.values():
        known |= coordinations(agent.p.social.coordination)
    own = {resource.name for agent in competing.values() for resource in agent.competes_for}
    for name, each in known.items():
        wrong = lacks(each, driving) or (vain(each, competing) if whole else "")
        # That of tasks and passages, which exist only later, may be in another robot's society.
        lost = each.arbiter not in {"", *competing} and decides(each) in own
        if not wrong and whole and lost:
            wrong = f"its arbiter {each.arbiter} takes no part; choose it for all: --coordination"
        if wrong:
            raise ConfigError(f"--coordination {name}: {wrong}")


def rivals_elsewhere(
    scenario: Scenario | None, options: Options, host: str, table: HostTable
) -> tuple[str, ...]:
    """The agents of a society that compete for something, or may, on other hosts than `host`.

    What an agent that is not installed here competes for is unknown.
    """
    taking = None if scenario is None else names(scenario, options.without)
    here = installed(AGENTS)
    elsewhere = (name for at, it in table.hosts.items() if at != host for name in it.agents)
    return tuple(
        name
        for name in dict.fromkeys(elsewhere)
        if name not in options.without and (taking is None or name in taking)
        if name not in here or rivalled(agent_class(name))
    )


def _idle(each: Coordination, agents: Mapping[str, type[Individual]]) -> str:
    """Why a coordination has nothing to decide here, and which agents would change that."""
    why = idle(each, agents)
    if not why or hasattr(each, "where"):
        return why
    deciding = {other.arbiter for other in all_coordinations().values()}
    able = [
        n for n, cls in installed_agents() if n not in deciding if decides(each) in rivalled(cls)
    ]
    return f"{why}; add one that does (--with): {', '.join(able)}" if able else why


def arbiters(
    scenario: Scenario | None, options: Options, here: Sequence[str], table: HostTable
) -> tuple[str, ...]:
    """The arbiters that a host starts beside its share; in a redundant society two of each.

    An arbiter that no host of the table has runs beside the robot agent. Raises as
    `checked_arbiters`.
    """
    placed = _placed(table)
    taken = () if scenario is None else names(scenario, options.without)
    everywhere = {*here, *taken, *(placed - {*options.without})}
    found = [each for each in checked_arbiters(options, here, everywhere) if each not in placed]
    if next(owners(here, WHEELS), None) is None:
        return ()
    twice = scenario is not None and scenario.redundant
    return tuple(each for each in found for _ in range(1 + twice))


def with_arbiters(scenario: Scenario, options: Options, table: HostTable) -> Scenario:
    """The scenario with those arbiters that a host of the table has: they take part by its choice.

    Raises UnknownNameError.
    """
    chosen = {each.arbiter for each in coordinations(options.coordination).values()}
    more = tuple(sorted((chosen & _placed(table)) - {*scenario.agents}))
    return replace(scenario, agents=(*scenario.agents, *more))


def _placed(table: HostTable) -> set[str]:
    return {name for host in table.hosts.values() for name in host.agents}


def profile_of(name: str | None) -> str | None:
    """The profile given on the command line; a path is relative to the current folder."""
    return None if name is None else counted_from(Path.cwd() / "command line", name)


def names(scenario: Scenario, without: Sequence[str] = ()) -> tuple[str, ...]:
    """The participating agents; the robot agent, which owns the wheels, comes first.

    In a redundant society each agent that competes for the wheels is listed twice.
    """
    robot = next(owners(scenario.agents, WHEELS), society().robot)
    agents = sensing(scenario.agents, scenario.robot)
    others = [name for name in agents if name not in (robot, *without)]
    if scenario.redundant:
        others = [
            name for name in others for _ in range(1 + (WHEELS in agent_class(name).competes_for))
        ]
    return (robot, *others)


def members(scenario: Scenario, options: Options, port: str) -> tuple[Member, ...]:
    """The agents of a run, the robot agent first; `port` is the address of the controller."""
    known = options.robot is None  # the simulator sets the start pose
    told = facts(scenario, options, port, placed=known)
    return with_sets(_launched(names(scenario, options.without), told, options), options.sets)


def share(
    scenario: Scenario | None, options: Options, host: Host, more: Sequence[str] = ()
) -> tuple[Member, ...]:
    """The agents of one host: those of its entry that take part, and `more`.

    Without a scenario all agents of the entry take part. The monitoring agents always do.
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
    """The agents that a host can start in place of a failed host, or for driving by hand.

    Device agents are not among them, since their device is on one host.
    """
    by_hand = slot("by-hand").besides
    placed = dict.fromkeys(name for other in table.hosts.values() for name in other.agents)
    taken = placed if scenario is None else (*names(scenario, options.without), *society().watch)
    here = installed(AGENTS)
    able = [
        name
        for name in dict.fromkeys((*taken, *by_hand))
        if name in (*placed, *by_hand)
        and name in here
        and (host.takes is None or name in host.takes)
        if name not in host.agents and not issubclass(agent_class(name), DeviceAgent)
    ]
    scenario = scenario or NOWHERE
    return _launched(able, facts(scenario, options), options, together=False)


def necessary(scenario: Scenario) -> tuple[str, ...]:
    """The agents without which a robot does not do the tasks of a scenario."""
    return sensing(_mapped(scenario, needs(tasks(scenario))), scenario.robot)


def needed(scenario: Scenario | None, options: Options, table: HostTable) -> tuple[str, ...]:
    """The participating agents of all hosts that a scenario needs."""
    placed = {name for other in table.hosts.values() for name in other.agents}
    if scenario is None:
        return tuple(name for name in needs(tasks(None)) if name in placed)
    robot, *others = names(scenario, options.without)
    needed = necessary(scenario)
    wanted = (robot, *(name for name in needed if name in others))
    return tuple(name for name in wanted if name in placed)


def least(scenario: Scenario) -> Scenario:
    """The scenario with only the agents that its tasks need or use."""
    robot, *_ = names(scenario)
    taking = sensing(_mapped(scenario, needs(tasks(scenario), helps=True)[1:]), scenario.robot)
    return replace(scenario, agents=(robot, *(name for name in taking if name != robot)))


def _mapped(scenario: Scenario, needed: Sequence[str]) -> Sequence[str]:
    """The agents that are needed, where slam takes part with slam in place of others."""
    by_slam = set(slot("slam").besides) <= set(scenario.agents)
    return with_slam(needed) if by_slam else needed


PLACED_M, PLACED_RAD = 0.05, radians(2.0)
"""Standard deviations of a simulator's start pose. A person places a robot less exactly; then the
agents' defaults apply."""


def facts(
    scenario: Scenario, options: Options, port: str = "", *, placed: bool = False
) -> dict[str, object]:
    """The facts of a run by the names of parameters; None: not known.

    An agent that competes for the wheels receives those of `social.`, one that competes for another
    resource those of its mechanism; of the others each agent receives those in its
    `Agent.launched_with`.
    """
    x, y, theta = scenario.start
    return {
        "port": port or None,
        "simulator": options.simulator or None,
        "namespace": options.namespace,
        "profile": scenario.robot,
        "x": x,
        "y": y,
        "theta": theta,
        "exact": "true" if scenario.sensors == society().ideal.sensors else None,
        "start_m": PLACED_M if placed else None,
        "start_rad": PLACED_RAD if placed else None,
        "world": None if unmapped(scenario) else scenario.world,
        "v_max": scenario.v_max,
        "unseen": scenario.unseen,
        "safety.unmapped": "true" if _unmapped_by_sonar(scenario) else None,
        "capacity_ah": scenario.battery.capacity_ah,
        "resume": options.resume,
        "controller": options.controller,
        "social.exchange": options.exchange,
        "social.margin": options.margin,
        "social.coordination": options.coordination,
        "social.told": options.told,
    }


def _unmapped_by_sonar(scenario: Scenario) -> bool:
    """Whether a robot without a laser drives in a world without a map."""
    return scenario.plan == "seen" and load_profile(scenario.robot).laser is None


def _launched(
    names: Sequence[str],
    known: Mapping[str, object],
    options: Options,
    *,
    together: bool = True,
) -> tuple[Member, ...]:
    """The agents with the settings of the set of parameters and of the facts."""
    if together:
        check_rivals(names)
    given = load_set(options.parameters) if options.parameters else {}
    preset = preset_of(options.coordination)
    return tuple(
        Member(name, preset.get(name, ()) + given.get(name, ()) + _settings(name, known))
        for name in names
    )


def with_sets(members: Sequence[Member], sets: Sequence[str]) -> tuple[Member, ...]:
    """The members with single parameters, AGENT.KEY=VALUE, which `check` then checks.

    Raises ConfigError for another form, and for an agent that is not among them.
    """
    here = dict.fromkeys(member.name for member in members)
    given: dict[str, tuple[str, ...]] = {}
    for each in sets:
        name, dot, rest = each.partition(".")
        if not dot or "=" not in rest:
            raise ConfigError(f"--set {each}: expected AGENT.KEY=VALUE, as in avoid.v_max=0.3")
        if name not in here:
            raise ConfigError(
                f"--set {each}: agent {name} is not started here (started: {', '.join(here)})"
            )
        given[name] = (*given.get(name, ()), rest)
    return tuple(Member(m.name, (*m.sets, *given.get(m.name, ()))) for m in members)


def _settings(name: str, known: Mapping[str, object]) -> tuple[str, ...]:
    kind = agent_class(name)
    wanted = [*kind.launched_with]
    for fact in wanted:
        if fact not in known:
            message = f"{kind.__name__}.launched_with: {fact!r}; {advice(fact, known)}"
            raise ConfigNameError("fact", fact, known, message=message)
    if WHEELS in kind.competes_for:
        wanted += [fact for fact in known if fact.startswith("social.")]
    elif kind.competes_for:
        wanted += ["social.coordination", "social.told"]
    return tuple(f"{fact}={known[fact]}" for fact in wanted if known[fact] is not None)


def check_rivals(names: Sequence[str]) -> None:
    """Raises ConfigError for slam beside an agent that publishes the same messages."""
    slam = next((name for name in slot("slam").besides if name in names), None)
    if slam is None:
        return
    for name in names:
        if name != slam and {*agent_class(name).provides} & {*agent_class(slam).provides}:
            raise ConfigError(
                f"agents {slam} and {name}: both publish the pose's correction or the map; leave"
                f" one of them out (--without {name})"
            )


def check(members: Sequence[Member]) -> None:
    """Raises ConfigError if an agent would reject its settings."""
    for member in members:
        try:
            load_parameters(agent_class(member.name).parameters, None, member.sets)
        except ConfigError as error:
            raise error.at(None, before=f"{member.name}: {error.file}: ") from None


def strangers(members: Sequence[Member]) -> Iterator[ConfigNameError]:
    """What is wrong with settings that name agents which are not installed here.

    For a run they are errors. An agent of another computer need not be installed on this one.
    """
    for member in dict.fromkeys(members):
        given = load_parameters(agent_class(member.name).parameters, None, member.sets)
        for name, at in names_set(given).items():
            if name not in (known := installed(AGENTS)):
                text = f"{member.name}: {at} names {name!r}, which is no installed agent"
                message = f"{text}; {advice(name, known)}"
                yield ConfigNameError("agent", name, known, message=message)


def processes(
    members: Sequence[Member], together: Sequence[Sequence[str]]
) -> dict[str, tuple[Member, ...]]:
    """The members of each process by its label: one agent, or the members of a group.

    A redundant agent has two processes: avoid and avoid-2.
    """
    group_of = {name: "+".join(group) for group in together for name in group}
    found: dict[str, tuple[Member, ...]] = {}
    counts: Counter[str] = Counter()
    for member in members:
        counts[member.name] += 1
        label = group_of.get(member.name, member.name)
        if counts[member.name] > 1:
            label += f"-{counts[member.name]}"
        found[label] = (*found.get(label, ()), member)
    return found


def errand(scenario: Scenario, options: Options) -> Order | None:
    """The order of a run, or None if the robot is not sent anywhere."""
    tasks = mission_of(scenario)
    if tasks is not None:
        return tasks.order(options.priority, "armadico mission run")
    ordering = installed(ERRANDS).get(scenario.plan or "")
    if ordering is not None and scenario.goal is not None:
        order: Order = ordering.load()(scenario)
        return order
    return mission(scenario)


def mission(scenario: Scenario) -> MissionRequest | None:
    """The request to the interface agent, or None without a goal."""
    if scenario.goal is None:
        return None
    waypoints = scenario.waypoints if scenario.plan == "waypoints" else ()
    return MissionRequest(
        goal=Waypoint(*scenario.goal),
        waypoints=tuple(Waypoint(*each) for each in waypoints),
        planned=planned(scenario),
        by="armadico run",
    )


def watch(
    scenario: Scenario, options: Options, mode: str, namespace: str | None = None
) -> RunWatch:
    known = conditions(scenario, options, mode, namespace)
    unplaced = scenario.plan == "frontiers" and not load_world(scenario.world).outlines
    found = RunWatch(scenario.name, scenario.goal, options.seed, known, unplaced)
    found.contention = Contention(mechanisms(known.agents))
    return found


def mechanisms(agents: Mapping[str, Sequence[str]]) -> dict[str, Coordination]:
    """The mechanisms that agents were started with, by the settings of each; none by ballots."""
    setting, found = "social.coordination=", dict[str, Coordination]()
    for sets in agents.values():
        for each in sets:
            if each.startswith(setting):
                found |= coordinations(each.removeprefix(setting))
    return found


def conditions(
    scenario: Scenario, options: Options, mode: str, namespace: str | None = None
) -> Conditions:
    """All that the result depends on besides the seed."""
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
    """The time limit, s: the option, or 5 times the path length at 0.3 m/s, at least 60 s.

    A mission of several tasks has its own.
    """
    if options.limit is None and tasks is not None:
        return MISSION_S if tasks.timeout_s is None else tasks.timeout_s + LIMIT_LEAST
    return options.limit or max(LIMIT_FACTOR * length / LIMIT_SPEED, LIMIT_LEAST)
