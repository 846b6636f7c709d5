"""Several robots, and a list of tasks that they share: `armadico run fleet`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.additions import Start, beside, checked, recording
from armadico.cli.options import UsageError
from armadico.cli.run_options import check_connect
from armadico.config.endpoints import Endpoints
from armadico.mesh.topology import DEFAULT_NAMESPACE, checked_namespace

if TYPE_CHECKING:
    from armadico.agents.fleet.commands.view import FleetResult, FleetWatch
    from armadico.cli.run import Options
    from armadico.config.scenarios import Scenario
    from armadico.launch.society import Options as Chosen
    from armadico.mesh.base import Mesh

LINE_S: Final = 5.0  # the period of printed lines, s of the run

# Options that are for the run of one robot.
ALONE: Final = (
    "runs",
    "robot",
    "goal",
    "start",
)
# Further options that need a run that starts the societies: field and option name.
STARTING: Final = {"without": "without", "besides": "with"}


def drive(args: Options, scenario: Scenario, chosen: Chosen) -> int:
    """Run the fleet; return 0 only if all tasks were done, none twice, without collisions.

    Returns `options.UNKNOWN` if that is not known.
    """
    from armadico.cli.run import exit_code

    for option in ALONE:
        if getattr(args, option) not in (None, False):
            raise UsageError(
                f"--{option} is for the run of one robot, and {scenario.name} is a fleet's"
            )
    for option, words in STARTING.items() if args.attach else ():
        if getattr(args, option):
            raise UsageError(
                f"--{words} is for the command that starts the societies (armadico up);"
                " --attach starts none"
            )
    if args.replace and not args.attach:
        raise UsageError("--replace is for a fleet that is up: --attach")
    if args.attach and args.robots is not None and args.robots < 1:
        raise UsageError(f"--robots {args.robots}: at least 1 is waited for")
    seed = scenario.seed if args.seed is None else args.seed
    start = args.starting(scenario, (seed,), alone=False)
    checked(args.additions, start)
    chosen = replace(chosen, seed=seed)
    label = scenario.name if args.attach else f"{scenario.name} seed {seed}"
    say = _Lines(label)
    drive = _virtual if args.virtual else _attached if args.attach else _live
    faults: list[str] = []
    result = drive(args, scenario, chosen, start, say.show, faults.append)
    if args.json:
        import msgspec

        print(json.dumps(msgspec.to_builtins(result)))
    else:
        _table(result, label)
    if result.undecided:
        options.report(f"{scenario.name}: {result.undecided}")
    if faults:
        raise options.FailedError("\n".join(faults))
    return exit_code(args, result.judgement)


def fleet_of(mesh: options.Mesh) -> str:
    """Return the fleet's name: the robots' namespaces are in it."""
    from armadico.agents.fleet.commands.run import FLEET

    name = mesh.namespace
    return FLEET if name == DEFAULT_NAMESPACE else checked_namespace(name)


def _virtual(
    args: Options,
    scenario: Scenario,
    chosen: Chosen,
    start: Start,
    progress: Callable[[FleetWatch], None],
    report: Callable[[str], None],
) -> FleetResult:
    from armadico.agents.fleet.commands.run import FleetRehearsal

    rehearsal = FleetRehearsal(scenario, chosen, args.robots, fleet_of(args.mesh))
    start = replace(start, on=rehearsal.mesh, namespaces=rehearsal.names)
    with recording(args.additions, start, report):
        return rehearsal.run(progress if sys.stderr.isatty() else None, options.report)


def _live(
    args: Options,
    scenario: Scenario,
    chosen: Chosen,
    start: Start,
    progress: Callable[[FleetWatch], None],
    _: Callable[[str], None],
) -> FleetResult:
    from armadico.agents.fleet.commands.local_fleet import LocalFleet
    from armadico.agents.fleet.commands.run import names_of, robots_of

    check_connect(args)
    options.end_as_by_ctrl_c()
    fleet, joining = fleet_of(args.mesh), args.mesh.endpoints().words
    robots = names_of(fleet, len(robots_of(scenario, args.robots)))
    start = replace(start, namespaces=robots)
    try:
        run = LocalFleet(scenario, chosen, args.robots, fleet, _joiner(args.mesh), joining)
        with beside(args.additions, start), run:
            options.report(
                f"{scenario.name}: starting {len(robots)} robots: {', '.join(robots)}; until it"
                f" ends well, logs are in {run.table.logs}"
            )
            return run.run(progress, options.report)
    except KeyboardInterrupt:
        options.report(
            f"{scenario.name}: interrupted; all that it started has ended, nothing is measured"
        )
        raise


def _attached(
    args: Options,
    scenario: Scenario,
    chosen: Chosen,
    start: Start,
    progress: Callable[[FleetWatch], None],
    _: Callable[[str], None],
) -> FleetResult:
    from armadico.agents.fleet.commands.attached_fleet import AttachedFleet

    options.end_as_by_ctrl_c()
    run = AttachedFleet(
        *(scenario, chosen, args.robots, fleet_of(args.mesh), _joiner(args.mesh)),
        scouts=_scouts(args.mesh),
        replace=args.replace,
    )
    run.report_to(options.report)
    with run:
        run.find()
        options.report(f"{scenario.name}: by the robots {', '.join(run.names)}")
        with beside(args.additions, replace(start, namespaces=run.names)):
            return run.run(progress)


def _joiner(mesh: options.Mesh) -> Callable[[str], Mesh]:
    """Return a function that joins the mesh in a robot's namespace."""

    def join(namespace: str) -> Mesh:
        found = mesh.of(namespace).join(starts=True)  # the run reports missing agents
        found.open()
        return found

    return join


def _scouts(mesh: options.Mesh) -> Callable[[], Iterator[Mesh]]:
    """Return a function that yields an open mesh for each new router of the fleet."""
    from armadico.agents.fleet.commands.run import names_of
    from armadico.mesh.sockets import peers_here

    where = mesh.endpoints()
    named = where.connect or (() if where.table is None else where.table.fleet)
    name, known = names_of(fleet_of(mesh), 1)[0], set[str]()

    def scouts() -> Iterator[Mesh]:
        for endpoint in {*named, *(() if where.connect else peers_here(name))} - known:
            known.add(endpoint)
            scout = Endpoints(namespace=name, connect=(endpoint,)).mesh(starts=True)
            scout.open()
            yield scout

    return scouts


class _Lines:
    def __init__(self, label: str) -> None:
        self._label = label
        self._printed_at = float("-inf")

    def show(self, watch: FleetWatch) -> None:
        """Print a line on stderr every `LINE_S`."""
        if watch.began is not None and watch.now - self._printed_at >= LINE_S:
            self._printed_at = watch.now
            options.report(f"{self._label} {watch.now - watch.began:6.1f} s  {watch.remark}")


def _table(result: FleetResult, label: str) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=label)
    for column in ("robot", "tasks", "way m", "collisions", "run into", "clearance m"):
        table.add_column(column, justify="left" if column in {"robot", "tasks"} else "right")
    for row in result.robots:
        least = "" if row.min_clearance_m is None else f"{row.min_clearance_m:.2f}"
        did = " ".join(map(str, row.tasks))
        touched = ["" if count is None else str(count) for count in (row.collisions, row.bumped)]
        table.add_row(row.robot, did, f"{row.way_m:.1f}", *touched, least)
    Console().print(table)
    print(result.verdict)
    if result.judgement.answer == "no":
        print(f"no: {result.judgement.reason}")
