"""The options of commands that drive in a scenario, and their checks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.additions import Addition, Start, changed
from armadico.cli.options import FailedError, Mesh, UsageError
from armadico.cli.parsing import (
    POSE,
    argument,
    at_least,
    between,
    flag,
    group,
    more_than,
    option,
    several,
)
from armadico.core.unseen import Rule

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario, ScenarioPose
    from armadico.launch.society import Options

STARTING: Final = (
    "virtual",
    "seed",
    "controller",
    "parameters",
    "set",
    "exchange",
    "redundant",
    "runs",
    "robot",
    "profile",
    "sensors",
    "unseen",
    "world",
    "together",
)
"""Options of commands that start the society; not for `--attach`."""

PICTURES: Final = (".pgm", ".png")
"""Suffixes of a map's image, which its .yaml names."""

X_Y_DEG: Final = ("X", "Y", "DEG")

SEED: Final = between(0, 2**63 - 1, "expected 0 to 2^63 - 1")


def set_option() -> Any:
    """The field of the parameters that are set one by one."""
    return several("set one parameter of one agent; may be repeated", metavar="AGENT.KEY=VALUE")


@dataclass(frozen=True, kw_only=True)
class Drive:
    """The options of every command that drives.

    The fields without an option belong to derived commands, which declare them.
    """

    goal: tuple[float, float, float] | None = None
    robots: int | None = None
    replace: bool = False
    mission: str | None = None
    scenario: str | None = argument(
        "a scenario's name, a TOML file, or a map as --world", nargs="?"
    )
    world: str | None = option(
        "drive in this world (.map, .yaml) instead of a scenario", metavar="MAP"
    )
    start: tuple[float, float, float] | None = option(
        "start at this pose: m, m, degrees (default: the scenario's)", metavar=X_Y_DEG, must=POSE
    )
    limit: float | None = option(
        "time limit (default: from the path's length; without a goal: 60 s)",
        "--for",
        metavar="S",
        must=more_than(0, "expected a number of seconds, more than 0 and finite"),
    )
    virtual: bool = flag("run in one process under a virtual clock")
    seed: int | None = option("seed of random numbers (default: 0)", metavar="N", must=SEED)
    controller: str | None = option(
        "controller of agents that have several: fast, precise, ... (default: the agent's)",
        metavar="NAME",
    )
    parameters: str | None = option(
        "a set of agents' parameters: thesis, brisk, swift, or a TOML file (default: none)",
        metavar="SET",
    )
    set: tuple[str, ...] = set_option()
    exchange: str | None = option(
        "how resources change hands (default: smooth)", choices=("abrupt", "smooth")
    )
    without: tuple[str, ...] = several("leave out an agent; may be repeated", metavar="AGENT")
    besides: tuple[str, ...] = several("add an agent; may be repeated", "--with", metavar="AGENT")
    sensors: str | None = option(
        "sensors of the simulated robot: real; glass: a laser sees through some walls; ideal:"
        " almost no errors, and no localization agent (default: the scenario's)",
        metavar="NAME",
    )
    unseen: Rule | None = options.unseen_option("the scenario's, else the map file's, else drive")
    redundant: bool = flag("run two of each behaviour, so that any one may fail")
    together: tuple[str, ...] = several(
        "live: run these agents in one process; may be repeated", metavar="A+B"
    )
    runs: int | None = option(
        "drive N times with successive seeds (default: once)", metavar="N", must=at_least(1)
    )
    json: bool = flag("print one JSON object; of several runs: runs, judgement, mean, deviation")
    accept_unknown: bool = flag(
        "return 0 instead of 3 for a run whose result is unknown, as on a real robot, of which"
        " nothing counts collisions"
    )
    robot: str | None = option(
        "drive the robot at this address (default: start a simulator)", metavar="URL"
    )
    simulator: str | None = option(
        "the id that the simulator at --robot prints, whose truth is then this robot's (default:"
        " the name of the robot's controller)",
        metavar="ID",
    )
    profile: str | None = option(
        "the robot's profile: a shipped name, or a file (default: the scenario's)", metavar="NAME"
    )
    attach: bool = flag(
        "drive with a running society, here or elsewhere; Ctrl-C only stops the robot"
    )
    additions: tuple[Addition, ...] = ()
    priority: float | None = None
    resume: str | None = None
    mesh: Mesh = group(Mesh, "the mesh")

    @property
    def anywhere(self) -> bool:
        """Whether it may drive without a scenario or a world, in the empty world."""
        return self.limit is not None or self.goal is not None

    def starting(self, scenario: Scenario, seeds: Sequence[int], *, alone: bool = True) -> Start:
        """The start of a run as the additions see it; `alone`: of one robot."""
        return Start(
            scenario=scenario,
            mesh=self.mesh,
            namespaces=(self.mesh.namespace,),
            alone=alone,
            virtual=self.virtual,
            limit=self.limit,
            seeds=seeds,
            seed=seeds[0],
            series=self.runs is not None,
        )

    def chosen(self) -> Options:
        """The options that change the scenario."""
        from armadico.launch.society import Options

        return Options(
            controller=self.controller,
            exchange=self.exchange,
            parameters=self.parameters,
            sets=self.set,
            without=self.without,
            besides=self.besides,
            sensors=self.sensors,
            unseen=self.unseen,
            redundant=self.redundant,
            together=tuple(tuple(group.split("+")) for group in self.together),
            robot=self.robot,
            simulator=self.simulator or "",
            resume=self.resume,
            limit=self.limit,
            priority=self.priority,
        )


