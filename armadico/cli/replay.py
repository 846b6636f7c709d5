"""Go through a recording again: does every agent decide what it decided? What if it were set so?"""

from __future__ import annotations

import gc
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

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import FILE, Command, argument, at_least, flag, more_than, option, several

if TYPE_CHECKING:
    from armadico.core.messages import BidRecord
    from armadico.observe.journals import Journal
    from armadico.observe.recordings import Past
    from armadico.observe.replay import Difference, Moment, Outcome, Replay

WORTH: Final = 4_000_000
"""Bytes of journals from which on other processes are started to help: each takes a second."""

SELDOM: Final = 100_000
"""Objects after which it is looked for those that nobody needs: nearly never."""

EXAMPLES: Final = """\
  armadico run sc4 --record run.mcap && armadico replay run.mcap
  armadico replay run.mcap --agent goto --agent avoid
  armadico replay run.mcap --set goto.v_max=0.3             what would goto have decided?
  armadico replay run.mcap --agent goto --rate 1            as fast as it was, bid by bid
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    file: Path = argument("the recording", metavar="FILE.mcap", must=FILE)
    agents: tuple[str, ...] = several(
        "only this one, by name or instance; may be repeated",
        "--agent",
        either="who",
        metavar="NAME",
    )
    all: bool = flag("everybody (the default)", either="who")
    namespace: str | None = option("only this robot (default: all)", metavar="NS")
    sets: tuple[str, ...] = several(
        "a parameter that is otherwise; KEY=VALUE with one --agent; may be repeated",
        "--set",
        metavar="AGENT.KEY=VALUE",
    )
    rate: float | None = option(
        "X times as fast as it was, telling each new bid; without: as fast as can be",
        metavar="X",
        must=more_than(0),
    )
    jobs: int | None = option("processes (default: one a core)", metavar="N", must=at_least(1))
    json: bool = flag("one JSON object on stdout")


def run(args: Options) -> int:
    """0 only if every agent that was asked for was gone through, and decides what it did."""
    options.need("mcap", "record")
    from armadico.observe.recordings import Past, RecordingError

    try:
        past = Past(args.file, options.teller("armadico replay"))
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
            print("The recording is damaged: what is not in it was compared with nothing.")
    if args.sets:  # a question: it is answered if all were gone through who were set otherwise
        asked = [outcome for outcome in outcomes if outcome.name in sets]
        return options.FAILED if any(outcome.refusal for outcome in asked) else 0
    whole = all(outcome.equal and not outcome.end for outcome in outcomes)
    return 0 if whole and not damage else options.FAILED


def _chosen(args: Options, past: Past) -> list[Journal]:
    """Whom to go through. Raises UsageError if they are not in it."""
    found = past.journals()
    spaces = sorted({journal.namespace for journal in found})
    if not found:
        raise UsageError(f"{args.file} holds no agents")
    if args.namespace is not None and args.namespace not in spaces:
        raise UsageError(
            f"{args.file} holds nothing of the robot {args.namespace!r}: it is of"
            f" {', '.join(spaces)}"
        )
    found = [each for each in found if args.namespace in (None, each.namespace)]
    for name in args.agents:
        if not any(name in (each.name, each.instance) for each in found):
            there = ", ".join(sorted({each.name for each in found}))
            raise UsageError(f"--agent {name}: it is not in {args.file}; there are {there}")
    if args.agents:
        found = [each for each in found if {each.name, each.instance} & {*args.agents}]
    if not any(each.frames for each in found):
        raise UsageError(f"{args.file} cannot be replayed: {found[0].fault}")
    return found


def _sets(args: Options, journals: Sequence[Journal]) -> dict[str, tuple[str, ...]]:
    """By agent, what is set of it. Raises UsageError, ConfigError."""
    from armadico.observe.replay import Life, ReplayError

    names = {journal.name for journal in journals}
    found: dict[str, tuple[str, ...]] = {}
    for setting in args.sets:
        whose, dot, rest = setting.partition(".")
        key = setting.partition("=")[0]
        if not (dot and whose in names and "." in key):
            if len(names) != 1:
                there = ".KEY=, ".join(sorted(names))
                raise UsageError(f"--set {setting}: of which agent? {there}.KEY=")
            whose, rest = next(iter(names)), setting
        found[whose] = (*found.get(whose, ()), rest)
    for journal in journals:
        if journal.name in found:
            with suppress(ReplayError):  # which is told with the others'
                Life(journal, found[journal.name])
    return found


def _one(item: tuple[Journal, tuple[str, ...]]) -> Outcome:
    from armadico.observe.replay import replayed

    gc.collect()
    gc.freeze()
    gc.set_threshold(SELDOM)  # what agents leave behind is next to nothing: a tenth of the time
    return replayed(*item)


def _all(
    jobs: int | None, journals: Sequence[Journal], sets: dict[str, tuple[str, ...]]
) -> list[Outcome]:
    from armadico.cli.pool import over

    # The longest first, or the last one is waited for.
    journals = sorted(journals, key=lambda each: -each.frames.size)
    worth = sum(journal.frames.size for journal in journals) >= WORTH
    jobs = jobs or (len(os.sched_getaffinity(0)) if worth else 1)
    items = [(journal, sets.get(journal.name, ())) for journal in journals]
    found = over(_one, items, jobs, "replay")
    return sorted(found, key=lambda outcome: (outcome.namespace, outcome.began, outcome.instance))


def _paced(
    rate: float, journals: Sequence[Journal], sets: dict[str, tuple[str, ...]]
) -> list[Outcome]:
    """One after another would not be as it was: all at once, moment by moment."""
    from armadico.observe.replay import Replay

    replays = [Replay(journal, sets.get(journal.name, ())) for journal in journals]
    first = min((each.began for each in replays if not each.refusal), default=0.0)
    begun = time.monotonic()
    told: dict[str, object] = {}
    for at, replay, moment in merge(*map(_timed, replays), key=lambda item: item[0]):
        wait = (at - first) / rate - (time.monotonic() - begun)
        if wait > 0:
            time.sleep(wait)
        for bid in moment.bids:
            news = (bid.resource, bid.utility is None, bid.critical, bid.reason)
            if told.get(replay.journal.instance) != news:
                told[replay.journal.instance] = news
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


# What came of it ----------------------------------------------------------------------------------


def _show(past: Past, outcomes: Sequence[Outcome], took: float) -> None:
    """A line for each agent, then the differences."""
    several = len({outcome.namespace for outcome in outcomes}) > 1
    twice = Counter((outcome.namespace, outcome.name) for outcome in outcomes)
    called = []
    for outcome in outcomes:
        alone = twice[outcome.namespace, outcome.name] == 1
        who = outcome.name if alone else outcome.instance
        called.append(f"{outcome.namespace}/{who}" if several else who)
    wide = max(map(len, called))
    for who, outcome in zip(called, outcomes, strict=True):
        print(options.shown(f"{who:<{wide}} {_verdict(past, outcome)}"))
    for note in dict.fromkeys(note for outcome in outcomes for note in outcome.notes):
        print(options.shown(f"note: {note}"))
    for outcome in outcomes:
        if outcome.difference is not None:
            print(_told(past, outcome, outcome.difference))
    print(_summary(outcomes, took))


def _verdict(past: Past, outcome: Outcome) -> str:
    if outcome.refusal:
        return f"not replayed: {outcome.refusal}"
    said = f"{outcome.seconds:8.1f} s  {outcome.inputs:>7} in  {outcome.outputs:>6} out  "
    if outcome.equal:
        said += "equal"
    elif outcome.difference is None:
        said += "nothing to compare"
    else:
        at = _since(past, outcome, outcome.difference)
        said += f"differs from {at:.2f} s on, at {outcome.different} moments"
    return said + (f"; then {outcome.end}" if outcome.end else "")


def _since(past: Past, outcome: Outcome, difference: Difference) -> float:
    """When a difference was, s since the recording's first message."""
    return outcome.began + difference.at - past.began


