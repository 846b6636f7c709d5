"""The options of whoever drives in a scenario, and what they name, checked before that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, Mesh, UsageError
from armadico.cli.parsing import (
    POSE,
    RECORDING,
    argument,
    at_least,
    between,
    flag,
    group,
    more_than,
    option,
    several,
)

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario, ScenarioPose
    from armadico.launch.society import Options

STARTING: Final = (
    "virtual",
    "seed",
    "controller",
    "parameters",
    "exchange",
    "redundant",
    "runs",
    "robot",
    "profile",
    "sensors",
    "world",
    "together",
)
"""Options that are for whoever starts the society."""

PICTURES: Final = (".pgm", ".png")
"""Of a map; its .yaml names it."""

X_Y_DEG: Final = ("X", "Y", "DEG")

SEED: Final = between(0, 2**63 - 1, "from 0 to 2^63 - 1")


@dataclass(frozen=True, kw_only=True)
class Drive:
    """What every command that drives takes: which run, of whom, how, and what is kept of it.

    The fields without an option are for the derived commands, which declare theirs.
    """

    goal: tuple[float, float, float] | None = None
    robots: int | None = None
    replace: bool = False
    mission: str | None = None
    scenario: str | None = argument(
        "a scenario's name, a TOML file, or a map as --world", nargs="?"
    )
    world: str | None = option("a world instead of a scenario: .map, .yaml", metavar="MAP")
    start: tuple[float, float, float] | None = option(
        "where the robot starts: m, m, degrees", metavar=X_Y_DEG, must=POSE
    )
    limit: float | None = option(
        "time limit; without a goal: 60",
        "--for",
        metavar="S",
        must=more_than(0, "expected seconds, more than none"),
    )
    virtual: bool = flag("one process, under a virtual clock")
    seed: int | None = option("seed of all that is random (default: 0)", metavar="N", must=SEED)
    controller: str | None = option(
        "of agents that have several: fast, precise, ...", metavar="NAME"
    )
    parameters: str | None = option(
        "a set of agents' parameters: thesis, or a TOML file", metavar="SET"
    )
    exchange: str | None = option("how resources change hands", choices=("abrupt", "smooth"))
    without: tuple[str, ...] = several("leave an agent out", metavar="AGENT")
    besides: tuple[str, ...] = several(
        "an agent that takes part, too; may be repeated", "--with", metavar="AGENT"
    )
    sensors: str | None = option(
        "sensors of the simulated robot: real; ideal: without error, and nobody localizes"
        " (default: the scenario's)",
        metavar="NAME",
    )
    redundant: bool = flag(
        "two of each behaviour: any one may die, and the mission ends all the same"
    )
    together: tuple[str, ...] = several(
        "live: agents that share one process; may be repeated", metavar="A+B"
    )
    runs: int | None = option("so many, with one seed after another", metavar="N", must=at_least(1))
    json: bool = flag("one JSON object on stdout; of several runs: runs, mean, deviation")
    plot: Path | None = option(
        "where the picture goes (PNG); of a live run: runs/SCENARIO.png", metavar="FILE"
    )
    no_plot: bool = flag("no picture")
    dashboard: bool = flag("show a live run; the link is printed")
    page: bool = flag(
        "serve a page to click on beside a live run, and print the link; without --for the"
        " society stays until Ctrl-C"
    )
    wait: bool = flag("a dashboard: begin when somebody looks, stay till Ctrl-C")
    rrd: Path | None = option("keep a virtual run for rerun", metavar="FILE")
    record: Path | None = option(
        "keep all that is said as armadico record does, and what armadico replay needs",
        metavar="FILE.mcap",
        must=RECORDING,
    )
    robot: str | None = option("drive something that is already there", metavar="URL")
    profile: str | None = option(
        "the make of robot: a shipped profile's name, or a file", metavar="NAME"
    )
    attach: bool = flag(
        "start nobody: the society is up, here or elsewhere; Ctrl-C stops the robot only"
    )
    priority: float | None = None
    map: Path | None = None
    resume: str | None = None
    mesh: Mesh = group(Mesh, "the mesh")

    def of_run(self, path: Path, seed: int) -> Path:
        """The file of one run: of several runs each has its own, by its seed."""
        return path if self.runs is None else path.with_stem(f"{path.stem}-{seed}")

    def chosen(self) -> Options:
        """What of it changes the scenario."""
        from armadico.launch.society import Options

        return Options(
            controller=self.controller,
            exchange=self.exchange,
            parameters=self.parameters,
            without=self.without,
            besides=self.besides,
            sensors=self.sensors,
            redundant=self.redundant,
            together=tuple(tuple(group.split("+")) for group in self.together),
            robot=self.robot,
            resume=self.resume,
            limit=self.limit,
            priority=self.priority,
            journal=self.record is not None and not self.virtual,
        )


def choose(
    args: Drive, *, somewhere: bool = True, mission: str | None = None
) -> tuple[Scenario, Options]:
    """What the command line names; if it is to lead `somewhere`, it is said what may hinder that.

    A `mission` is done in the scenario instead of whatever that says.

    Raises UsageError, ConfigError, UnknownNameError or FailedError.
    """
    chosen = args.chosen()
    return _scenario(args, chosen, somewhere=somewhere, mission=mission), chosen


def _scenario(args: Drive, chosen: Options, *, somewhere: bool, mission: str | None) -> Scenario:
    """What the command line names. Raises UsageError, ConfigError or UnknownNameError."""
    from armadico.config.scenarios import blind, load_scenario, scenario_from
    from armadico.launch.society import names, prepared, profile_of

    if args.scenario is not None and args.world is not None:
        raise UsageError("name a scenario or a world, not both")
    if both := sorted({*args.besides} & {*args.without}):
        raise UsageError(f"--with {both[0]} --without {both[0]}: does it take part, or not?")
    _check_shown(args)
    if args.robot is not None and args.virtual:
        raise UsageError("--robot drives what is really there; --virtual has its own simulator")
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
    poses = {"start": start, "goal": goal}
    scenario = prepared(scenario, chosen, **poses, profile=args.profile, mission=mission)
    _check_together(args, names(scenario))
    if somewhere and blind(scenario):
        why = "nothing is planned, and a barrier is in the way"
        options.say(f'{scenario.name}: {why}; plan = "rooms" plans')
    if somewhere and scenario.goal is None and scenario.mission is None and not scenario.tasks:
        sent = "" if args.virtual else "; armadico goto X Y sends the robot to one"
        options.say(f"{scenario.name}: no goal{sent}")
    return scenario


def _world(args: Drive) -> str | None:
    """The world that is named instead of a scenario, or the empty one. Raises UsageError."""
    from armadico.config.worlds import READERS

    named: str | None = args.world
    if args.scenario is None and named is None:
        if args.limit is None and args.goal is None:
            raise UsageError(
                "name a scenario (armadico run sc4) or a map, or say for how long (--for 60)"
            )
        return "empty"
    if args.scenario is None or Path(args.scenario).suffix not in {*READERS, *PICTURES}:
        return named
    scenario: str = args.scenario
    return scenario


def _check_shown(args: Drive) -> None:
    """Raises UsageError for a way of looking that this run has not."""
    if args.wait and args.runs is not None:
        raise UsageError("--wait is for one run, without --runs")
    if (args.dashboard or args.wait) and args.virtual:
        raise UsageError("--dashboard shows live runs; --rrd FILE keeps a virtual one")
    if args.page and (args.virtual or args.runs is not None):
        raise UsageError("--page is for one live run, without --virtual and --runs")
    if args.rrd is not None and not args.virtual:
        raise UsageError(
            "--rrd is for --virtual; armadico dashboard --record FILE keeps a live run"
        )


def _check_robot(url: str) -> None:
    """Raises UsageError for what is no address, FailedError if there is no such serial port."""
    from armadico.config.hosts import robot_fault, serial_port
    from armadico.config.loading import names

    fault = robot_fault(url)
    if url in names("robots"):
        raise UsageError(
            f"--robot {url}: it is the address of a robot that is there; --profile {url} simulates"
            " one of that make"
        )
    if fault is not None:
        raise UsageError(f"--robot {url!r}: {fault}")
    port = serial_port(url)
    if port is not None and not port.exists():
        raise FailedError(
            f"--robot {url}: there is no such port; is the adapter plugged in?"
            " `armadico doctor` shows the ports that there are"
        )


def _check_attach(args: Drive) -> None:
    for name in STARTING if args.attach else ():
        if getattr(args, name):
            raise UsageError(
                f"--{name} is for whoever starts the society (armadico up); --attach starts nobody"
            )


def check_connect(args: Drive) -> None:
    """Raises UsageError if a router is named and the run starts the robot's own."""
    if args.mesh.connect and not args.attach:
        raise UsageError(
            "--connect is for --attach: the robot agent that a run starts is the router itself"
        )


def pose(given: tuple[float, float, float] | None) -> ScenarioPose | None:
    """The pose that an option names in degrees, with its heading in rad; None if there is none."""
    return None if given is None else (given[0], given[1], radians(given[2]))


def _check_together(args: Drive, taking: Sequence[str]) -> None:
    """Raises UsageError for a group that cannot share a process."""
    named: list[str] = []
    for chosen in args.together:
        names = chosen.split("+")
        strangers = [name for name in names if name not in taking]
        if args.virtual:
            raise UsageError(f"--together {chosen}: under --virtual all share one process")
        if strangers:
            raise UsageError(f"--together {chosen}: {strangers[0]!r} takes no part")
        if len(names) < 2 or set(names) & set(named) or len(set(names)) < len(names):
            raise UsageError(f"--together {chosen}: expected two agents or more, each of them once")
        named += names
