"""Ask why: who held what and why, who stopped the robot, what it touched, why it stands.

Of a recording, or of a society that is there.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import FILE, Command, Must, argument, flag, group, option
from armadico.config.discovery import providers
from armadico.mesh.topology import default_namespace
from armadico.runtime.errors import AbsentError

if TYPE_CHECKING:
    from armadico.core.messages import BidRecord
    from armadico.observe.explained import Collision, Exchange, Moment, Press
    from armadico.observe.recordings import Past, Row
    from armadico.observe.standing import Standing
    from armadico.observe.why import Chronicle

Bids = dict[tuple[str, str], list["BidRecord"]]
"""By instance and resource."""

ABOUT_S: Final = 10.0
"""Bids of agents that were not asked in time are computed again so long before and after."""

MOST_TOLD: Final = 30
"""Of the exchanges of a recording, at the most, where all that happened is told."""

EXAMPLES: Final = """\
  armadico why --live                        who drives now, and what the others would do
  armadico why --live --standing             why it stands, down to the agent that is missing
  armadico why run.mcap                      what happened in a recording
  armadico why run.mcap --at 12.5            s from its first message
  armadico why run.mcap --exchange 3
  armadico why run.mcap --collision --json | jq .cause
"""


COUNTED: Final = Must(lambda number: number >= 1, "counted from 1")
NOT_BEFORE: Final = Must(lambda at: at >= 0.0, "that is before its first message")


class Told(NamedTuple):
    """An answer: for people, and for programs."""

    sentences: Sequence[str]
    found: Any


@dataclass(frozen=True, kw_only=True)
class _Robot(options.Mesh):
    """The mesh; of a recording of one robot the namespace need not be given."""

    namespace: str = option(options.NAMESPACE_HELP, default="", metavar="NS")


@dataclass(frozen=True, kw_only=True)
class Options:
    file: Path | None = argument("a recording", nargs="?", metavar="FILE.mcap", must=FILE)
    live: bool = flag("a society that is there, instead")
    collision: int | None = option(
        "what it touched (default: the first)",
        nargs="?",
        const=1,
        metavar="N",
        must=COUNTED,
        either="what",
    )
    stop: int | None = option(
        "who stopped it (default: the first)",
        nargs="?",
        const=1,
        metavar="N",
        must=COUNTED,
        either="what",
    )
    exchange: int | None = option(
        "why another agent drives, the N-th time", metavar="N", must=COUNTED, either="what"
    )
    standing: bool = flag("why the robot stands", either="what")
    at: float | None = option(
        "a moment, s from the recording's first message", metavar="T", must=NOT_BEFORE
    )
    resource: str = option("of --exchange (default: wheels)", default="wheels", metavar="NAME")
    for_s: float = option(
        "with --live: listen for so long (default: 3 s)",
        "--for",
        default=3.0,
        read=options.seconds,
        metavar="S",
    )
    json: bool = flag("one JSON object, for programs")
    mesh: _Robot = group(_Robot, "the mesh")


def run(args: Options) -> int:
    _check(args)
    told = _live(args) if args.file is None else _recorded(args, args.file)
    if args.json:
        import msgspec

        print(json.dumps(msgspec.to_builtins(told.found), indent=2))
    else:
        for sentence in told.sentences:
            print(options.shown(sentence))
    return 0


def _check(args: Options) -> None:
    """Raises UsageError."""
    if args.live == (args.file is not None):
        raise UsageError("name a recording, or --live" if not args.live else "a FILE, or --live")
    past = {"--collision": args.collision, "--exchange": args.exchange, "--at": args.at}
    for name, value in past.items():
        if args.live and value is not None:
            raise UsageError(f"{name} asks for what is over: of a recording (`armadico record`)")
    counted = {"--collision": args.collision, "--stop": args.stop, "--exchange": args.exchange}
    for name, value in counted.items():
        if value is not None and args.at is not None:
            raise UsageError(f"--at says when, and {name} too: one of both")


# Of a society that is there -----------------------------------------------------------------------


def _live(args: Options) -> Told:
    robot = args.mesh.of(args.mesh.namespace or default_namespace())
    hosts = robot.agents_by_host()
    from armadico.observe.standing import standing
    from armadico.observe.watching import Watcher, listen
    from armadico.observe.why import LATER_S, Chronicle

    with robot.joined() as mesh:
        watcher = Watcher([mesh])
        chronicle = Chronicle(installed=providers, hosts=hosts, begun=watcher.clock() / 1e9)
        watcher.watch_alive()
        watcher.watch_router(chronicle.view)
        watcher.subscribe()
        listen(watcher, chronicle, args.for_s)
        now = watcher.clock() / 1e9
        if not chronicle.view.alive:
            raise AbsentError("no agent is alive", robot.namespace)
        if args.standing:
            return _standing(standing(chronicle.view, now, providers, hosts))
        if args.stop is not None:
            return _one("stop", args.stop, chronicle.presses)
        chronicle.mark(now)
        listen(watcher, chronicle, LATER_S)
    chronicle.finish()
    return _moment(chronicle.moments[0])


# Of a recording -----------------------------------------------------------------------------------


def _recorded(args: Options, file: Path) -> Told:
    options.need("mcap", "record")
    from armadico.observe.recordings import Past, RecordingError

    try:
        return _answer(args, Past(file, options.teller("armadico why")))
    except RecordingError as error:
        raise UsageError(str(error)) from None


def _answer(args: Options, past: Past) -> Told:
    """By what was recorded; of who was not asked in time, by what its journal comes to again."""
    from armadico.observe.explained import (
        Collision,
        Exchange,
        Moment,
        unasked,
    )

    past.check()
    told = _read(args, past, {})
    if isinstance(told.found, Collision | Exchange | Moment) and (silent := unasked(told.found)):
        again = _gone_through(past, silent, told.found.t)
        return _read(args, past, again) if again else told
    return told


def _gone_through(past: Past, instances: set[str], at: float) -> Bids:
    """The bids of some about a time (s), by their journals, if these come to the same again."""
    from armadico.observe.replay import Replay

    found: Bids = {}
    for journal in past.journals(instances):
        replay = Replay(journal)
        to = at + past.began - replay.began
        bids = [b for one in replay.moments() if abs(one.at - to) <= ABOUT_S for b in one.bids]
        if replay.outcome().equal:
            for bid in bids:
                found.setdefault((journal.instance, bid.resource), []).append(bid)
    return found


def _read(args: Options, past: Past, again: Bids) -> Told:
    from armadico.observe.standing import standing
    from armadico.observe.why import LATER_S, Chronicle

    chronicle, at = Chronicle(again, installed=providers), args.at
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
            found = standing(chronicle.view, at, providers)
            chronicle.mark(at)
        if at is not None and t > at + LATER_S:
            break
        _take(chronicle, row, t)
    if not args.mesh.namespace and others:
        names = ", ".join(sorted({namespace, *others}))
        raise UsageError(f"{args.file} holds {names}; name one robot: --namespace NS")
    if chronicle.view.state is None and not chronicle.view.cards:
        of = f" of {args.mesh.namespace!r}" if args.mesh.namespace else ""
        raise FailedError(f"{args.file} holds no messages{of}")
    if at is not None and found is None:
        raise UsageError(f"--at {at:g}: {args.file} is from 0 to {t:.1f} s")
    chronicle.finish()
    if args.standing:
        return _standing(found or standing(chronicle.view, t, providers))
    if at is not None:
        return _moment(chronicle.moments[0])
    return _event(args, chronicle, t)


def _event(args: Options, chronicle: Chronicle, ends: float) -> Told:
    if args.collision is not None:
        return _one("collision", args.collision, chronicle.collisions)
    if args.stop is not None:
        return _one("stop", args.stop, chronicle.presses)
    if args.exchange is not None:
        exchanges = [e for e in chronicle.exchanges if e.resource == args.resource]
        return _one(f"exchange of {args.resource}", args.exchange, exchanges)
    return _all(chronicle, ends)


def _take(chronicle: Chronicle, row: Row, t: float) -> None:
    """Show it one row of a recording."""
    from armadico.core.messages import (
        BidHistory,
        BidRecord,
        Card,
        MessageError,
    )
    from armadico.observe.recorder import REFUSED
    from armadico.observe.recordings import HERE

    if row.schema == HERE:
        here = row.fields
        chronicle.token(here["instance"], there=here["there"], t=t)
        return
    try:
        message = row.message
    except MessageError:
        message = None
    if isinstance(message, BidRecord):
        chronicle.learn(BidHistory(row.key.split("/")[2], (message,)), t)
    elif isinstance(message, Card):
        chronicle.learn(message, t)
    else:
        chronicle.update(row.key.removesuffix(REFUSED), message, t)


# Answers ------------------------------------------------------------------------------------------


def _standing(found: Standing) -> Told:
    said = list(found.sentences)
    if found.cause is not None and found.cause.todo:
        said.append(f"-> {found.cause.todo}")
    return Told(said, found)


def _moment(found: Moment) -> Told:
    return Told(found.sentences, found)


def _one(what: str, number: int, found: Sequence[Exchange | Press | Collision]) -> Told:
    """The N-th of some. Raises FailedError if there are not so many."""
    one = next((each for each in found if each.number == number), None)
    if one is None:
        there = f"{len(found)} there are" if found else "there is none"
        raise FailedError(f"no {what} {number}: {there}")
    return Told(one.sentences, one)


def _all(chronicle: Chronicle, ends: float) -> Told:
    """What happened, in a line each."""
    from armadico.observe.standing import standing
    from armadico.observe.view import agent_of

    last = standing(chronicle.view, ends, providers)
    exchanges, presses, collisions = chronicle.exchanges, chronicle.presses, chronicle.collisions
    counted: dict[str, Sequence[object]] = {
        "exchange": exchanges,
        "stop": presses,
        "collision": collisions,
    }
    told = [f"{len(each)} {what}{'s' * (len(each) != 1)}" for what, each in counted.items()]
    said = [f"{ends:.1f} s, {', '.join(told)}."]
    counts: dict[str, int] = {}
    for each in exchanges[:MOST_TOLD]:
        number = counts[each.resource] = counts.get(each.resource, 0) + 1
        of = "" if each.resource == "wheels" else f" of {each.resource}"
        who = f"{agent_of(each.loser)} -> {agent_of(each.winner)}"
        said.append(f"{each.t:8.2f} s  exchange {number}{of}: {who}: {each.cause.what}")
    if len(exchanges) > MOST_TOLD:
        said.append(f"            and {len(exchanges) - MOST_TOLD} exchanges more")
    said += [f"{each.t:8.2f} s  stop {each.number}: by {each.by}" for each in presses]
    said += [f"{each.t:8.2f} s  collision {each.number}: {each.cause.what}" for each in collisions]
    said += ["At its end:", *last.sentences]
    found = {
        "seconds": round(ends, 3),
        "exchanges": exchanges,
        "stops": presses,
        "collisions": collisions,
        "standing": last,
    }
    return Told(said, found)


main: Final = Command(
    "armadico why",
    Options,
    run,
    "Why a society did what it did: each contender's bid and what it was made of, who held the"
    " resource, what the exchange blended, what the robot obeyed or refused. Without a"
    " question: what happened in a recording, or this moment live. Losers publish nothing, so"
    " they are asked, or a recording has what they answered.",
    EXAMPLES,
)
