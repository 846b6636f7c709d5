"""Drive one scenario from start to goal, as processes or under a virtual clock, and measure it."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.measures import show, statistics
from armadico.cli.options import FailedError, UsageError
from armadico.runtime.errors import SocietyError

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

    from armadico.config.scenarios import PoseDeg, Scenario
    from armadico.core.messages import ExploreStatus, StepResult
    from armadico.launch.api import Run
    from armadico.launch.run import LiveRun
    from armadico.launch.society import Options
    from armadico.launch.virtual import Rehearsal
    from armadico.mesh.zenoh import ZenohMesh
    from armadico.observe.measures import Result, RunWatch
    from armadico.runtime.client import Client

LINE_S: Final = 2.0
"""How often a line is printed where there is no terminal, s of the run."""

RUNS_FOR_A_WORKER: Final = 4
"""A worker takes as long to start as two or three runs, so for fewer none is started."""

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

EXAMPLES: Final = """\
  armadico run sc4                             separate processes on this machine, with a picture
  armadico run sc4 --virtual --seed 7          the same society in one process, repeatable
  armadico run house --virtual --runs 20 --json
  armadico run --world rooms-a --start 1 1 90 --goal 7 0.7 -90
  armadico run office.map --start 1 1.5 0 --goal 16.5 13.2 -90
  armadico run --for 60                        no goal and no walls; armadico goto sends it
  armadico run my.toml --controller fast --exchange abrupt --without gothrough
  armadico run sc1 --robot serial:///dev/ttyUSB0
  armadico run sc4 --together encoder+sonar --together goto+avoid+gothrough
  armadico run sc4 --virtual --profile amigobot
  armadico run sc4 --redundant                 two of each behaviour: kill any one
  armadico run sc4 --sensors ideal             as the thesis's tables: nobody localizes
  armadico run sc4 --attach --hosts lab.toml   the society is up already: armadico up
  armadico run --world house --start 1 1.5 0 --for 600 --page    sent by clicks on a map
  armadico run my.toml --virtual --watch       again whenever a file changes: what moved
  armadico run fleet --robots 3                three robots share a list of tasks; or --virtual
"""


def main(argv: Sequence[str]) -> int:
    """Drive; 0 only if the goal, if any, was reached without a collision, in every run."""
    args = parser().parse_args(argv)
    if args.watch:
        _check_watched(args)
        from armadico.cli import watch  # noqa: PLC0415 - not for --help

        return watch.main([word for word in argv if word != "--watch"])
    scenario, chosen = choose(args)
    if scenario.tasks:
        from armadico.cli import fleet  # noqa: PLC0415 - not for --help

        return fleet.drive(args, scenario, chosen)
    if args.robots is not None:
        raise UsageError(f"--robots {args.robots}: {scenario.name} has no tasks for a fleet")
    return drive(args, scenario, chosen)


def drive(args: argparse.Namespace, scenario: Scenario, chosen: Options) -> int:
    """Drive as it was chosen; the exit code."""
    seeds = _seeds(args, scenario)
    for seed in seeds if args.plot is not None else ():
        _check_picture(_picture(args, scenario, seed))
    results = _series(args, scenario, chosen, seeds)
    if args.json:
        _print_json(results, several=args.runs is not None)
    else:
        show(scenario.name, results)
    asked = [_picture(args, scenario, seed) for seed in seeds if args.plot is not None]
    drawn = all(path is None or path.is_file() for path in asked)
    return 0 if drawn and all(result.passed for result in results) else options.FAILED


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    made = options.parser(
        "armadico run",
        "Drive one scenario and measure it. Live: simulator, robot agent and every agent are"
        " processes of their own on this machine, over Zenoh. It ends at the goal, or at its"
        " time limit: --for, or 5 times the way over 0.3 m/s, at least 60 s.",
        EXAMPLES,
    )
    made.add_argument("--goal", **POSE, help="where it is to go: m, m, degrees")
    made.add_argument(
        "--robots", type=int, metavar="N", help="of a scenario with tasks for several: so many"
    )
    made.add_argument(
        "--watch",
        action="store_true",
        help="a virtual run again, whenever a file that it has read changes, and what moved",
    )
    add_options(made)
    return made


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
        help="how well the simulated robot senses: real; ideal: without error, nobody localizes",
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
        help="a page to click on beside a live run, with stop; the link is printed",
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
    start, goal = (_pose(flag, getattr(args, flag)) for flag in ("start", "goal"))
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
        _say(f'{scenario.name}: {why}; plan = "rooms" plans')
    if somewhere and scenario.goal is None and scenario.mission is None and not scenario.tasks:
        sent = "" if args.virtual else "; armadico goto X Y DEG sends the robot to one"
        _say(f"{scenario.name}: no goal{sent}")
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


def _check_watched(args: argparse.Namespace) -> None:
    """Raises UsageError or ConfigError."""
    from armadico.config.scenarios import load_scenario  # noqa: PLC0415 - not for --help

    if not args.virtual:
        raise UsageError("--watch runs under a virtual clock again and again: --virtual")
    for option in ("runs", "json", "robots"):
        if getattr(args, option):
            raise UsageError(f"--{option}: --watch compares one run with the one before it")
    if _world(args) is None and load_scenario(args.scenario).tasks:
        raise UsageError(f"{args.scenario}: --watch compares runs of one robot")


def _check_attach(args: argparse.Namespace) -> None:
    for option in STARTING if args.attach else ():
        if getattr(args, option) not in (None, False, []):
            raise UsageError(
                f"--{option} is for whoever starts the society (armadico up); --attach starts"
                " nobody"
            )


def _pose(flag: str, given: Sequence[float] | None) -> PoseDeg | None:
    """Raises UsageError for what is no pose; whether it is free is the world's to say."""
    if given is None:
        return None
    x, y, heading = given
    if not (all(map(isfinite, given)) and abs(heading) <= 360.0):
        words = " ".join(f"{value:g}" for value in given)
        raise UsageError(f"--{flag} {words}: expected finite m, m and -360 to 360 degrees")
    return x, y, heading


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


