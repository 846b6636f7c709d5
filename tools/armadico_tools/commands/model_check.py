"""Explore every run of the coordination up to a number of faults."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, at_least, group, option, several
from armadico.core.errors import no_such
from armadico.core.judgement import Judgement, no, unknown, yes
from armadico_tools.command_options import Series

if TYPE_CHECKING:
    from armadico_tools.explore.search import Found, Limits
    from armadico_tools.explore.world import Setup

EXAMPLES: Final = """\
  armadico model-check                             two contenders, one fault: a few minutes
  armadico model-check --faults 2 --kind crash --kind owner
  armadico model-check --contenders 3 --cycles 30
"""

SHOWN: Final = 3

BIDS: Final[dict[int, tuple[str, ...]]] = {
    2: ("0.6 0.5", "0.5 0.6", "0.5 0.53", "0.5 0.5", "0.5 0.5!", "0.6 0", "0.6 -", "- -"),
    3: ("0.6 0.5 0.53", "0.5 0.5 0.5", "0.5 0.5! 0.6", "0.6 0 -"),
}
"""Initial bids, by number of contenders."""

STAGGERS: Final[dict[int, tuple[tuple[int, ...], ...]]] = {2: ((0, 8), (8, 0)), 3: ((16, 8, 0),)}
"""Delay from the owner's cycle to each contender, in 1/1024 s, for the first bids."""


@dataclass(frozen=True, kw_only=True)
class Options:
    contenders: int = option("number (default: 2)", default=2, choices=(2, 3))
    faults: int = option(
        "at most F faults per run (default: 1)", default=1, metavar="F", must=at_least(0)
    )
    cycles: int | None = option(
        "limit runs to N cycles (default: until no new state can occur)",
        metavar="N",
        must=at_least(1),
    )
    kind: tuple[str, ...] = several(
        "use only fates (of messages), crash, owner, cut, hang, bids, rise, stop; repeatable",
        metavar="K",
    )
    series: Series = group(Series)


def run(args: Options) -> int:
    """Explore all runs; the exit code is that of `judged`."""
    from armadico_tools.explore.search import Limits
    from armadico_tools.explore.world import KINDS

    for kind in args.kind:
        if kind not in KINDS:
            raise UsageError(no_such("kind of fault", kind, KINDS))
    limits = Limits(args.faults, args.cycles)
    tasks = [(setup, limits) for setup in _setups(args.contenders, args.kind or KINDS)]
    results: list[Found] = []
    began = time.monotonic()
    from armadico_tools.series import over

    with args.series.workers() as where:
        complete = over(_explored, tasks, where, "setups", lambda _, found: results.append(found))
    _report(results, args, time.monotonic() - began, complete=complete)
    if not complete:
        return options.INTERRUPTED
    return judged(results).exit_code


def judged(results: Sequence[Found]) -> Judgement:
    """Whether no run breaks a promise; unknown if runs were left out by `--cycles`."""
    if broken := sum(len(found.broken) for found in results):
        return no(f"{broken} counterexamples")
    if left := sum(not found.closed for found in results):
        what = f"{left} of {len(results)} setups were not explored until they recover"
        return unknown(what, "run it without --cycles")
    return yes() if results else unknown("nothing was explored")


main = Command(
    "armadico model-check",
    Options,
    run,
    "Explore every run of real contenders and a real owner with at most F faults: each message"
    " lost, late or twice, a crash and restart of a contender or of the owner, a hang, a"
    " partition, a stop, another bid, bids that rise together. Equal worlds are explored once."
    " Counterexamples are printed as Python, the shortest first. Exit code 1 if there is one, 3 if"
    " --cycles left runs out.",
    EXAMPLES,
)


def _explored(task: tuple[Setup, Limits]) -> Found:
    from armadico_tools.explore.search import Search

    return Search(*task).run()


def _setups(contenders: int, kinds: tuple[str, ...]) -> list[Setup]:
    from armadico_tools.explore.world import Setup

    bids = [tuple(each.split()) for each in BIDS[contenders]]
    chosen = [Setup(each, kinds=kinds) for each in bids]
    chosen += [Setup(bids[0], stagger, kinds=kinds) for stagger in STAGGERS[contenders]]
    return [*chosen, Setup(bids[0], apart=True, kinds=kinds)]


def _report(results: list[Found], args: Options, seconds: float, *, complete: bool) -> None:
    from msgspec import to_builtins

    broken = sorted((one for found in results for one in found.broken), key=lambda one: one.size)
    states = sum(found.states for found in results)
    closed = all(found.closed for found in results)
    whole = complete and closed  # else no run was followed until it recovers
    starved = max((found.starved for found in results), default=0) if whole else None
    unsettled = max((found.unsettled for found in results), default=0) if whole else None
    judgement = judged(results) if complete or broken else unknown("interrupted")
    if args.series.json:
        examples = [
            {"faults": b.size[0], "cycles": b.size[1], "promise": b.promise, "run": repr(b.run)}
            for b in broken
        ]
        found: dict[str, object]
        found = {"setups": len(results), "states": states, "closed": closed}
        found |= {"starved_cycles": starved, "unsettled_cycles": unsettled}
        ended = {"complete": complete, "seconds": round(seconds, 1)}
        ended |= {"judgement": to_builtins(judgement)}
        print(json.dumps({**found, "counterexamples": examples, **ended}))
        return
    print(
        f"{args.contenders} contenders, at most {args.faults} faults:"
        f" {len(results)} setups, {states} states, {seconds:.0f} s"
    )
    if complete and closed and not broken:
        print(f"longest time without a valid command: {starved} cycles")
        print(f"longest time to settle after the last fault: {unsettled} cycles")
    for one in broken[:SHOWN]:
        print(f"\n# {one.promise}: {one.how}; {one.size[0]} faults, {one.size[1]} cycles")
        print("# replay (armadico_tools.explore.replay) repeats it:")
        print(one.run)
    if complete and not broken:
        print("no promise was broken" if judgement.passed else judgement)
