"""Explain a run or a live robot: which agent drove and why, stops, collisions, why it stands."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UnknownError, UsageError
from armadico.cli.parsing import FILE, Command, Must, argument, flag, group, option
from armadico.core.discovery import REHEARSALS, installed, providers
from armadico.mesh.topology import default_namespace
from armadico.observe.findings import Demand, Finding, Sort, short, sight
from armadico.runtime.errors import AbsentError

if TYPE_CHECKING:
    from armadico.core.messages import BidRecord
    from armadico.observe.contention import Contention
    from armadico.observe.journeys import Journey
    from armadico.observe.standing import Standing
    from armadico.observe.view import View
    from armadico.watch.explained import Answer, Event, Moment, Summary
    from armadico.watch.recordings import Past, Row
    from armadico.watch.why import Chronicle

Bids = dict[tuple[str, str], list["BidRecord"]]
"""By instance and resource."""

WHEELS: Final = "wheels"
"""The default resource; its module would make `--help` slow."""

ABOUT_S: Final = 10.0
"""Missing bids are recomputed for so long before and after an event."""

MOST_S: Final = 4.5
"""Longest observation while an agent has not answered."""

MOST_LISTED: Final = 30
"""Most exchanges, and most drives, that the summary of a recording lists."""

EXAMPLES: Final = """\
  armadico why --live                        which agent drives now, and the others' bids
  armadico why --live --for 60               also how a drive meanwhile differed from its rehearsal
  armadico why --live --standing             why the robot stands, down to the missing agent
  armadico why run.mcap                      summary of a recording
  armadico why run.mcap --at 12.5            12.5 s after its first message
  armadico why run.mcap --exchange 3
  armadico why run.mcap --collision --json | jq .cause
