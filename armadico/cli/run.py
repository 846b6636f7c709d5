"""Drive one scenario from start to goal, as processes or under a virtual clock, and measure it."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import coordinations, options, progress
from armadico.cli.additions import (
    Addition,
    Start,
    added,
    beside,
    checked,
    done,
    driven,
    recording,
)
from armadico.cli.measures import show, statistics
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, flag, option
from armadico.cli.run_options import Drive, check_connect, choose
from armadico.core.config_errors import ConfigError
from armadico.launch.options import X_Y_DEG
from armadico.mobile.geometry import Pose2
from armadico.runtime.errors import SocietyError

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.core.judgement import Judgement
    from armadico.launch.run import LiveRun, RobotRun
    from armadico.launch.society import Options as Chosen
    from armadico.mesh.zenoh import ZenohMesh
    from armadico.observe.measures import Result, RunWatch

    _Driven = tuple[Result, Sequence[str]]
    """What a run came to, and what of it could not be kept."""

RUNS_FOR_A_WORKER: Final = 4
"""Runs per worker at least: a worker takes as long to start as two or three runs."""

EXAMPLES: Final = """\
  armadico run sc4                             separate processes on this machine
  armadico run sc4 --virtual --seed 7          the same society in one process, repeatable
  armadico run house --virtual --runs 20 --json
  armadico run --world rooms-a --start 1 1 90 --goal 7 0.7 -90
  armadico run office.map --start 1 1.5 0 --goal 16.5 13.2 -90
  armadico run --for 60                        no goal and no walls; use armadico goto
  armadico run my.toml --controller fast --exchange abrupt --without gothrough
  armadico run sc4 --virtual --set goto.v_max=0.3
  armadico run sc1 --robot serial:///dev/ttyUSB0
  armadico run sc4 --together encoder+sonar --together goto+avoid+gothrough
  armadico run sc4 --virtual --profile amigobot
  armadico run sc4 --redundant                 two of each behaviour
  armadico run sc4 --sensors ideal             as in the thesis: without localization
  armadico run sc4 --attach --hosts lab.toml   with a society that `armadico up` has started
  armadico run fleet --robots 3                three robots share a list of tasks
  armadico run fleet --attach --namespace lab  running robots lab/r1, lab/r2, ... do the tasks