def _told(past: Past, outcome: Outcome, difference: Difference) -> str:
    at = _since(past, outcome, difference)
    lines = [
        f"{outcome.instance} at {at:.3f} s of the recording, {difference.at:.3f} s of its life,"
        f" after {difference.output} outputs that are equal:"
    ]
    for title, items in (
        ("had entered", difference.inputs),
        ("then", difference.then),
        ("now", difference.now),
    ):
        lines += [f"  {title:<12} {item}" for item in items or ("nothing",)]
    return "\n".join(map(options.shown, lines))


def _summary(outcomes: Sequence[Outcome], took: float) -> str:
    replayed = [outcome for outcome in outcomes if not outcome.refusal]
    outputs = sum(outcome.outputs for outcome in replayed)
    equal = sum(outcome.equal for outcome in replayed)
    longest = max((outcome.seconds for outcome in replayed), default=0.0)
    rest = len(outcomes) - len(replayed)
    said = f"{equal} of {len(replayed)} agents equal, {outputs} outputs"
    said += f", {longest:.1f} s in {took:.1f} s ({longest / max(took, 1e-9):.0f} times as fast)"
    return said + (f"; {rest} not replayed" if rest else "")


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
    "Build the agents of a recording anew, let everything that entered them enter them again,"
    " under the clock of then, and compare what they decide, message by message. For"
    " recordings of `armadico run --record`, or of agents that were started with --journal.",
    EXAMPLES,
)
