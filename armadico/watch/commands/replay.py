"""Replay a recording and compare the agents' decisions, optionally with changed parameters."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from heapq import merge
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.child import collect_seldom
from armadico.cli import options
from armadico.cli.options import UnknownError, UsageError
from armadico.cli.parsing import FILE, Command, argument, at_least, flag, more_than, option, several

if TYPE_CHECKING:
    from armadico.core.messages import BidRecord
    from armadico.observe.journals import Journal
    from armadico.watch.recordings import Past
    from armadico.watch.replay import Difference, Moment, Outcome, Replay

WORTH: Final = 4_000_000
"""Bytes of journals from which several processes are used: each takes a second to start."""

EXAMPLES: Final = """\
  armadico run sc4 --record run.mcap && armadico replay run.mcap
  armadico replay run.mcap --agent goto --agent avoid
  armadico replay run.mcap --set goto.v_max=0.3             goto's decisions with this limit
  armadico replay run.mcap --agent goto --rate 1            in real time, bid by bid
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    file: Path = argument("the recording", metavar="FILE.mcap", must=FILE)
    agents: tuple[str, ...] = several(
        "replay only this agent, by name or instance; may be repeated",
        "--agent",
        either="who",
        metavar="NAME",
    )
    all: bool = flag("replay all agents (the default)", either="who")
    namespace: str | None = option("replay only this robot (default: all)", metavar="NS")
    sets: tuple[str, ...] = several(
        "change a parameter; KEY=VALUE with one --agent; may be repeated",
        "--set",
        metavar="AGENT.KEY=VALUE",
    )
    rate: float | None = option(
        "replay at X times real time and print each new bid (default: as fast as possible)",
        metavar="X",
        must=more_than(0),
    )
    jobs: int | None = option(
        "use N processes (default: one a core)", metavar="N", must=at_least(1)
    )
    json: bool = flag("print one JSON object")


def run(args: Options) -> int:
    """Returns 0 only if all chosen agents were replayed to their ends with the same decisions.

    With `--set` those that it changes are judged alone, and their decisions may differ. The missing
    decisions of a damaged recording are unknown.
    """
    options.need("mcap", "record")
    from armadico.watch.recordings import Past, RecordingError

    try:
        past = Past(args.file, options.reporter("armadico replay"))
        past.check()
        journals = _chosen(args, past)
        damage = tuple(past.damage)
    except RecordingError as error:
        raise UsageError(str(error)) from None
    sets = _sets(args, journals)
    begun = time.monotonic()
    if args.rate is None:
        outcomes = _all(args.jobs, journals, sets)
    else:
        outcomes = _paced(args.rate, journals, sets)
    took = time.monotonic() - begun
    if args.json:
        print(_json(past, damage, outcomes, took))
    else:
        _show(past, outcomes, took)
        if damage:
            print("The recording is damaged: missing messages were not compared.")
    judged = [each for each in outcomes if each.name in sets] if args.sets else outcomes
    whole = all((args.sets or each.equal) and not each.refusal and not each.end for each in judged)
    if not whole:
        return options.FAILED
    return options.UNKNOWN if damage else 0


def _chosen(args: Options, past: Past) -> list[Journal]:
    """The journals to replay. Raises UsageError if one is not in the recording."""
    found = past.journals()
    spaces = sorted({journal.namespace for journal in found})
    if not found:
        raise (UnknownError if past.damage else UsageError)(f"{args.file} holds no agents")
    if args.namespace is not None and args.namespace not in spaces:
        raise UsageError(
            f"--namespace {args.namespace}: not in {args.file}, which holds {', '.join(spaces)}"
        )
    found = [each for each in found if args.namespace in (None, each.namespace)]
    for name in args.agents:
        if not any(name in (each.name, each.instance) for each in found):
            names = ", ".join(sorted({each.name for each in found}))
            raise UsageError(f"--agent {name}: not in {args.file}, which holds {names}")
    if args.agents:
        found = [each for each in found if {each.name, each.instance} & {*args.agents}]
    if not any(each.frames for each in found):
        raise UsageError(f"{args.file} cannot be replayed: {found[0].fault}")
    return found


def _sets(args: Options, journals: Sequence[Journal]) -> dict[str, tuple[str, ...]]:
    """The settings by agent. Raises UsageError, ConfigError."""
    from armadico.watch.replay import Life, ReplayError

    names = {journal.name for journal in journals}
    found: dict[str, tuple[str, ...]] = {}
    for setting in args.sets:
        agent, dot, rest = setting.partition(".")
        key = setting.partition("=")[0]
        if not (dot and agent in names and "." in key):
            if len(names) != 1:
                keys = ".KEY=, ".join(sorted(names))
                raise UsageError(f"--set {setting}: name the agent: {keys}.KEY=")
            agent, rest = next(iter(names)), setting
        found[agent] = (*found.get(agent, ()), rest)
    for journal in journals:
        if journal.name in found:
            with suppress(ReplayError):  # reported with the results
                Life(journal, found[journal.name])
    return found


def _one(item: tuple[Journal, tuple[str, ...]]) -> Outcome:
    from armadico.watch.replay import replayed

    collect_seldom()
    return replayed(*item)


def _all(
    jobs: int | None, journals: Sequence[Journal], sets: dict[str, tuple[str, ...]]
) -> list[Outcome]:
    from armadico.cli.pool import over

    # The longest first, or the pool waits for it at the end.
    journals = sorted(journals, key=lambda each: -each.frames.size)
    worth = sum(journal.frames.size for journal in journals) >= WORTH
    jobs = jobs or (len(os.sched_getaffinity(0)) if worth else 1)
    items = [(journal, sets.get(journal.name, ())) for journal in journals]
    found = over(_one, items, jobs, "replay")
    return sorted(found, key=lambda outcome: (outcome.namespace, outcome.began, outcome.instance))