def choose(
    args: Drive,
    *,
    somewhere: bool = True,
    mission: str | None = None,
    change: Callable[[Scenario], Scenario] | None = None,
) -> tuple[Scenario, Options]:
    """The scenario and the options of the command line, checked.

    With `somewhere`, warnings are printed if the robot will not get anywhere. A `mission` replaces
    the scenario's goal or mission; for `change` see `prepared`. Raises UsageError, ConfigError,
    UnknownNameError or FailedError.
    """
    chosen = changed(args.additions, args.chosen())
    scenario = _scenario(args, chosen, somewhere=somewhere, mission=mission, change=change)
    return scenario, chosen


def _scenario(
    args: Drive,
    chosen: Options,
    *,
    somewhere: bool,
    mission: str | None,
    change: Callable[[Scenario], Scenario] | None,
) -> Scenario:
    """The scenario of the command line. Raises UsageError, ConfigError or UnknownNameError."""
    from armadico.config.scenarios import blind, load_scenario, scenario_from
    from armadico.launch.society import names, prepared, profile_of

    if args.scenario is not None and args.world is not None:
        raise UsageError("name a scenario or a world, not both")
    if both := sorted({*args.besides} & {*args.without}):
        raise UsageError(f"--with {both[0]} --without {both[0]}: use one of them")
    if args.robot is not None and args.virtual:
        raise UsageError("--robot is for live runs; --virtual has its own simulator")
    for name, given in _way(args) if args.virtual else ():
        if given:
            raise UsageError(f"{name}: not with --virtual, which runs in one process")
    if args.simulator is not None and args.robot is None:
        raise UsageError("--simulator is for the simulator at the address of --robot")
    if args.robot is not None:
        _check_robot(args.robot)
    _check_attach(args)
    start, goal = pose(args.start), pose(args.goal)
    world = _world(args)
    if world is not None:
        scenario = scenario_from(world, start, goal, profile_of(args.profile))
        start = goal = None
    else:
        assert args.scenario is not None, "else a world is named"
        scenario = load_scenario(args.scenario)
    scenario = prepared(
        scenario,
        chosen,
        start=start,
        goal=goal,
        profile=args.profile,
        mission=mission,
        change=change,
    )
    _check_together(args, names(scenario))
    if somewhere and blind(scenario):
        why = "a wall is between start and goal, and no path is planned"
        options.report(f'{scenario.name}: {why}; plan = "rooms" plans one')
    if somewhere and scenario.goal is None and scenario.mission is None and not scenario.tasks:
        todo = "" if args.virtual else "; armadico goto X Y sends the robot to one"
        options.report(f"{scenario.name}: no goal{todo}")
    return scenario


def _way(args: Drive) -> tuple[tuple[str, object], ...]:
    """The options for the way to the robot, and what was given."""
    mesh = args.mesh
    return ("--host", mesh.host), ("--hosts", mesh.hosts), ("--connect", mesh.connect)


def _world(args: Drive) -> str | None:
    """The world given instead of a scenario, or the empty one. Raises UsageError."""
    from armadico.config.worlds import READERS

    named: str | None = args.world
    if args.scenario is None and named is None:
        if not args.anywhere:
            raise UsageError("name a scenario (armadico run sc4), a map, or a time (--for 60)")
        return "empty"
    if args.scenario is None or Path(args.scenario).suffix not in {*READERS, *PICTURES}:
        return named
    scenario: str = args.scenario
    return scenario


def _check_robot(url: str) -> None:
    """Raises UsageError for an invalid address, FailedError if the serial port does not exist."""
    from armadico.config.hosts import robot_fault, serial_port
    from armadico.config.loading import names

    fault = robot_fault(url)
    if url in names("robots"):
        raise UsageError(
            f"--robot {url}: expected the address of a real robot; --profile {url} simulates one"
        )
    if fault is not None:
        raise UsageError(f"--robot {url!r}: {fault}")
    port = serial_port(url)
    if port is not None and not port.exists():
        raise FailedError(
            f"--robot {url}: no such port; is the adapter plugged in? `armadico doctor` lists the"
            " ports"
        )


def _check_attach(args: Drive) -> None:
    for name in STARTING if args.attach else ():
        if getattr(args, name):
            raise UsageError(f"--{name}: not with --attach, which starts no agents")


def check_connect(args: Drive) -> None:
    """Raises UsageError for a router, if the run starts its own."""
    if args.mesh.connect and not args.attach:
        raise UsageError("--connect is for --attach; otherwise the run starts its own router")


def pose(given: tuple[float, float, float] | None) -> ScenarioPose | None:
    """An option's pose with its heading in rad instead of degrees; None for None."""
    return None if given is None else (given[0], given[1], radians(given[2]))


def _check_together(args: Drive, taking: Sequence[str]) -> None:
    """Raises UsageError for a group that cannot share a process."""
    named: list[str] = []
    for chosen in args.together:
        names = chosen.split("+")
        strangers = [name for name in names if name not in taking]
        if args.virtual:
            raise UsageError(f"--together {chosen}: with --virtual all agents share one process")
        if strangers:
            raise UsageError(f"--together {chosen}: {strangers[0]!r} does not take part")
        if len(names) < 2 or set(names) & set(named) or len(set(names)) < len(names):
            raise UsageError(f"--together {chosen}: expected at least two agents, each once")
        named += names