"""


@dataclass(frozen=True, kw_only=True)
class Options(Drive):
    goal: Pose2 | None = option(
        "drive to this pose: m, m, degrees (default: the scenario's)", **X_Y_DEG
    )
    robots: int | None = option(
        "number of robots of a fleet; with --attach, the least number to wait for"
        " (default: the scenario's)",
        metavar="N",
    )
    replace: bool = flag("with --attach to a fleet: replace its present tasks")
    additions: tuple[Addition, ...] = added("run")


def run(args: Options) -> int:
    """Drive; returns 0 only if every run reached its goal, if any, without a collision.

    Returns `options.UNKNOWN` if that is not known.
    """
    if args.coordination == coordinations.LIST:
        return coordinations.show()
    with answering(args):
        scenario, chosen = choose(args)
        if scenario.tasks:
            from armadico.core.discovery import RUNS, find

            code: int = find(RUNS, "tasks").load()(args, scenario, chosen)
            return code
        for option, given in ("--replace", args.replace), (f"--robots {args.robots}", args.robots):
            if given not in (None, False):
                raise UsageError(f"{option}: {scenario.name} has no tasks for a fleet")
        return drive(args, scenario, chosen)


@contextmanager
def answering(args: Drive) -> Iterator[None]:
    """With `--json`, print a result also for a run that is rejected, with the reason in `why`."""
    try:
        yield
    except (UsageError, ConfigError, SocietyError) as error:
        refused(args, error)
        raise


def refused(args: Drive, error: Exception) -> None:
    """With `--json`, print the result of a rejected run."""
    if not args.json:
        return
    from armadico.core.judgement import no
    from armadico.observe.measures import Result

    result = Result(
        scenario=Path(args.scenario or args.world or "empty").stem,
        seed=args.seed,
        reached=False if args.mission is None else None,
        td_m=0.0,
        fo_deg=None,
        tt_s=0.0,
        p_percent=None,
        shares={},
        exchanges=0,
        collisions=None,
        min_clearance_m=None,
        why=str(error),
        done=None if args.mission is None else False,
        judgement=no(str(error)),
    )
    _print_json([result], several=args.runs is not None)


def drive(args: Drive, scenario: Scenario, chosen: Chosen) -> int:
    """Drive, print the measures, and return the exit code."""
    from armadico.core.judgement import all_of

    start = args.starting(scenario, _seeds(args, scenario))
    checked(args.additions, start)
    driven = _series(args, scenario, chosen, start)
    results = [result for result, _ in driven]
    if args.json:
        _print_json(results, several=args.runs is not None)
    else:
        show(scenario.name, results)
    told = Counter(result.undecided for result in results)
    for text in filter(None, told):
        many = f"{told[text]} of {len(results)} runs: " if len(results) > 1 else ""
        options.report(f"{scenario.name}: {many}{text}")
    if faults := [fault for _, each in driven for fault in each]:
        raise FailedError("\n".join(faults))
    return exit_code(args, all_of(result.judgement for result in results))


def exit_code(args: Drive, judgement: Judgement) -> int:
    """The exit code of a judgement; prints what is not known, and how to make it known."""
    if judgement.answer != "unknown":
        return judgement.exit_code
    if not args.json:
        options.report(options.shown(f"unknown: {judgement.reason}"))
        options.report(options.shown(f"  -> {judgement.cure}"))
    return 0 if args.accept_unknown else judgement.exit_code


def _seeds(args: Drive, scenario: Scenario) -> range:
    first = scenario.seed if args.seed is None else args.seed
    return range(first, first + (args.runs or 1))


def _series(args: Drive, scenario: Scenario, chosen: Chosen, start: Start) -> list[_Driven]:
    """The results in the order of the seeds; virtual runs use all cores."""
    drive = partial(_drive, args, scenario, chosen, start)

    def report(seed: int, driven: _Driven) -> None:
        if args.runs is not None:
            options.report(f"{scenario.name} seed {seed}: {driven[0].verdict}")

    if not args.virtual or args.runs is None:
        results = []
        for seed in start.seeds:
            results.append(drive(seed))
            report(seed, results[-1])
        return results
    from armadico.cli.pool import over

    jobs = min(os.cpu_count() or 1, len(start.seeds) // RUNS_FOR_A_WORKER)
    return over(drive, start.seeds, jobs, scenario.name, report)


def _drive(args: Drive, scenario: Scenario, chosen: Chosen, start: Start, seed: int) -> _Driven:
    """One run and what is made of it, in this process or in a worker."""
    from armadico.launch.api import Run

    drive, faults = _virtual if args.virtual else _live, list[str]()
    start, chosen = replace(start, seed=seed), replace(chosen, seed=seed)
    watch = drive(args, scenario, chosen, start, faults.append)
    run = Run.of(scenario, watch)
    if watch.errand is not None and watch.tasks is None:
        options.report(options.shown(watch.errand.summary))
    if watch.tasks is not None and args.runs is None:
        for step in watch.tasks.steps or ():
            options.report(f"{step.at:8.1f} s  {options.shown(str(step))}")
    done(args.additions, start, run, faults.append)
    return run.measures, faults


def _virtual(
    args: Drive,
    scenario: Scenario,
    chosen: Chosen,
    start: Start,
    report: Callable[[str], None],
) -> RunWatch:
    from armadico.launch.virtual import Rehearsal

    rehearsal = Rehearsal(scenario, chosen)
    start = replace(start, on=rehearsal.mesh, namespaces=(rehearsal.namespace,))
    first = args.runs is None or start.seed == start.seeds[0]
    warn = options.report if first else None  # the warnings of all seeds are the same
    quiet = args.runs is not None or not sys.stderr.isatty()  # a series has its own bar
    bar = nullcontext() if quiet else progress.shown(_label(scenario, chosen))
    with recording(args.additions, start, report), bar as show:
        _drive_on(args.additions, start, rehearsal, show, warn)
    return rehearsal.watch


def _live(
    args: Drive, scenario: Scenario, chosen: Chosen, start: Start, _: Callable[[str], None]
) -> RunWatch:
    if args.attach or args.mesh.hosts or args.mesh.connect:
        return _live_in(args, scenario, chosen, start)
    with args.mesh.beside_others() as mesh:
        start = replace(start, mesh=mesh, namespaces=(mesh.namespace,))
        return _live_in(replace(args, mesh=mesh), scenario, chosen, start)


def _live_in(args: Drive, scenario: Scenario, chosen: Chosen, start: Start) -> RunWatch:
    mesh = args.mesh.join(starts=not args.attach)
    check_connect(args)
    options.end_as_by_ctrl_c()
    try:
        with (
            beside(args.additions, start),
            mesh,
            _run_on(mesh, args, scenario, chosen) as run,
            progress.shown(_label(scenario, chosen)) as show,
        ):
            _drive_on(args.additions, start, run, show, options.report)
    except KeyboardInterrupt:
        if not args.attach:  # an attached run has reported what it leaves
            options.report(
                f"{scenario.name}: interrupted; all its processes have ended, no measures"
            )
        raise
    return run.watch


def _drive_on(
    additions: Sequence[Addition],
    start: Start,
    run: RobotRun,
    show: Callable[[RunWatch], None] | None,
    warn: Callable[[str], None] | None,
) -> None:
    try:
        run.run(show, warn)
    except KeyboardInterrupt:
        driven(additions, start, run, interrupted=True)
        raise
    driven(additions, start, run)


def _label(scenario: Scenario, chosen: Chosen) -> str:
    return f"{scenario.name} seed {chosen.seed}"


def _run_on(mesh: ZenohMesh, args: Drive, scenario: Scenario, chosen: Chosen) -> LiveRun:
    """The run, with its own processes or with a running society."""
    if args.attach:
        from armadico.launch.attached import AttachedRun

        options.report(f"{scenario.name}: with the society in namespace {args.mesh.namespace!r}")
        return AttachedRun(scenario, chosen, mesh)
    from armadico.launch.local import Launcher

    joining = args.mesh.endpoints().words
    launcher = Launcher(scenario, chosen, mesh, mesh.namespace, joining=joining)
    options.report(f"{scenario.name}: starting; until it succeeds, logs are in {launcher.logs}")
    return launcher


# Results ------------------------------------------------------------------------------------------


def _print_json(results: Sequence[Result], *, several: bool) -> None:
    import msgspec

    from armadico.core.judgement import all_of

    rows = msgspec.to_builtins(list(results))
    if not several:
        print(json.dumps(rows[0]))
        return
    judgement = msgspec.to_builtins(all_of(result.judgement for result in results))
    print(json.dumps({"runs": rows, "judgement": judgement, **statistics(results)}))


main: Final = Command(
    "armadico run",
    Options,
    run,
    "Drive one scenario and measure it. In a live run the simulator and every agent are processes"
    " on this machine, over Zenoh. It ends at the goal or at the time limit: --for, or 5 times the"
    " path length at 0.3 m/s, at least 60 s.",
    EXAMPLES,
    refused,
)