"""


COUNTED: Final = Must(lambda number: number >= 1, "expected a number from 1")
NOT_BEFORE: Final = Must(lambda at: at >= 0.0, "expected at least 0, the first message")


@dataclass(frozen=True, kw_only=True)
class Options:
    file: Path | None = argument("the recording", nargs="?", metavar="FILE.mcap", must=FILE)
    live: bool = flag("explain a running society instead")
    collision: int | None = option(
        "explain a collision (default: the first)",
        nargs="?",
        const=1,
        metavar="N",
        must=COUNTED,
        either="what",
    )
    stop: int | None = option(
        "explain a stop (default: the first)",
        nargs="?",
        const=1,
        metavar="N",
        must=COUNTED,
        either="what",
    )
    exchange: int | None = option(
        "explain the N-th exchange of the resource", metavar="N", must=COUNTED, either="what"
    )
    standing: bool = flag("explain why the robot stands", either="what")
    at: float | None = option(
        "explain this moment, s from the recording's first message", metavar="T", must=NOT_BEFORE
    )
    resource: str | None = option("the resource of --exchange (default: wheels)", metavar="NAME")
    for_s: float = option(
        "with --live: listen for S seconds (default: 3)",
        "--for",
        default=3.0,
        read=options.seconds,
        metavar="S",
    )
    json: bool = flag("print one JSON object")
    mesh: options.Recorded = group(options.Recorded, "the mesh")


def run(args: Options) -> int:
    import msgspec

    _check(args)
    found, beside, code = _live(args) if args.file is None else _recorded(args, args.file)
    if args.json:
        print(json.dumps(msgspec.to_builtins(found), indent=2))
    else:
        for line in (*getattr(found, "lines", found.sentences), *beside):
            print(options.shown(line))
    return code


def _check(args: Options) -> None:
    """Raises UsageError."""
    if args.live == (args.file is not None):
        raise UsageError("give either a recording or --live")
    if args.resource is not None and args.exchange is None:
        raise UsageError(f"--resource {args.resource}: it is for --exchange N")
    past = {"--collision": args.collision, "--exchange": args.exchange, "--at": args.at}
    for name, value in past.items():
        if args.live and value is not None:
            raise UsageError(f"{name} needs a recording (`armadico record`), not --live")
    counted = {"--collision": args.collision, "--stop": args.stop, "--exchange": args.exchange}
    for name, value in counted.items():
        if value is not None and args.at is not None:
            raise UsageError(f"--at and {name}: use one of them")


# A running society --------------------------------------------------------------------------------


def _live(args: Options) -> tuple[Answer, list[str], int]:
    """The answer, lines about what else is wrong, and the exit code."""
    robot = args.mesh.of(args.mesh.namespace or default_namespace())
    demand = robot.demand()
    from armadico.observe.standing import standing
    from armadico.observe.watching import Observer
    from armadico.watch.why import LATER_S, Chronicle

    with robot.joined() as mesh:
        chronicle = Chronicle(demand=demand)
        observer = Observer(mesh, demand, chronicle)
        chronicle.begin(began := observer.now)
        findings = observer.settle(args.for_s, max(args.for_s, MOST_S))
        if not chronicle.view.alive:
            raise AbsentError("no agent is alive", robot.namespace)
        now = observer.now
        if args.standing:
            found = standing(chronicle.view, now, demand)
            return found, _beside(found.cause, findings), sight(findings)
        if (event := _event(args, chronicle)) is not None:
            return event, [], 0
        chronicle.mark(now)
        observer.take(LATER_S)
    chronicle.finish()
    moment = with_drives(chronicle, robot.namespace, began)
    return moment, _beside(moment.cause, findings), sight(findings)


def with_drives(chronicle: Chronicle, namespace: str, began: float) -> Moment:
    """The marked moment, and how the drives that have ended differed from their rehearsals."""
    from msgspec.structs import replace

    (moment,) = chronicle.moments
    drives = rehearsed(chronicle.journeys.done, namespace, began)
    return replace(moment, sentences=(*moment.sentences, *drives))


# A recording --------------------------------------------------------------------------------------


def _recorded(args: Options, file: Path) -> tuple[Answer, list[str], int]:
    """As `_live`. How a damaged recording ended is unknown; one event in it is not."""
    options.need("mcap", "record")
    from armadico.watch.explained import Event
    from armadico.watch.recordings import Past, RecordingError

    try:
        past = Past(file, options.reporter("armadico why"))
        found = _answer(args, past)
    except RecordingError as error:
        raise UsageError(str(error)) from None
    whole = args.at is not None or isinstance(found, Event)
    return found, [], options.UNKNOWN if past.damage and not whole else 0


def _answer(args: Options, past: Past) -> Answer:
    """The answer from the recorded bids; missing ones are recomputed from the agents' journals."""
    from armadico.watch.explained import Collision, Exchange, Moment, missing_bids

    past.check()
    answer = _read(args, past, {})
    if isinstance(answer, Moment | Exchange | Collision) and (silent := missing_bids(answer)):
        again = _replayed(past, silent, answer.t)
        return _read(args, past, again) if again else answer
    return answer


def _replayed(past: Past, instances: set[str], at: float) -> Bids:
    """The bids of agents around a time, s, from their journals, if these replay equally."""
    from armadico.watch.replay import Replay

    found: Bids = {}
    for journal in past.journals(instances):
        replay = Replay(journal)
        to = at + past.began - replay.began
        bids = [b for one in replay.moments() if abs(one.at - to) <= ABOUT_S for b in one.bids]
        if replay.outcome().equal:
            for bid in bids:
                found.setdefault((journal.instance, bid.resource), []).append(bid)
    return found