def _paced(
    rate: float, journals: Sequence[Journal], sets: dict[str, tuple[str, ...]]
) -> list[Outcome]:
    """Replay all agents together in the order of time, at `rate` times real time."""
    from armadico.watch.replay import Replay

    replays = [Replay(journal, sets.get(journal.name, ())) for journal in journals]
    first = min((each.began for each in replays if not each.refusal), default=0.0)
    begun = time.monotonic()
    printed: dict[str, object] = {}
    for at, replay, moment in merge(*map(_timed, replays), key=lambda item: item[0]):
        wait = (at - first) / rate - (time.monotonic() - begun)
        if wait > 0:
            time.sleep(wait)
        for bid in moment.bids:
            news = (bid.resource, bid.utility is None, bid.critical, bid.reason)
            if printed.get(replay.journal.instance) != news:
                printed[replay.journal.instance] = news
                name = f"{replay.journal.name:<14}"
                print(f"{at - first:9.2f} s  {name} {options.shown(_bid(bid))}", flush=True)
    return [replay.outcome() for replay in replays]


def _timed(replay: Replay) -> Iterator[tuple[float, Replay, Moment]]:
    for moment in replay.moments():
        yield replay.began + moment.at, replay, moment


def _bid(bid: BidRecord) -> str:
    if bid.utility is None:
        return f"no bid for {bid.resource}: {bid.reason}"
    wanted = bid.wanted.hex() if isinstance(bid.wanted, bytes) else _numbers(bid.wanted)
    critical = ", critical" if bid.critical else ""
    why = f": {bid.reason}" if bid.reason else ""
    return f"bids {bid.utility:.2f}{critical} for {bid.resource} ({wanted}){why}"


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


# Results ------------------------------------------------------------------------------------------


def _show(past: Past, outcomes: Sequence[Outcome], took: float) -> None:
    """Print a line for each agent, then the differences."""
    several = len({outcome.namespace for outcome in outcomes}) > 1
    counts = Counter((outcome.namespace, outcome.name) for outcome in outcomes)
    labels = []
    for outcome in outcomes:
        alone = counts[outcome.namespace, outcome.name] == 1
        name = outcome.name if alone else outcome.instance
        labels.append(f"{outcome.namespace}/{name}" if several else name)
    width = max(map(len, labels))
    for label, outcome in zip(labels, outcomes, strict=True):
        print(options.shown(f"{label:<{width}} {_verdict(past, outcome)}"))
    for note in dict.fromkeys(note for outcome in outcomes for note in outcome.notes):
        print(options.shown(f"note: {note}"))
    for outcome in outcomes:
        if outcome.difference is not None:
            print(_described(past, outcome, outcome.difference))
    print(_summary(outcomes, took))


def _verdict(past: Past, outcome: Outcome) -> str:
    if outcome.refusal:
        return f"not replayed: {outcome.refusal}"
    row = f"{outcome.seconds:8.1f} s  {outcome.inputs:>7} in  {outcome.outputs:>6} out  "
    if outcome.equal:
        row += "equal"
    elif outcome.difference is None:
        row += "nothing to compare"
    else:
        at = _since(past, outcome, outcome.difference)
        row += f"differs from {at:.2f} s on, at {outcome.different} moments"
    return row + (f"; then {outcome.end}" if outcome.end else "")


def _since(past: Past, outcome: Outcome, difference: Difference) -> float:
    """The time of a difference, s since the recording's first message."""
    return outcome.began + difference.at - past.began


def _described(past: Past, outcome: Outcome, difference: Difference) -> str:
    at = _since(past, outcome, difference)
    lines = [
        f"{outcome.instance} at {at:.3f} s of the recording, {difference.at:.3f} s after its"
        f" start, after {difference.output} equal outputs:"
    ]
    for title, items in (
        ("inputs", difference.inputs),
        ("recorded", difference.then),
        ("replayed", difference.now),
    ):
        lines += [f"  {title:<12} {item}" for item in items or ("nothing",)]
    return "\n".join(map(options.shown, lines))


def _summary(outcomes: Sequence[Outcome], took: float) -> str:
    replayed = [outcome for outcome in outcomes if not outcome.refusal]
    outputs = sum(outcome.outputs for outcome in replayed)
    equal = sum(outcome.equal for outcome in replayed)
    longest = max((outcome.seconds for outcome in replayed), default=0.0)
    rest = len(outcomes) - len(replayed)
    line = f"{equal} of {len(replayed)} agents equal, {outputs} outputs"
    line += f", {longest:.1f} s in {took:.1f} s ({longest / max(took, 1e-9):.0f} times as fast)"
    return line + (f"; {rest} not replayed" if rest else "")


def _json(past: Past, damage: Sequence[str], outcomes: Sequence[Outcome], took: float) -> str:
    import msgspec

    rows = [
        {**msgspec.to_builtins(outcome), "equal": outcome.equal, "at": outcome.began - past.began}
        for outcome in outcomes
    ]
    about = {"file": str(past.path), "took_s": took, "recorded": past.about, "damage": damage}
    return json.dumps({**about, "agents": rows})


main: Final = Command(
    "armadico replay",
    Options,
    run,
    "Create the agents of a recording again, give them the recorded inputs at the recorded times,"
    " and compare their outputs message by message. The recording must be of `armadico run"
    " --record`, or of agents that were started with --journal.",
    EXAMPLES,
)
