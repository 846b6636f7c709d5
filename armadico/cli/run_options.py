"""The options of commands that drive in a scenario, and their checks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.additions import Addition, Start, changed
from armadico.cli.options import FailedError, Mesh, UsageError
from armadico.cli.parsing import argument, at_least, flag, given, group, option
from armadico.launch.options import Choices, Options

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario

STARTING: Final = {
    *("--virtual", "--seed", "--controller", "--parameters", "--set", "--exchange"),
    *("--coordination", "--told"),
    *("--redundant", "--runs", "--robot", "--profile", "--sensors", "--unseen", "--world"),
    "--together",
}
"""Options of commands that start the society; not for `--attach`."""

PICTURES: Final = (".pgm", ".png")
"""Suffixes of a map's image, which its .yaml names."""


@dataclass(frozen=True, kw_only=True)
class Drive(Choices):
    """The options of every command that drives; see `Choices`."""

    robots: int | None = None
    replace: bool = False
    mission: str | None = None
    scenario: str | None = argument(
        "a scenario's name, a TOML file, or a map as --world", nargs="?"
    )
    world: str | None = option(
        "drive in this world (.map, .yaml) instead of a scenario", metavar="MAP"
    )
    runs: int | None = option(
        "drive N times with successive seeds (default: once)", metavar="N", must=at_least(1)
    )
    json: bool = flag("print one JSON object; of several runs: runs, judgement, mean, deviation")
    accept_unknown: bool = options.accept_option(
        "a run whose result is unknown, as on a real robot, of which nothing counts collisions"
    )
    attach: bool = flag(
        "drive with a running society, here or elsewhere; Ctrl-C only stops the robot"
    )
    additions: tuple[Addition, ...] = ()
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
    chosen = changed(args.additions, Options.of(args, args.seed or 0))
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
    for name, value in _way(args) if args.virtual else ():
        if value:
            raise UsageError(f"{name}: not with --virtual, which runs in one process")
    if args.simulator and args.robot is None:
        raise UsageError("--simulator is for the simulator at the address of --robot")
    if args.robot is not None:
        _check_robot(args.robot)
    _check_attach(args)
    start, goal = args.start, args.goal
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
    for name in given(args) if args.attach else ():
        if name in STARTING:
            raise UsageError(f"{name}: not with --attach, which starts no agents")


def check_connect(args: Drive) -> None:
    """Raises UsageError for a router, if the run starts its own."""
    if args.mesh.connect and not args.attach:
        raise UsageError("--connect is for --attach; otherwise the run starts its own router")


def _check_together(args: Drive, taking: Sequence[str]) -> None:
    """Raises UsageError for a group that cannot share a process."""
    named: list[str] = []
    for names in args.together:
        chosen = "+".join(names)
        strangers = [name for name in names if name not in taking]
        if args.virtual:
            raise UsageError(f"--together {chosen}: with --virtual all agents share one process")
        if strangers:
            raise UsageError(f"--together {chosen}: {strangers[0]!r} does not take part")
        if len(names) < 2 or set(names) & set(named) or len(set(names)) < len(names):
            raise UsageError(f"--together {chosen}: expected at least two agents, each once")
        named += names
