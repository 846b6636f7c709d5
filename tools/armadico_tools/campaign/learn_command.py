"""Learn parameters or utilities of agents: a set with its history, and its test."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import BadValueError, Command, argument, flag, group, option, several
from armadico.core.errors import no_such
from armadico.launch.options import coordination_option
from armadico_tools.command_options import Series

if TYPE_CHECKING:
    from armadico_tools.campaign.learn import Driver, Search, Size, Tested
    from armadico_tools.campaign.utilities import Fitted
    from armadico_tools.experiments.driving import Cell

EXAMPLES: Final = """\
  armadico learn goto avoid --budget 1h        into results/learn/goto-avoid/learnt.toml
  armadico learn avoid --only avoid.v_top --budget 10m
  armadico learn auction --coordination auction --parameters thesis --budget 2000runs
  armadico run sc4 --virtual --parameters results/learn/goto-avoid/learnt.toml
  armadico learn --utilities goto avoid gothrough --world slalom --budget 10m
"""

WORLDS: Final = ("clutter", "slalom")
UNITS: Final = {"s": 1.0, "m": 60.0, "h": 3600.0}
BUDGET: Final = re.compile(r"(\d+(?:\.\d+)?)(s|m|h|runs)")


@dataclass(frozen=True)
class Budget:
    """Time of this computer's or the cluster's processes, s, or a number of runs."""

    seconds: float = 0.0
    runs: int = 0


def _budget(text: str) -> Budget:
    """Raises BadValueError."""
    found = BUDGET.fullmatch(text)
    if found is None or not float(found[1]):
        raise BadValueError(f"{text!r}: expected a time or a number of runs: 90s, 10m, 1h, 500runs")
    if found[2] == "runs":
        return Budget(runs=int(float(found[1])))
    return Budget(seconds=float(found[1]) * UNITS[found[2]])


@dataclass(frozen=True, kw_only=True)
class Options:
    agents: tuple[str, ...] = argument("agents whose parameters are learnt", nargs="+")
    budget: Budget = option(
        "search for this long (10m, 1h), or with so many runs (500runs): the latter is repeatable",
        metavar="BUDGET",
        read=_budget,
        default=Budget(seconds=3600.0),
    )
    utilities: bool = flag(
        "learn the utilities of their bids instead: the time that is saved if they drive, from runs"
        " in which chance decides at times; for --coordination learned"
    )
    only: tuple[str, ...] = several("learn these parameters; may be repeated", metavar="AGENT.KEY")
    world: tuple[str, ...] = several(
        f"in these generated worlds; may be repeated (default: {', '.join(WORLDS)})",
        metavar="WORLD",
    )
    parameters: str | None = option("begin with this set of parameters", metavar="SET")
    coordination: str | None = coordination_option("under this mechanism (default: ballots)")
    seed: int = option("another search, in other worlds (default: 0)", metavar="S", default=0)
    out: Path = option(
        "write folders of results into DIR (default: results/learn)",
        default=Path("results/learn"),
        metavar="DIR",
    )
    series: Series = group(Series)


def run(args: Options) -> int:
    """Search, test and write; 0 if the learnt set is better in unseen worlds, 3 if undecided."""
    options.need("cmaes", "tools")
    import msgspec

    from armadico.config.parameters import load_set
    from armadico.observe.conditions import source_hash
    from armadico_tools.campaign import learn
    from armadico_tools.experiments.driving import drive, scenario_of
    from armadico_tools.experiments.made_worlds import MADE
    from armadico_tools.experiments.runner import BESIDES, FOUND
    from armadico_tools.results import Kept, write_csv
    from armadico_tools.series import lost

    if args.utilities and (args.only or args.coordination):
        raise UsageError("--utilities learns no parameters: leave out --only and --coordination")
    worlds = args.world or WORLDS
    for world in worlds:
        if world not in MADE:
            raise UsageError(f"--world {no_such('generated world', world, MADE)}")
    given = load_set(args.parameters) if args.parameters else {}
    first, base = _cells(args, worlds[0], given)
    taking = scenario_of(first).agents
    for agent in args.agents:
        if agent not in taking:
            raise UsageError(no_such("agent in these runs", agent, taking))
    dims = [] if args.utilities else learn.dimensions(args.agents, args.only, given)
    folder = args.out / "-".join((*["utilities"] * args.utilities, *args.agents))
    try:
        kept = Kept(folder / FOUND, drive, source_hash(*BESIDES))
    except OSError as error:
        raise FailedError(f"cannot write to {folder}: {error.strerror}") from None
    with args.series.workers() as where:
        driver = learn.Driver(kept, where)
        size = learn.size_of(len(dims), 0)
        search = learn.Search(base, worlds, dims, size, driver, args.seed, first=first)
        search.size = _sized(args, search, driver)
        try:
            fitted = _utilities(args, search, driver, folder / FOUND) if args.utilities else []
            learnt = tuple(one.setting for one in fitted if one.weights) or search.run()
            result, samples = search.test(learnt)
        except BrokenExecutor as error:
            again = "finished runs are kept: the same command continues"
            raise FailedError(f"{lost(error)}; {again}") from None
    comments = _comments(args, search, result, fitted)
    (folder / "learnt.toml").write_text(learn.toml_of(learnt, comments), encoding="utf-8")
    for name, rows in (("history", fitted or search.history), ("test", samples)):
        head = rows[0].__struct_fields__ if rows else ()
        write_csv(folder / f"{name}.csv", head, map(msgspec.structs.astuple, rows))
    if args.series.json:
        found = {"set": str(folder / "learnt.toml"), "sets": learnt}
        print(json.dumps({**found, "test": msgspec.to_builtins(result)}))
    else:
        print("\n".join(comments))
        print(folder / "learnt.toml")
    better = result.better
    return options.UNKNOWN if better is None else 0 if better else options.FAILED


def _cells(args: Options, world: str, given: Mapping[str, Sequence[str]]) -> tuple[Cell, Cell]:
    """The first set, and what its changes are driven as."""
    from msgspec.structs import replace

    from armadico_tools.experiments.driving import Cell

    first = Cell("first", world=world, parameters=args.parameters, coordination=args.coordination)
    if not args.utilities:
        return first, first
    # Without weights the mechanism is refused: by ballots the agents' own utilities count.
    base = replace(first, coordination="learned")
    weighted = any(each.startswith("social.utility=") for of in given.values() for each in of)
    return (base if weighted else first), base


main = Command(
    "armadico learn",
    Options,
    run,
    "Learn numbers among agents' parameters by CMA-ES: clean runs first, then short ones. All"
    " candidates drive the same generated worlds; those that are clearly behind are left out. The"
    " middle of the last generation is compared with the first set in worlds that no candidate has"
    " seen. With --utilities, learn what their bids are worth by regression, and compare likewise."
    " An interrupted search with a budget of runs continues. Exit code 0 if the learnt set is"
    " better, 1 if it is worse, 3 if neither is shown.",
    EXAMPLES,
)


def _sized(args: Options, search: Search, driver: Driver) -> Size:
    """The search that the budget allows. Raises UsageError if nothing could be concluded."""
    from armadico_tools.campaign.learn import MEASURED, size_of

    numbers, runs = len(search.dims), args.budget.runs
    what = f"{numbers} numbers" if numbers else "utilities"
    least, cost, enough = size_of(numbers, 0).least, f" {runs}runs is", ""
    if not runs:
        each = driver.seconds_of([search.task((), index) for index in range(MEASURED)])
        runs = int(args.budget.seconds / each)
        cost = f": {runs} runs of {each:.2f} s are"
        enough = f"--budget {ceil(least * each / 60.0)}m, "
    if runs < least:
        raise UsageError(
            f"--budget{cost} too small to conclude anything about {what}: expected"
            f" {enough}--budget {least}runs{', or fewer numbers (--only)' * bool(numbers)}"
        )
    options.report(f"{what}, {runs} runs: --budget {runs}runs repeats this search")
    return size_of(numbers, runs)


def _utilities(args: Options, search: Search, driver: Driver, store: Path) -> list[Fitted]:
    """The utilities of the agents with enough episodes. Raises FailedError if none has."""
    from armadico.observe.conditions import source_hash
    from armadico_tools.campaign.utilities import EPISODES, explore, exploring, fit
    from armadico_tools.experiments.runner import BESIDES
    from armadico_tools.results import Kept

    kept = Kept(store, explore, source_hash(*BESIDES))
    runs = driver.each(explore, kept, exploring(search))
    fitted = fit([episode for run in runs for episode in run], args.agents)
    if not any(one.weights for one in fitted):
        counts = ", ".join(f"{one.agent} {one.episodes}" for one in fitted)
        raise FailedError(
            f"too few episodes in {len(runs)} runs: {counts}; expected {EPISODES} of an agent:"
            " choose a larger --budget"
        )
    return fitted


def _comments(args: Options, search: Search, result: Tested, fitted: list[Fitted]) -> list[str]:
    from armadico.observe.conditions import software

    ratio = ""
    if result.ratio is not None:
        ratio = (
            f"; driving time {result.ratio:.3f} of the first set's"
            f" [{result.ratio_low:.3f}, {result.ratio_high:.3f}]"
        )
    clear = ""
    if result.clearance is not None:
        clear = (
            f"; least clearance {result.clearance:+.3f} m"
            f" [{result.clearance_low:+.3f}, {result.clearance_high:+.3f}]"
        )
    how = f"{1 + max((step.generation for step in search.history), default=-1)} generations"
    if fitted:
        how = "episodes " + ", ".join(f"{one.agent} {one.episodes}" for one in fitted)
    agents = " ".join((*["--utilities"] * args.utilities, *args.agents))
    return [
        f"Learnt by armadico learn {agents} --budget {search.size.runs}runs --seed {args.seed}",
        f"commit {software().commit}; begun with {args.parameters or 'the defaults'}, worlds"
        f" {', '.join(search.worlds)}, {how} (history.csv)",
        f"{result.worlds} unseen worlds: clean {result.clean}, the first set"
        f" {result.clean_first}, difference {result.difference:+.3f}"
        f" [{result.low:+.3f}, {result.high:+.3f}], p {result.p:.3g}{ratio}",
        f"touched: {result.touched} runs, the first set {result.touched_first}{clear}",
        f"Verdict: {result.verdict}.{' For --coordination learned.' if fitted else ''}",
    ]
