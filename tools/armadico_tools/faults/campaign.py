"""The work of `armadico faults`: run seeds, a case or trials, check a recording, print results."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Final

import msgspec
from rich.console import Console
from rich.table import Table

from armadico.cli import options, pool
from armadico.cli.options import FailedError, UsageError
from armadico.cli.pool import Pool
from armadico.config.hosts import load_hosts
from armadico.config.loading import read_text
from armadico.config.scenarios import load_scenario
from armadico.core.config_errors import ConfigError
from armadico.core.errors import no_such
from armadico.core.judgement import Answer, Judgement, all_of, no, unknown, yes
from armadico.core.mechanisms import coordinations
from armadico.core.messages import Ack, Description, Message, RobotState
from armadico.mobile.messages import Truth
from armadico.observe.audit.promises import Excuse
from armadico.observe.conditions import software
from armadico_tools.faults import MINUTES, SEEDS, plan, series, shrink, workload
from armadico_tools.faults import TRIALS as COUNT
from armadico_tools.faults.checker import OF_BALLOTS, Checker, Violation
from armadico_tools.faults.fault_types import KINDS, Promise
from armadico_tools.faults.live import ROAD
from armadico_tools.faults.plan import Outcome
from armadico_tools.faults.planted import DEFECTS, Found
from armadico_tools.faults.series import EVERYTHING, Ledger, Line, Only, Summary
from armadico_tools.faults.sightings import Sight
from armadico_tools.faults.trials import TABLE, TRIALS, Trial, place_for
from armadico_tools.faults.trials import run_trials as make_trials
from armadico_tools.faults.variants import VARIANTS, among, check_coordination
from armadico_tools.faults.workload import End
from armadico_tools.hosts.namespaces import lacking
from armadico_tools.testbed import TABLE as HOSTS

if TYPE_CHECKING:
    from armadico_tools.faults.options import Options

SHRUNK: Final = 3
"""Most cases with a broken promise that are shrunk."""

VOID_GOAL: Final = 0.02
"""The share of the moving time in which contacts may be void."""

SHOWN: Final = 10
"""Most violations of a recording that are printed; --json has them all."""


def kinds(*, live: bool) -> Mapping[str, object]:
    """The kinds of trials, or of faults, by name."""
    return TRIALS if live else KINDS


def show_kinds(*, live: bool, as_json: bool) -> int:
    promises = {promise.name: promise.value for promise in Promise}
    if as_json:
        texts = {t.name: t.text for t in TRIALS.values()} if live else _meanings()
        variants = {} if live else {"variants": _variants(), "planted": _planted()}
        print(json.dumps({"kinds": texts, **variants, "promises": promises}))
        return 0
    if live:
        for trial in TRIALS.values():
            root = "; needs hosts, so root" if trial.hosts else ""
            print(f"{trial.name:<16} {trial.text}{root}")
            for figure in trial.figures:
                print(f"    {figure.name}: {figure.text}{_aim(figure.median, figure.worst)}")
        return 0
    lists = (
        *(("kinds of faults", _meanings()), ("variants", _variants()), ("promises", promises)),
        ("defects that can be planted", _planted()),
    )
    for title, texts in lists:
        print(title)
        for name, text in texts.items():
            print(f"  {name:<18} {text}")
    return 0


def _meanings() -> dict[str, str]:
    return {kind.name: kind.meaning for kind in KINDS.values()}


def _variants() -> dict[str, str]:
    return {variant.name: variant.meaning for variant in VARIANTS.values()}


def _planted() -> dict[str, str]:
    return {name: defect.text for name, defect in DEFECTS.items()}


def _aim(median: float | None, worst: float | None) -> str:
    aims = (("median", median), ("worst", worst))
    parts = [f"{value:g} ms {name}" for name, value in aims if value is not None]
    return f" (aim: {', '.join(parts)})" if parts else ""


def repeat(given: str, *, as_json: bool) -> int:
    """Repeat one case. Raises ConfigError for an invalid one."""
    text = given
    if not given.lstrip().startswith("{"):
        try:
            text = read_text(given)
        except ConfigError as error:
            raise ConfigError(f"neither a case as JSON nor a file of one: {error}") from None
    outcome = workload.run(plan.loads(text))
    if as_json:
        found = {"violations": outcome.violations, "longest_to_move_s": outcome.longest_s}
        print(json.dumps(found))
        return 1 if outcome.violations else 0
    for fault in outcome.case.faults:
        targets = ", ".join(fault.targets) + (f" to {', '.join(fault.to)}" if fault.to else "")
        print(f"{fault.at:9.3f} s  {fault.kind} for {fault.lasts:.3f} s: {targets}")
    for promise, at, what in outcome.violations:
        print(f"{at:9.3f} s  {promise} broken: {what}")
    if not outcome.violations:
        print("no promise was broken")
    return 1 if outcome.violations else 0


UNSEEN: Final[Mapping[type[Message], tuple[str, str]]] = {
    RobotState: ("stops and speeds are", "robot/state"),
    Ack: ("which agent was obeyed is", "acks"),
    Truth: ("collisions are", "truth of this robot"),
    Description: ("ramps are", "description of the robot"),
}
"""What the checker cannot judge without the messages of a kind."""


def check_recording(path: Path, namespace: str | None, *, as_json: bool) -> int:
    from armadico.watch.recordings import RecordingError, UnreadError
    from armadico_tools.faults.recording import UNRECORDED, check

    damage: list[str] = []
    broken: list[Violation] = []
    without: dict[Promise, str] = {}
    longest_s: float | None = None
    try:
        checker = check(path, namespace, damage.append)
    except UnreadError as error:
        judgement = unknown(str(error))
    except RecordingError as error:
        raise UsageError(str(error)) from None
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from None
    else:
        broken, longest_s = checker.violations, checker.longest
        kept = no(f"{len(broken)} promises broken") if broken else yes()
        judgement = all_of((kept, *(unknown(what) for what in _unseen(checker, damage))))
        without |= dict.fromkeys(UNRECORDED, "no recording can show it")
        if checker.record.bounds.coordination:
            without |= dict.fromkeys(OF_BALLOTS, "it is a rule of ballots")
    if as_json:
        found = {
            "violations": [{"promise": v.promise, "at": v.at, "text": v.text} for v in broken],
            "longest_s": longest_s,
            "not_checked": {promise.name: why for promise, why in without.items()},
            "judgement": msgspec.to_builtins(judgement),
        }
        print(json.dumps(found, indent=2))
        return judgement.exit_code
    print(f"promises broken: {len(broken)}")
    for violation in broken[:SHOWN]:
        print(f"  {violation.promise}: {violation.text}")
    for promise, why in without.items():
        print(f"not checked, since {why}: {promise.value}")
    if judgement.answer is Answer.UNKNOWN:
        print(f"unknown: {judgement.reason}")
    return judgement.exit_code


def _unseen(checker: Checker, damage: Sequence[str]) -> Iterator[str]:
    """What is not known of a recording that the checker has read, and why."""
    yield from damage
    for kind, (what, name) in UNSEEN.items():
        if kind not in checker.received:
            yield f"{what} unknown: the recording has no {name}"
        elif gap := checker.auditor.gaps(kind, begun=checker.began):
            yield f"{what} unknown: {gap}"
    for each in checker.auditor.report():
        if each.answer is Answer.UNKNOWN and each.occasion:
            yield f"{each.promise}: {each.text}"


def run_seeds(args: Options) -> int:
    """Run seeds on the virtual mesh; Ctrl-C ends with the counts so far."""
    ledger = _ledger(args.out, series.SEEDS)
    given = args.virtual
    first = ledger.next_seed() if given.first is None else given.first
    lasts = 60.0 * (given.minutes or MINUTES)
    seeds = range(first, first + (given.seeds or SEEDS))
    only = _only(args)
    tasks = [series.Task(seed, lasts, only, strict=given.excuses) for seed in seeds]
    unchecked = {} if only.coordination is None else OF_BALLOTS
    summary = Summary(narrowed=only != EVERYTHING, unchecked=unchecked)

    def done(_task: series.Task, outcome: Outcome) -> None:
        summary.add(outcome)

    def new(task: series.Task, outcome: Outcome) -> None:
        _keep(ledger, outcome, task.only.kinds)

    with args.series.workers() as where:
        complete = _continue(args, where, tasks, done, new)
    commands, judgement = _commands(summary) if complete else [], judged(summary)
    if args.series.json:
        told = {"repeat": commands, "judgement": msgspec.to_builtins(judgement)}
        print(json.dumps({**summary.plain(), **told}))
    else:
        _show_seeds(summary, commands)
        if given.excuses:
            _show_excuses(summary)
        seeds_run, broken = ledger.count()
        print(f"{ledger.path}: {seeds_run} seeds on this commit, {broken} broke a promise")
        if judgement.answer is Answer.UNKNOWN:
            print(f"unknown: {judgement.reason}")
    return judgement.exit_code if complete else options.INTERRUPTED


def judged(summary: Summary) -> Judgement:
    """Whether no promise was broken, by seeds that could have shown it.

    A contact that is void says nothing about the robot, so too many of them leave it unknown.
    """
    found = [no(f"{len(summary.broken)} seeds broke a promise")] if summary.broken else [yes()]
    found += [no(f"never occurred: {sight.value}") for sight in series.missing(summary)]
    share = summary.void_share()
    if share is None:
        found.append(unknown("the share of void contacts: no robot moved in a world with walls"))
    elif share > VOID_GOAL:
        what = f"contacts were void for {share:.1%} of the moving time (goal: {VOID_GOAL:.0%})"
        found.append(unknown(what))
    return all_of(found)


def _only(args: Options) -> Only:
    """What seeds do not draw. Raises here, not in a worker, if there is none of a name."""
    given = args.virtual
    variants = among(given.variant, args.scenario, given.robot)
    if given.coordination:
        coordinations(given.coordination)
        check_coordination(given.coordination, variants, args.scenario, given.robot)
    return Only(args.kind, args.scenario, given.robot, given.variant, given.coordination)


def run_planted(args: Options) -> int:
    """Run seeds with defects, and with none; 1 if a defect was not found, or something without."""
    given = args.virtual
    if wrong := [name for name in given.planted if name not in ("all", *DEFECTS)]:
        raise UsageError(no_such("planted defect", wrong[0], ("all", *DEFECTS)))
    first, lasts = given.first or 0, 60.0 * (given.minutes or MINUTES)
    seeds = range(first, first + (given.seeds or SEEDS))
    names = ("", *(DEFECTS if "all" in given.planted else dict.fromkeys(given.planted)))
    found = {each: Found() for each in names}
    only = _only(args)

    outcomes: dict[series.Task, Outcome] = {}

    def done(task: series.Task, outcome: Outcome) -> None:
        outcomes[task] = outcome

    complete, batches = True, [[seed] for seed in seeds] if given.once else [[*seeds]]
    with args.series.workers() as where:
        for batch in batches:
            left = [each for each in names if not (each and given.once and found[each].found)]
            if not any(left):
                break
            # Faults excuse a robot from much, so every second seed is without.
            tasks = [
                series.Task(
                    *(seed, lasts, only, each),
                    calm=seed % 2 == 1 or given.monitored,
                    monitored=given.monitored,
                )
                for seed in batch
                for each in left
            ]
            complete = _continue(args, where, tasks, done)
            for task, outcome in outcomes.items():
                alone = outcomes.get(replace(task, planted="")) if task.planted else None
                found[task.planted].add(outcome, alone)
            outcomes.clear()
            if not complete:
                break
    if args.series.json:
        print(json.dumps({each or "none": vars(of) for each, of in found.items()}))
    else:
        _show_planted(found)
    if not complete:
        return options.INTERRUPTED
    missed = [each for each, of in found.items() if each and not of.found]
    return 1 if missed or found[""].found else 0


def _continue(
    args: Options,
    where: Pool,
    tasks: Sequence[series.Task],
    done: Callable[[series.Task, Outcome], None],
    new: Callable[[series.Task, Outcome], None] = lambda _task, _outcome: None,
) -> bool:
    """Run the tasks whose outcomes are not kept yet. Returns False if interrupted."""
    path = args.out / series.OUTCOMES
    try:
        return series.kept(path, series.Task.run, tasks, where, done, new)
    except OSError as error:
        raise FailedError(f"cannot keep results in {args.out}: {error}") from None


def _show_excuses(summary: Summary) -> None:
    table = Table("excuse", "seeds in which a promise would be broken without it")
    for excuse in Excuse:
        promises = summary.needed.get(excuse.name, Counter[str]())
        of = ", ".join(f"{name} {count}" for name, count in promises.most_common())
        table.add_row(excuse.name, of or "none: it was not needed")
    Console().print(table)


def _show_planted(found: Mapping[str, Found]) -> None:
    table = Table("planted", "found in", "after s (median)", "first by")
    for name, of in found.items():
        text = DEFECTS[name].text if name else "nothing: the product as it is"
        by = ", ".join(f"{promise} {count}" for promise, count in of.by.most_common())
        after = f"{median(of.first_s):.0f}" if of.first_s else "-"
        table.add_row(f"{name or 'none'}: {text}", f"{of.found} of {of.seeds}", after, by or "-")
    Console().print(table)


def run_trials(args: Options) -> int:
    """Run trials on real processes; on Ctrl-C what was measured is kept."""
    chosen = _chosen(args.kind)
    given = args.real
    scenario = load_scenario(args.scenario) if args.scenario else ROAD
    table, seed, count = load_hosts(HOSTS), given.seed or 0, given.trials or COUNT
    options.end_as_by_ctrl_c()
    ledger = _ledger(args.out, series.TRIALS)
    summary = Summary()

    def done(outcome: Outcome) -> None:
        summary.add(outcome)
        _keep(ledger, outcome)
        text = ", ".join(f"{name} {value:g}" for name, value in outcome.figures.items())
        made = len(summary.figures.get(outcome.kind, ()))
        options.report(f"{outcome.kind} {made}/{count}: {text}")

    try:
        with place_for(chosen, table, seed) as place:
            for trial in chosen:
                failed = make_trials(
                    trial,
                    place,
                    count,
                    done,
                    table=table,
                    scenario=scenario,
                    seed=seed,
                    record=given.record,
                )
                for why in failed:
                    options.report(f"{trial.name}: FAILED: {why}")
                if failed:
                    summary.failed[trial.name] = failed
    except KeyboardInterrupt:
        options.report(f"interrupted; results so far are in {ledger.path}")
        return options.INTERRUPTED
    lines = series.lines(summary, chosen)
    _show_trials(summary, lines, as_json=args.series.json)
    sound = lines and all(line.kept for line in lines)
    if not sound or summary.failed or summary.broken:
        return options.FAILED
    return options.UNKNOWN if len(chosen) < len(args.kind or TABLE) else 0


def _chosen(names: Sequence[str]) -> list[Trial]:
    """The named trials, or those of the table; without root those that need none."""
    chosen = [TRIALS[name] for name in names] or [*TABLE]
    trouble = lacking() if any(trial.hosts for trial in chosen) else None
    if trouble is None:
        return chosen
    able = [trial for trial in chosen if not trial.hosts]
    left_out = ", ".join(trial.name for trial in chosen if trial.hosts)
    if names or not able:
        can = ", ".join(name for name, trial in TRIALS.items() if not trial.hosts)
        raise FailedError(f"{left_out}: {trouble}. Possible without hosts: {can}")
    options.report(f"left out: {left_out}: {trouble}")
    return able


def _ledger(folder: Path, name: str) -> Ledger:
    try:
        return Ledger(folder, software().commit, name)
    except (OSError, ValueError) as error:
        raise FailedError(f"cannot keep results in {folder}: {error}") from None


def _keep(ledger: Ledger, outcome: Outcome, kinds: Sequence[str] = ()) -> None:
    try:
        ledger.add(outcome, kinds)
    except OSError as error:
        raise FailedError(f"cannot keep results in {ledger.path}: {error.strerror}") from None


def _commands(summary: Summary) -> list[str]:
    """For the first cases that broke a promise: the command that repeats a small one."""
    commands = []
    shrunk: set[str] = set()
    for outcome in summary.broken:
        promise = outcome.violations[0][0]
        if promise in shrunk or len(shrunk) >= SHRUNK:
            continue
        shrunk.add(promise)
        options.report(f"seed {outcome.case.seed} broke {promise}: shrinking")
        try:
            with pool.progress("runs, at most", shrink.TRIES) as step:
                case, _ = series.smallest(outcome, shrink.TRIES, step)
        except KeyboardInterrupt:
            case = outcome.case
        commands.append(f"armadico faults --repeat {shlex.quote(case.dumps())}")
    return commands


# Output -------------------------------------------------------------------------------------------


def _show_seeds(summary: Summary, commands: Sequence[str]) -> None:
    console = Console()
    minutes = summary.seconds / 60.0
    title = (
        f"{summary.seeds} seeds, {minutes:.0f} simulated minutes, {summary.driven_m:.0f} m driven"
    )
    table = Table("promise", "broken", title=title)
    for promise in Promise:
        count = summary.count(promise)
        table.add_row(promise.value, "not checked" if count is None else str(count))
    console.print(table)
    for promise, what in summary.unchecked.items():
        part = f" ({what})" if what else ""
        print(f"not checked, since it is a rule of ballots: {promise.value}{part}")
    counts = ", ".join(f"{kind} {summary.faults[kind]}" for kind in KINDS if summary.faults[kind])
    void, shares = summary.void_contacts(), summary.void_shares()
    reasons = ", ".join(f"{why} {count}" for why, count in void.items())
    by = ", ".join(f"{why} {share:.1%}" for why, share in shares.items())
    moving = sum(summary.moving_s.values())
    print(f"faults: {counts or 'none'}")
    _show_variants(console, summary)
    ends = ", ".join(f"{End[name].value} {count}" for name, count in summary.ends.items())
    hour = f"{summary.reached_per_hour():.1f} reached per simulated hour"
    print(f"missions: {hour}; {ends or 'none'}")
    print(f"longest time from healing to moving again: {summary.longest_s:.2f} s")
    print(
        f"longest drive with the pose wrong beyond its covariance: {summary.overconfident_s:.1f} s"
    )
    print(f"contacts {summary.contacts['']}, void {sum(void.values())}: {reasons or 'none'}")
    void_share = f"contacts void {_percent(summary)} of it (goal: {VOID_GOAL:.0%})"
    print(f"moving {moving:.0f} s, {void_share}: {by or 'never'}")
    table = Table("situation", "seen")
    for sight in Sight:
        table.add_row(sight.value, str(summary.sights[sight.name]))
    console.print(table)
    for sight in series.missing(summary):
        print(f"never occurred: {sight.value}")
    _show_broken(summary)
    for command in commands:
        print(command)


def _show_variants(console: Console, summary: Summary) -> None:
    table = Table("variant", *("seeds", "missions/h", "contacts", "void", "broken"))
    for name, part in sorted(summary.variants.items()):
        counts = str(part.seeds), f"{part.reached_per_hour():.1f}", str(part.contacts[""])
        table.add_row(name, *counts, _percent(part), str(len(part.broken)))
    console.print(table)


def _percent(summary: Summary) -> str:
    share = summary.void_share()
    return "unknown" if share is None else f"{share:.1%}"


def _show_trials(summary: Summary, lines: Sequence[Line], *, as_json: bool) -> None:
    if as_json:
        rows = [{**msgspec.to_builtins(line), "kept": line.kept} for line in lines]
        broken = [[o.kind, *violation] for o in summary.broken for violation in o.violations]
        found = {"lines": rows, "violations": broken, "failed": summary.failed}
        print(json.dumps(found, indent=2))
        return
    caption = "ms unless stated otherwise; armadico faults --live --list has the definitions"
    table = Table("kind", "figure", caption=caption)
    for title in ("trials", "median", "worst", "aim"):
        table.add_column(title, justify="right")
    for line in lines:
        aim = " / ".join("-" if v is None else f"{v:g}" for v in (line.aim_median, line.aim_worst))
        numbers = (str(line.trials), f"{line.median:g}", f"{line.worst:g}")
        style = None if line.kept else "bold red"
        table.add_row(line.kind, line.figure, *numbers, aim.replace("- / -", ""), style=style)
    Console().print(table)
    print(f"promises broken: {summary.violations.total()}")
    _show_broken(summary)


def _show_broken(summary: Summary) -> None:
    for outcome in summary.broken:
        for promise, at, what in outcome.violations:
            about = outcome.kind or f"seed {outcome.case.seed}"
            where = f"{outcome.case.scenario} {outcome.case.robot}".strip()
            where = where if outcome.kind else f"{outcome.case.variant}: {where}"
            print(f"{about} ({where}), {at:.2f} s: {promise}: {what}")