def _read(args: Options, past: Past, again: Bids) -> Answer:
    from armadico.observe.contention import Contention
    from armadico.observe.standing import standing
    from armadico.watch.why import LATER_S, Chronicle

    demand = Demand(installed=providers)
    chronicle, at = Chronicle(again, demand=demand), args.at
    contention = Contention()
    namespace, t = args.mesh.namespace, 0.0
    first: int | None = None
    found: Standing | None = None
    others: set[str] = set()
    for row in past.rows():
        first = row.t if first is None else first
        namespace = namespace or row.namespace
        if row.namespace != namespace:
            others.add(row.namespace)
            continue
        t = (row.t - first) / 1e9
        if at is not None and found is None and t > at:
            found = standing(chronicle.view, at, demand)
            chronicle.mark(at)
        if at is not None and t > at + LATER_S:
            break
        _add(chronicle, contention, row, t)
    if past.damage:
        chronicle.lost = f"{args.file} was cut or damaged, and could be read up to {t:.1f} s"
    if not args.mesh.namespace and others:
        names = ", ".join(sorted({namespace, *others}))
        raise UsageError(f"{args.file} holds {names}; name one robot: --namespace NS")
    if chronicle.view.state is None and not chronicle.view.cards:
        of = f" of {args.mesh.namespace!r}" if args.mesh.namespace else ""
        raise (UnknownError if past.damage else FailedError)(f"{args.file} holds no messages{of}")
    if at is not None and found is None:
        raise UsageError(f"--at {at:g}: expected 0 to {t:.1f} s, the length of {args.file}")
    chronicle.finish()
    if args.standing:
        return found or standing(chronicle.view, t, demand)
    if at is not None:
        return chronicle.moments[0]
    began = 0.0 if first is None else first / 1e9
    return _event(args, chronicle) or _summary(chronicle, contention, t, namespace or "", began)


def _event(args: Options, chronicle: Chronicle) -> Event | None:
    """The event that was asked for; None: none was. Raises FailedError if there is no such one."""
    resource = args.resource or WHEELS
    exchanges = [each for each in chronicle.exchanges if each.resource == resource]
    asked: tuple[tuple[str, str, int | None, Sequence[Event]], ...] = (
        ("collision", "", args.collision, chronicle.collisions),
        ("stop", "", args.stop, chronicle.presses),
        ("exchange", f" of {resource}", args.exchange, exchanges),
    )
    for what, of, number, found in asked:
        if number is not None:
            one = next((each for each in found if each.number == number), None)
            if one is not None:
                return one
            if why := chronicle.uncounted(what, resource):
                known = f"{len(found) or 'none'} known, and {why}"
                raise UnknownError(f"{what}{of} {number}: unknown whether there was one: {known}")
            raise FailedError(f"no {what}{of} {number}: the recording has {len(found) or 'none'}")
    return None


def _add(chronicle: Chronicle, contention: Contention, row: Row, t: float) -> None:
    """Add one row of a recording."""
    from armadico.core.messages import (
        BidHistory,
        BidRecord,
        Card,
        MessageError,
    )
    from armadico.watch.recorder import REFUSED
    from armadico.watch.recordings import HERE

    if row.schema == HERE:
        here = row.fields
        chronicle.token(str(here["instance"]), there=bool(here["there"]), t=t)
        return
    try:
        message = row.message
    except MessageError:
        message = None
    if isinstance(message, BidRecord):
        instance = row.key.split("/")[2]
        chronicle.learn(BidHistory(instance, (message,)), t)
        contention.learn(instance, (message,))
    elif isinstance(message, Card):
        chronicle.learn(message, t)
    else:
        chronicle.update(row.key.removesuffix(REFUSED), message, t)
        if message is not None:
            contention.update(message)


# Answers ------------------------------------------------------------------------------------------


def explained(view: View, now: float, demand: Demand, findings: Sequence[Finding]) -> list[str]:
    """Why the robot of a live society stands, and what else is wrong."""
    from armadico.observe.standing import standing

    found = standing(view, now, demand)
    return [*found.lines, *_beside(found.cause, findings)]


def _beside(cause: Finding | None, findings: Sequence[Finding]) -> list[str]:
    """What was restarted or stopped and on which evidence, and what else is wrong."""
    actions = [each.what for each in findings if each.sort is Sort.ACTION]
    return [*actions, *short(findings, () if cause is None else ((cause.sort, cause.who),))]


