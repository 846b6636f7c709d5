"""A scenario as a list of processes: who takes part, and with what parameters.

The same list is launched as real processes (`armadico.launch.local`) or put on the virtual mesh
(`armadico.launch.virtual`), so that both are the same society.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path

from msgspec.structs import replace

from armadico.config.discovery import AGENTS, agent_class, find
from armadico.config.errors import ConfigError
from armadico.config.hosts import Host
from armadico.config.parameters import load_set
from armadico.config.scenarios import PoseDeg, Scenario, beside, scenario_from
from armadico.config.shipped import find as shipped
from armadico.core.agent import Agent
from armadico.core.messages import MissionRequest, Waypoint
from armadico.core.resources import WHEELS
from armadico.observe.measures import RunWatch

ROBOT = "robot"
LIMIT_SPEED = 0.3
LIMIT_FACTOR = 5.0
LIMIT_LEAST = 60.0


@dataclass(frozen=True)
class Options:
    """What the command line may change about a scenario."""

    seed: int = 0
    controller: str | None = None
    exchange: str | None = None
    parameters: str | None = None  # a set of them, by name or path
    without: tuple[str, ...] = ()
    robot: str | None = None  # the URL of something that is already there
    together: tuple[tuple[str, ...], ...] = ()  # agents that share a process
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
    start: PoseDeg | None = None,
    goal: PoseDeg | None = None,
    profile: str | None = None,
) -> Scenario:
    """The scenario with what was chosen for it: poses, and the make of robot.

    Raises ConfigError for what cannot be driven, UnknownNameError for an agent that nobody has.
    """
    if profile is not None:
        robot = beside(Path.cwd() / "command line", profile)  # a path counts from here
        shipped("robots", robot)
        scenario = replace(scenario, robot=robot)
    if start is not None or goal is not None:
        checked = scenario_from(scenario.world, start or scenario.start, goal or scenario.goal)
        scenario = replace(scenario, start=checked.start, goal=checked.goal)
    given = load_set(options.parameters) if options.parameters else {}
    for name in (*scenario.agents, *options.without, *given):
        find(AGENTS, name)
    for name in options.without:
        if name not in scenario.agents:
            taking = ", ".join(scenario.agents)
            raise ConfigError(f"without {name}: takes no part in {scenario.name} ({taking} do)")
    return scenario


def members(scenario: Scenario, options: Options, port: str) -> tuple[Member, ...]:
    """The agents of a run, the robot agent first; `port` is the URL of the robot's controller."""
    names = ["robot", *(name for name in scenario.agents if name not in options.without)]
    given = load_set(options.parameters) if options.parameters else {}
    return tuple(
        Member(name, given.get(name, ()) + _settings(name, scenario, options, port))
        for name in names
    )


def share(
    scenario: Scenario | None, options: Options, host: Host, more: Sequence[str] = ()
) -> tuple[Member, ...]:
    """The agents of one host: those of its entry that take part, and `more` beside them.

    Without a scenario all of the entry take part, with parameters of their own.
    """
    if scenario is None:
        here = tuple(name for name in host.agents if name != ROBOT)
        scenario = Scenario(world="empty", start=(0, 0, 0), goal=(0, 0, 0), agents=here)
    everybody = tuple(dict.fromkeys((*scenario.agents, *more)))
    known = {
        member.name: member
        for member in members(replace(scenario, agents=everybody), options, host.robot or "")
    }
    taking = {ROBOT, *scenario.agents} - set(options.without)
    names = [name for name in host.agents if name in taking]
    return tuple(known[name] for name in (*names, *more))


def _settings(name: str, scenario: Scenario, options: Options, port: str) -> tuple[str, ...]:
    x, y, degrees = scenario.start
    sets: list[str] = []
    if name == "robot":
        sets += [*([f"port={port}"] if port else []), f"profile={scenario.robot}"]
    elif name == "encoder":
        sets += [f"x={x}", f"y={y}", f"theta={radians(degrees)}"]
    elif name == "path-planning":
        sets += [f"world={scenario.world}", f"profile={scenario.robot}"]
    elif name == "goto" and options.controller is not None:
        sets.append(f"controller={options.controller}")
    social = [
        f"social.{key}={value}"
        for key, value in (("exchange", options.exchange), ("margin", options.margin))
        if value is not None
    ]
    if scenario.v_max is not None or social:
        sets += _driving(agent_class(name), scenario.v_max, social)
    return tuple(sets)


def _driving(kind: type[Agent], v_max: float | None, social: list[str]) -> list[str]:
    """What whoever competes for the wheels is told, whoever wrote it."""
    if WHEELS not in kind.competes_for:
        return []
    limited = v_max is not None and "v_max" in kind.parameters.__struct_fields__
    return [f"v_max={v_max}"] * limited + social


def processes(
    members: Sequence[Member], together: Sequence[Sequence[str]]
) -> tuple[tuple[Member, ...], ...]:
    """The members of each process: one alone, or those of a group that take part."""
    group_of = {name: tuple(group) for group in together for name in group}
    found: dict[tuple[str, ...], tuple[Member, ...]] = {}
    for index, member in enumerate(members):
        group = group_of.get(member.name, (member.name, str(index)))
        found[group] = (*found.get(group, ()), member)
    return tuple(found.values())


def mission(scenario: Scenario) -> MissionRequest:
    """What the interface agent is asked for."""
    return MissionRequest(
        goal=_waypoint(scenario.goal),
        waypoints=tuple(map(_waypoint, scenario.waypoints)) if scenario.plan == "waypoints" else (),
        planned=scenario.plan == "rooms",
    )


def watch(scenario: Scenario, options: Options) -> RunWatch:
    """Who measures the run."""
    return RunWatch(
        scenario.name,
        (scenario.goal[0], scenario.goal[1], radians(scenario.goal[2])),
        options.seed,
        tuple(name for name in scenario.agents if name not in options.without),
    )


def time_limit(length: float) -> float:
    """Seconds that a run may take: 5 times the way over 0.3 m/s, at least 60 s."""
    return max(LIMIT_FACTOR * length / LIMIT_SPEED, LIMIT_LEAST)


def _waypoint(pose: tuple[float, float, float]) -> Waypoint:
    return Waypoint(pose[0], pose[1], radians(pose[2]))
