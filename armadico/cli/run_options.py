"""The options of whoever drives in a scenario, and what they name, checked before that."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from math import inf, isfinite, radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError

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

POSE: Final[dict[str, Any]] = {"nargs": 3, "type": float, "metavar": ("X", "Y", "DEG")}


def add_options(made: argparse.ArgumentParser) -> None:
    """The options of whoever drives in a scenario."""
    made.add_argument(
        "scenario", nargs="?", help="a scenario's name, a TOML file, or a map as --world"
    )
    made.add_argument("--world", metavar="MAP", help="a world instead of a scenario: .map, .yaml")
    made.add_argument("--start", **POSE, help="where the robot starts: m, m, degrees")
    made.add_argument(
        "--for", dest="limit", type=float, metavar="S", help="time limit; without a goal: 60"
    )
    made.add_argument("--virtual", action="store_true", help="one process, under a virtual clock")
    made.add_argument(
        "--seed", type=int, metavar="N", help="seed of all that is random (default: 0)"
    )
    made.add_argument(
        "--controller", metavar="NAME", help="of agents that have several: fast, precise, ..."
    )
    made.add_argument(
        "--parameters", metavar="SET", help="a set of agents' parameters: thesis, or a TOML file"
    )
    made.add_argument("--exchange", choices=("abrupt", "smooth"), help="how resources change hands")
    made.add_argument(
        "--without", action="append", default=[], metavar="AGENT", help="leave an agent out"
    )
    made.add_argument(
        "--with",
        dest="besides",
        action="append",
        default=[],
        metavar="AGENT",
        help="an agent that takes part, too; may be repeated",
    )
    made.add_argument(
        "--sensors",
        metavar="NAME",
        help="sensors of the simulated robot: real; ideal: without error, and nobody localizes"
        " (default: the scenario's)",
    )
    made.add_argument(
        "--redundant",
        action="store_true",
        help="two of each behaviour: any one may die, and the mission ends all the same",
    )
    made.add_argument(
        "--together",
        action="append",
        default=[],
        metavar="A+B",
        help="live: agents that share one process; may be repeated",
    )
    made.add_argument("--runs", type=int, metavar="N", help="so many, with one seed after another")
    made.add_argument(
        "--json",
        action="store_true",
        help="one JSON object on stdout; of several runs: runs, mean, deviation",
    )
    made.add_argument(
        "--plot",
        metavar="FILE",
        type=Path,
        help="where the picture goes (PNG); of a live run: runs/SCENARIO.png",
    )
    made.add_argument("--no-plot", action="store_true", help="no picture")
    made.add_argument(
        "--dashboard", action="store_true", help="show a live run; the link is printed"
    )
    made.add_argument(
        "--page",
        action="store_true",
        help="serve a page to click on beside a live run, and print the link; without --for the"
        " society stays until Ctrl-C",
    )
    made.add_argument(
        "--wait",
        action="store_true",
        help="a dashboard: begin when somebody looks, stay till Ctrl-C",
    )
    made.add_argument("--rrd", metavar="FILE", type=Path, help="keep a virtual run for rerun")
    made.add_argument(
        "--record",
        metavar="FILE.mcap",
        type=Path,
        help="keep all that is said as armadico record does, and what armadico replay needs",
    )
    made.add_argument("--robot", metavar="URL", help="drive something that is already there")
    made.add_argument(
        "--profile", metavar="NAME", help="the make of robot: a shipped profile's name, or a file"
    )
    made.add_argument(
        "--attach",
        action="store_true",
        help="start nobody: the society is up, here or elsewhere; Ctrl-C stops the robot only",
    )
    options.add_mesh_options(made)


def choose(
    args: argparse.Namespace, *, somewhere: bool = True, mission: str | None = None
) -> tuple[Scenario, Options]:
    """What the command line names; if it is to lead `somewhere`, it is said what may hinder that.

    A `mission` is done in the scenario instead of whatever that says.

    Raises UsageError, ConfigError, UnknownNameError or FailedError.
    """
    chosen = _options(args)
    return _scenario(args, chosen, somewhere=somewhere, mission=mission), chosen


def _scenario(
    args: argparse.Namespace, chosen: Options, *, somewhere: bool, mission: str | None
) -> Scenario:
    """What the command line names. Raises UsageError, ConfigError or UnknownNameError."""
    from armadico.config.scenarios import blind, load_scenario, scenario_from  # noqa: PLC0415
    from armadico.launch.society import names, prepared, profile_of  # noqa: PLC0415

    if args.scenario is not None and args.world is not None:
        raise UsageError("name a scenario or a world, not both")
    if args.limit is not None and not 0.0 < args.limit < inf:
        raise UsageError(f"--for {args.limit:g}: expected seconds, more than none")
    if args.runs is not None and args.runs < 1:
        raise UsageError(f"--runs {args.runs}: at least 1")
    if both := sorted({*args.besides} & {*args.without}):
        raise UsageError(f"--with {both[0]} --without {both[0]}: does it take part, or not?")
    _check_shown(args)
    if args.robot is not None and args.virtual:
        raise UsageError("--robot drives what is really there; --virtual has its own simulator")
    if args.robot is not None:
        _check_robot(args.robot)
    _check_attach(args)
    if args.seed is not None and not 0 <= args.seed < 2**63:
        raise UsageError(f"--seed {args.seed}: from 0 to 2^63 - 1")
    start, goal = (pose(flag, getattr(args, flag)) for flag in ("start", "goal"))
    world = _world(args)
    if world is not None:
        scenario = scenario_from(world, start, goal, profile_of(args.profile))
        start = goal = None
    else:
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


def _world(args: argparse.Namespace) -> str | None:
    """The world that is named instead of a scenario, or the empty one. Raises UsageError."""
    from armadico.config.worlds import READERS  # noqa: PLC0415 - not for --help

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


def _check_shown(args: argparse.Namespace) -> None:
    """Raises UsageError for a way of looking that this run has not."""
    if args.wait and args.runs is not None:
        raise UsageError("--wait is for one run, without --runs")
    if (args.dashboard or args.wait) and args.virtual:
        raise UsageError("--dashboard shows live runs; --rrd FILE keeps a virtual one")
    if args.page and (args.virtual or args.runs is not None):
        raise UsageError("--page is for one live run, without --virtual and --runs")
    if args.record is not None and args.record.suffix != ".mcap":
        raise UsageError(f"--record {args.record}: the name of a recording ends with .mcap")
    if args.rrd is not None and not args.virtual:
        raise UsageError(
            "--rrd is for --virtual; armadico dashboard --record FILE keeps a live run"
        )


def _options(args: argparse.Namespace) -> Options:
    from armadico.launch.society import Options  # noqa: PLC0415 - not for --help

    return Options(
        controller=args.controller,
        exchange=args.exchange,
        parameters=args.parameters,
        without=tuple(args.without),
        besides=tuple(args.besides),
        sensors=args.sensors,
        redundant=args.redundant,
        together=tuple(tuple(group.split("+")) for group in args.together),
        robot=args.robot,
        resume=getattr(args, "resume", None),
        limit=args.limit,
        priority=getattr(args, "priority", None),
        journal=args.record is not None and not args.virtual,
    )


def _check_robot(url: str) -> None:
    """Raises UsageError for what is no address, FailedError if there is no such serial port."""
    from armadico.config.hosts import robot_fault, serial_port  # noqa: PLC0415 - not for --help
    from armadico.config.loading import names  # noqa: PLC0415 - not for --help

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


def _check_attach(args: argparse.Namespace) -> None:
    for option in STARTING if args.attach else ():
        if getattr(args, option) not in (None, False, []):
            raise UsageError(
                f"--{option} is for whoever starts the society (armadico up); --attach starts"
                " nobody"
            )


def check_connect(args: argparse.Namespace) -> None:
    """Raises UsageError if a router is named and the run starts the robot's own."""
    if args.connect and not args.attach:
        raise UsageError(
            "--connect is for --attach: the robot agent that a run starts is the router itself"
        )


def pose(flag: str, given: Sequence[float] | None) -> ScenarioPose | None:
    """The pose that an option names in degrees, with its heading in rad; None if there is none.

    Raises UsageError for what is no pose; whether it is free is the world's to say.
    """
    if given is None:
        return None
    x, y, heading = given
    if not (all(map(isfinite, given)) and abs(heading) <= 360.0):
        words = " ".join(f"{value:g}" for value in given)
        raise UsageError(f"--{flag} {words}: expected finite m, m and -360 to 360 degrees")
    return x, y, radians(heading)


def _check_together(args: argparse.Namespace, taking: Sequence[str]) -> None:
    """Raises UsageError for a group that cannot share a process."""
    named: list[str] = []
    for group in args.together:
        names = group.split("+")
        strangers = [name for name in names if name not in taking]
        if args.virtual:
            raise UsageError(f"--together {group}: under --virtual all share one process")
        if strangers:
            raise UsageError(f"--together {group}: {strangers[0]!r} takes no part")
        if len(names) < 2 or set(names) & set(named) or len(set(names)) < len(names):
            raise UsageError(f"--together {group}: expected two agents or more, each of them once")
        named += names