def rehearsed(journeys: Sequence[Journey], namespace: str, began: float) -> list[str]:
    """How drives differed from their rehearsals, if these are known here.

    `began` is when the drives' times begin, s since 1970.
    """
    from armadico.observe.journeys import compared

    offered = installed(REHEARSALS).get("told")
    if offered is None:
        return []
    told = offered.load()
    found = []
    for one in journeys:
        what = told(namespace, one.start, one.goal[:2], one.world, began + one.began)
        found += [] if what is None else [compared(one, what)]
    return found


def _summary(
    chronicle: Chronicle, contention: Contention, ends: float, namespace: str, began: float
) -> Summary:
    """A recording with a line for each event; it began at `began`, s since 1970."""
    from armadico.core.mechanisms import deciding
    from armadico.core.membership import agent_of
    from armadico.core.messages import BALLOTS
    from armadico.observe.standing import standing
    from armadico.watch.explained import Summary

    last = standing(chronicle.view, ends, chronicle.demand)
    exchanges, presses, collisions = chronicle.exchanges, chronicle.presses, chronicle.collisions
    counted = {"exchange": len(exchanges), "stop": len(presses), "collision": len(collisions)}
    unknown = chronicle.unknown
    totals = [_total(what, number, exact=what not in unknown) for what, number in counted.items()]
    cards = chronicle.view.cards.values()
    mechanisms = deciding(cards)
    lines = [f"{ends:.1f} s, {', '.join(totals)}."]
    lines += [f"Not all {what}s are known: {why}." for what, why in unknown.items()]
    if {*mechanisms} - {BALLOTS}:
        lines.append(f"What decided who drives: {', '.join(mechanisms)}.")
    if contention.arbitrated:
        changes = max(len(chronicle.drives.drives) - 1, 0)
        times = f"{changes} time{'s' * (changes != 1)}"
        lines.append(f"An exchange is one of arbiters; by award the driving agent changed {times}.")
    lines += [f"{text[0].upper()}{text[1:]}." for text in contention.among(cards)]
    for each in exchanges[:MOST_LISTED]:
        of = "" if each.resource == WHEELS else f" of {each.resource}"
        agents = f"{agent_of(each.loser)} -> {agent_of(each.winner)}"
        lines.append(f"{each.t:8.2f} s  exchange {each.number}{of}: {agents}: {each.cause.what}")
    if len(exchanges) > MOST_LISTED:
        lines.append(f"            and {len(exchanges) - MOST_LISTED} more exchanges")
    lines += [f"{each.t:8.2f} s  stop {each.number}: by {each.by}" for each in presses]
    lines += [f"{each.t:8.2f} s  collision {each.number}: {each.cause.what}" for each in collisions]
    lines += chronicle.drives.sentences(MOST_LISTED)
    lines += rehearsed(chronicle.journeys.done, namespace, began)
    lines += ["At its end:", *last.sentences]
    return Summary(
        round(ends, 3),
        exchanges if exchanges or "exchange" not in unknown else None,
        presses if presses or "stop" not in unknown else None,
        collisions if collisions or "collision" not in unknown else None,
        chronicle.drives.drives,
        chronicle.drives.unobeyed,
        last,
        tuple(lines),
        chronicle.journeys.done,
        mechanisms,
        unknown,
    )


def _total(what: str, number: int, *, exact: bool) -> str:
    if exact or number:
        return f"{'' if exact else 'at least '}{number} {what}{'s' * (number != 1)}"
    return f"{what}s unknown"


main: Final = Command(
    "armadico why",
    Options,
    run,
    "Explain a run or a live robot: each contender's bid and its reasons, the holder, the blending"
    " of an exchange, and what the robot obeyed or rejected. Without an option, print a summary of"
    " the recording, or the present moment. Agents that do not hold publish no bids; their answers"
    " to queries are used, or those in the recording. With --live the exit code is 1 if something"
    " that should be there is absent or does not answer, and 3 if that is not known.",
    EXAMPLES,
)