def _seeds(args: argparse.Namespace, scenario: Scenario) -> range:
    first = scenario.seed if args.seed is None else args.seed
    return range(first, first + (args.runs or 1))


def _series(
    args: argparse.Namespace, scenario: Scenario, chosen: Options, seeds: range
) -> list[Result]:
    """Every run's result, in the order of the seeds; virtual ones are driven on all cores."""
    drive = partial(_drive, args, scenario, chosen)

    def told(seed: int, result: Result) -> None:
        if args.runs is not None:
            _say(f"{scenario.name} seed {seed}: {result.verdict}")

    if not args.virtual or args.runs is None:
        results = []
        for seed in seeds:
            results.append(drive(seed))
            told(seed, results[-1])
        return results
    from armadico.cli.pool import over  # noqa: PLC0415 - not for --help

    jobs = min(os.cpu_count() or 1, len(seeds) // RUNS_FOR_A_WORKER)
    return over(drive, seeds, jobs, scenario.name, told)


def _drive(args: argparse.Namespace, scenario: Scenario, chosen: Options, seed: int) -> Result:
    """One run and its picture, in this process or in a worker's."""
    from armadico.launch.api import Run  # noqa: PLC0415 - not for --help

    drive = _virtual if args.virtual else _live
    watch = drive(args, scenario, replace(chosen, seed=seed))
    run = Run.of(scenario, watch)
    if watch.explored is not None:
        _say(explored(watch.explored))
    if watch.tasks is not None and args.runs is None:
        for result in watch.tasks.course.results:
            _say(f"{result.at:8.1f} s  {step_told(result)}")
    picture = _picture(args, scenario, seed)
    if picture is not None and run.marks:
        _plot(picture, run)
    return run.measures


def _virtual(args: argparse.Namespace, scenario: Scenario, chosen: Options) -> RunWatch:
    from armadico.launch.virtual import Rehearsal  # noqa: PLC0415 - not for --help

    rehearsal = Rehearsal(scenario, chosen)
    first = args.runs is None or chosen.seed == _seeds(args, scenario)[0]
    told = _say if first else None  # of a series once: every seed would say the same
    with _recording(args, rehearsal), _progress(args, scenario, chosen.seed) as show:
        rehearsal.run(show, told)
    _keep_map(args, rehearsal.client)
    return rehearsal.watch


def _live(args: argparse.Namespace, scenario: Scenario, chosen: Options) -> RunWatch:
    mesh = options.join(args)
    options.end_as_by_ctrl_c()
    try:
        with (
            _beside(args, scenario),
            mesh,
            _recorder(args, chosen.seed),
            _run_on(mesh, args, scenario, chosen) as run,
            _progress(args, scenario, chosen.seed) as show,
        ):
            try:
                run.run(show, _say)
            except KeyboardInterrupt:
                _rescue_map(args, run.client)
                raise
            _keep_map(args, run.client)
            if args.wait:  # what is printed comes after Ctrl-C
                _say(f"{scenario.name}: {run.watch.result().verdict}")
    except KeyboardInterrupt:
        if not args.attach:  # which has said what it leaves
            _say(
                f"{scenario.name}: interrupted; all that it started has ended, nothing is measured"
            )
        raise
    return run.watch


def _keep_map(args: argparse.Namespace, client: Client) -> None:
    """Save what was mapped, by `armadico explore --map`."""
    if getattr(args, "map", None) is not None:
        from armadico.cli.map import save  # noqa: PLC0415 - heavy

        _say(save(client, args.map))


def _rescue_map(args: argparse.Namespace, client: Client) -> None:
    """Save what was mapped until somebody interrupted it; the robot stands first."""
    if getattr(args, "map", None) is None:
        return
    with suppress(SocietyError, FailedError):
        client.stop(by="armadico explore")
        _keep_map(args, client)


def _run_on(
    mesh: ZenohMesh, args: argparse.Namespace, scenario: Scenario, chosen: Options
) -> LiveRun:
    """The run, with processes of its own or of others."""
    if args.attach:
        from armadico.launch.attached import AttachedRun  # noqa: PLC0415 - not for --help

        _say(f"{scenario.name}: by the society in namespace {args.namespace!r}")
        return AttachedRun(scenario, chosen, mesh)
    from armadico.launch.local import Launcher  # noqa: PLC0415 - not for --help

    joining = options.joining(args)
    launcher = Launcher(scenario, chosen, mesh, args.namespace, joining=joining)
    _say(f"{scenario.name}: starting; until it ends well, logs are in {launcher.logs}")
    return launcher


def _own(args: argparse.Namespace, path: Path, seed: int) -> Path:
    """Each run's file."""
    return path if args.runs is None else path.with_stem(f"{path.stem}-{seed}")


def _recorder(args: argparse.Namespace, seed: int) -> AbstractContextManager[None]:
    """A recorder beside a live run, if it is asked for."""
    if args.record is None:
        return nullcontext()
    from armadico.cli.record import recorder  # noqa: PLC0415 - not for --help

    return recorder(args, _own(args, args.record, seed))


@contextmanager
def _recording(args: argparse.Namespace, rehearsal: Rehearsal) -> Iterator[None]:
    """A virtual run is kept in files, if they are asked for. Raises FailedError."""
    with ExitStack() as stack:
        if args.rrd is not None:
            from armadico.cli.dashboard import kept  # noqa: PLC0415 - not for --help

            stack.enter_context(kept(rehearsal, _own(args, args.rrd, rehearsal.mesh.seed)))
        if args.record is not None:
            from armadico.cli.record import recorded  # noqa: PLC0415 - not for --help

            path = _own(args, args.record, rehearsal.mesh.seed)
            stack.enter_context(recorded(rehearsal.mesh, path, rehearsal.namespace))
        yield


@contextmanager
def _beside(args: argparse.Namespace, scenario: Scenario) -> Iterator[None]:
    """A dashboard and a page beside a live run, as far as they are asked for."""
    from armadico.cli.beside import beside  # noqa: PLC0415 - not for --help

    with ExitStack() as stack:
        if args.page:
            stack.enter_context(beside(args, "page", scenario.world))
        if args.dashboard or args.wait:
            stack.enter_context(beside(args, "dashboard", scenario.world, wait=args.wait))
        yield


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


# Progress -----------------------------------------------------------------------------------------


@contextmanager
def _progress(
    args: argparse.Namespace, scenario: Scenario, seed: int
) -> Iterator[Callable[[RunWatch], None] | None]:
    """A bar on a terminal, a line now and then elsewhere; on stderr."""
    if args.virtual and (args.runs is not None or not sys.stderr.isatty()):
        yield None  # it is over in a second, or has the series' bar
        return
    label = f"{scenario.name} seed {seed}"
    if not sys.stderr.isatty():
        yield _Lines(label).show
        return
    from rich.console import Console  # noqa: PLC0415 - not for --help
    from rich.progress import Progress  # noqa: PLC0415

    with Progress(*bar(), console=Console(stderr=True), transient=True, expand=True) as progress:
        task = progress.add_task("starting", total=None, label=label)

        def show(watch: RunWatch) -> None:
            completed, whole = come(watch)
            progress.update(task, total=whole, completed=completed, description=remark(watch))

        yield show


def come(watch: RunWatch) -> tuple[float, float]:
    """How far it has come, and of how much: tasks of a mission, else metres."""
    if watch.tasks is not None:
        done = float(len(watch.tasks.course.results))
        return done, done + len(watch.tasks.ahead) + bool(watch.tasks.doing)
    mission = watch.view.mission
    to_go = 0.0 if mission is None else mission.to_go
    whole = max(watch.distance + to_go, 1e-3)
    return whole - to_go, whole


def bar() -> Iterator[ProgressColumn]:
    """The columns of the progress; the remark is cut off before the name and the bar are."""
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn  # noqa: PLC0415
    from rich.table import Column  # noqa: PLC0415 - not for --help

    yield TextColumn("{task.fields[label]}", markup=False, table_column=Column(no_wrap=True))
    yield BarColumn(None, table_column=Column(ratio=1))
    yield TimeElapsedColumn()
    cut = Column(ratio=4, no_wrap=True, overflow="ellipsis")
    yield TextColumn("{task.description}", markup=False, table_column=cut)


class _Lines:
    def __init__(self, label: str) -> None:
        self._label = label
        self._said_at = 0.0

    def show(self, watch: RunWatch) -> None:
        if watch.elapsed - self._said_at >= LINE_S:
            self._said_at = watch.elapsed
            _say(f"{self._label} {watch.elapsed:6.1f} s  {remark(watch)}")


def remark(watch: RunWatch) -> str:
    """Distance to go and what keeps it, who holds the wheels, speed, battery."""
    from armadico.observe.view import at_work  # noqa: PLC0415 - not for --help

    state, mission = watch.view.state, watch.view.mission
    if watch.tasks is not None:
        to_go = options.shown(at_work(watch.tasks))
    elif mission is None:
        to_go = "no word of the mission"
    else:
        none = mission.state == "none"  # a mission's state, as on the wire
        to_go = "no goal" if none else f"{mission.to_go:.2f} m to go"
        to_go += f", {options.shown(mission.note)}" if mission.note else ""
    if state is None:
        return f"{to_go}, nothing heard of the robot"
    if state.stop.stopped:
        by = options.shown(state.stop.by) or "somebody"
        return f"{to_go}, stopped by {by}; armadico resume releases it"
    holder = options.shown(watch.holder or "nobody")
    speed = "stalled" if state.stalled else f"{state.v:.2f} m/s"
    return f"{to_go}, {speed}, {holder} drives, {watch.view.battery}"


# What came of it ----------------------------------------------------------------------------------


def step_told(result: StepResult) -> str:
    """What came of one step of a mission, in a line."""
    said = f": {result.said}" if result.said else ""
    return options.shown(f"{result.step} {result.end.value}{said}")


def explored(status: ExploreStatus) -> str:
    """An exploration in one line."""
    note = f": {options.shown(status.note)}" if status.note else ""
    return (
        f"exploration {status.state.value}{note}; {status.known:.1f} m^2 known,"
        f" {status.places} places driven to, {status.given_up} of them not reached"
    )


def _print_json(results: Sequence[Result], *, several: bool) -> None:
    import msgspec  # noqa: PLC0415 - not for --help

    rows = msgspec.to_builtins(list(results))
    print(json.dumps({"runs": rows, **statistics(results)} if several else rows[0]))


NOTHING_DRAWS: Final = "no picture: matplotlib is missing; pip install 'armadico[plot]'"


def _picture(args: argparse.Namespace, scenario: Scenario, seed: int) -> Path | None:
    """Where the picture goes: as asked for; a live run leaves one without being asked."""
    path: Path | None = args.plot
    if args.no_plot or (path is None and args.virtual):
        return None
    path = path or Path("runs") / f"{scenario.name}.png"
    return path.with_stem(f"{path.stem}-{seed}") if args.runs is not None else path


def _check_picture(path: Path | None) -> None:
    """Whether it can be drawn and written is said before the robot moves. Raises FailedError."""
    if path is None:
        return
    if find_spec("matplotlib") is None:
        raise FailedError(NOTHING_DRAWS)
    try:
        new = not path.exists()
        path.open("ab").close()
        if new:
            path.unlink()
    except OSError as error:
        raise FailedError(f"cannot write the picture {path}: {error.strerror}") from None


def _plot(path: Path, run: Run) -> None:
    """World, path coloured by holder, what was heard or seen; a warning if nothing can draw."""
    try:
        run.plot(path)
    except ImportError:
        _say(NOTHING_DRAWS)
    except OSError as error:
        with suppress(OSError):
            path.unlink()  # half a picture is none
        _say(f"no picture: cannot write {path}: {error.strerror}")
    else:
        _say(f"picture: {path}")
