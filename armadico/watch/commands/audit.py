"""Judge a recording or a live robot: which promises were broken, kept, or could not be checked."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import FILE, Command, argument, flag, group, option, several
from armadico.core.judgement import Answer, Judgement, all_of
from armadico.mesh.topology import default_namespace
from armadico.observe.audit.promises import Finding, Promise
from armadico.observe.pauses import PAUSE_S
from armadico.runtime.errors import AbsentError

if TYPE_CHECKING:
    from armadico.config.worlds import World
    from armadico.core.messages import Card
    from armadico.observe.audit.auditor import Auditor
    from armadico.watch.recordings import Past

TICK_S: Final = 0.1
"""Time without a message is judged so often, s."""

MEGABYTE: Final = 1_000_000

EXAMPLES: Final = """\
  armadico audit run.mcap
  armadico audit run.mcap --only collision --only reached   the exit code is that of these
  armadico audit run.mcap --json | jq '.promises[] | select(.answer != "yes")'
  armadico audit run.mcap --world lab.yaml                  by the robot's own map
  armadico audit --live                                     until Ctrl-C
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    file: Path | None = argument("the recording", nargs="?", metavar="FILE.mcap", must=FILE)
    live: bool = flag("judge a running society instead, until Ctrl-C")
    for_s: float | None = option(
        "with --live: judge for S seconds (default: until Ctrl-C)",
        "--for",
        default=None,
        read=options.seconds,
        metavar="S",
    )
    only: tuple[str, ...] = several(
        "judge only this promise; may be repeated (default: all)", metavar="PROMISE"
    )
    world: str | None = option(
        "the robot's map: a shipped world, or a file (default: the one that its agents name, if it"
        " is shipped)",
        default=None,
        metavar="MAP",
    )
    json: bool = flag("print one JSON object")
    accept_unknown: bool = options.accept_option(
        "promises that were not checked, as of a real robot, whose true pose is not known; not if"
        " nothing was kept, or something was not read"
    )
    mesh: options.Recorded = group(options.Recorded, "the mesh")


def run(args: Options) -> int:
    """Print what was found; the exit code is that of its judgement."""
    if args.live == (args.file is not None):
        raise UsageError("give either a recording or --live")
    if args.for_s is not None and not args.live:
        raise UsageError("--for S is for --live; a recording is judged to its end")
    from armadico.observe.audit.auditor import RULES, Auditor

    only = {_name(promise): promise for promise in dict.fromkeys(rule.promise for rule in RULES)}
    if unknown := sorted(set(args.only) - set(only)):
        raise UsageError(f"--only {unknown[0]}: expected one of {', '.join(only)}")
    chosen = {only[name] for name in args.only or only}
    auditor = Auditor(rule for rule in RULES if rule.promise in chosen)
    if (world := options.world_of(args.world)) is not None:
        auditor.chart(world.outlines, world)
    audit = _Audit(auditor, world, whole=not args.only, loud=not args.json)
    try:
        if args.file is None:
            _live(args, audit)
        else:
            _recorded(args, args.file, audit)
    except options.BROKEN as error:  # its exit code would be that of a broken promise
        audit.unread.append(str(error))
    return audit.conclude(accept_unknown=args.accept_unknown)


def _name(promise: Promise) -> str:
    return promise.name.lower().replace("_", "-")


class _Audit:
    """Judges messages, prints findings as they come, and then the verdict on each promise."""

    def __init__(self, auditor: Auditor, world: World | None, *, whole: bool, loud: bool) -> None:
        """`world` is that of --world; `whole`: all promises are judged, not a selection."""
        self.auditor = auditor
        self._world, self._whole = world, whole
        self.unread: list[str] = []  # why something was not judged at all
        self.notes: list[str] = []  # what else its reader must know
        self._cards: dict[str, Card] = {}
        self._loud = loud
        self._began: float | None = None
        self._at = self._heard = 0.0
        self._printed = 0

    def update(self, at: float, key: str, message: object) -> None:
        """Judge a message, and the time before it; `at` is in s of any clock."""
        from armadico.core.messages import Message
        from armadico.observe.audit.auditor import watched

        self.tick(at)
        self.learn(message)
        self._heard = at - (self._began or 0.0)
        if isinstance(message, Message) and isinstance(message, watched()):
            self.auditor.update(at - (self._began or 0.0), key, message)
            self._print()

    def learn(self, message: object) -> None:
        """Take the map that an agent's card names, and what decides who drives."""
        from armadico.core.messages import Card
        from armadico.observe.audit.live import learn

        if isinstance(message, Card):
            learn(self.auditor, message)
            self._cards[message.instance] = message
            self._check_world(message)

    def _check_world(self, card: Card) -> None:
        """Compare the map of --world with that which an agent was launched with."""
        from armadico.config.worlds import EMPTY, digest, is_map, load_world
        from armadico.core.config_errors import ConfigError

        if self._world is None or card.world in ("", EMPTY):
            return
        mine, named = self._world.name, card.world
        why = f"the agents name the map {named!r}, and --world is {mine!r}"
        if named == mine:
            why = f"--world is another map {mine!r} than the agents have"
        if why in (*self.unread, *self.notes):
            return
        try:
            same = is_map(self._world, card.map or digest(load_world(named)))
        except ConfigError:  # it is not shipped: --world may be it, under another name
            self.notes += [why] * (named != mine)
            return
        if not same:
            self.unread.append(why)

    def tick(self, at: float) -> None:
        """Judge that time has passed."""
        self._began = at if self._began is None else self._began
        at -= self._began
        if at - self._heard > PAUSE_S:  # in it nothing is judged
            self.unread.append(f"nothing was received from {self._heard:.1f} to {at:.1f} s")
            self._at = self._heard = at
        while self._at + TICK_S <= at:
            self._at += TICK_S
            self.auditor.tick(self._at)
            self._print()

    @property
    def lasts(self) -> float:
        """The time that was judged, s."""
        return self._at

    def _print(self) -> None:
        found = self.auditor.findings
        if self._loud:
            for finding in found[self._printed :]:
                print(options.shown(f"{finding.at:8.2f} s  {_words(finding)}"), flush=True)
        self._printed = len(found)

    def conclude(self, *, accept_unknown: bool) -> int:
        """Print the verdict on each promise; return the exit code."""
        from armadico.core.mechanisms import deciding
        from armadico.core.messages import BALLOTS

        mechanisms = deciding(self._cards.values())
        if {*mechanisms} - {BALLOTS}:
            self.notes.append(
                f"{', '.join(mechanisms)} decided who drives; the promises on ballots are about its"
                " arbiter, if it has one"
            )
        self.unread += self.auditor.doubts
        report = self.auditor.report(next(iter(self.unread), ""))
        verdicts = _by_promise(report)
        tested = [each for each in verdicts if each.occasion]
        judged = [Judgement(each.answer, each.text) for each in tested]
        if not tested:
            self.unread.append("there was no occasion to break any of these promises")
        elif self._whole and not self.auditor.driven:
            # What a robot at rest keeps is no evidence of what it does when it is driven.
            self.unread.append("no agent drove the robot")
        judged += [Judgement(Answer.UNKNOWN, why) for why in self.unread]
        verdict = all_of(judged)
        kept = any(each.answer is Answer.YES for each in report) and not self.unread
        accepted = accept_unknown and kept and verdict.answer is Answer.UNKNOWN
        code = 0 if accepted else verdict.exit_code
        if not self._loud:
            import msgspec

            found = {
                "answer": verdict.answer,
                "findings": [_plain(each) for each in self.auditor.findings],
                "promises": [_plain(each) for each in verdicts],
                "unread": self.unread,
                "notes": self.notes,
            }
            print(json.dumps(msgspec.to_builtins(found), indent=2))
            return code
        for each in verdicts:
            counted = sum(
                one.answer is each.answer and one.promise is each.promise
                for one in self.auditor.findings
            )
            times = f", {counted} times" if counted > 1 else ""
            what = (
                f": {each.text}{times}" if each.occasion and each.answer is not Answer.YES else ""
            )
            word = _WORDS[each.answer] if each.occasion else NO_OCCASION
            print(options.shown(f"{word:<12} {_name(each.promise)} ({each.promise}){what}"))
        for why in self.unread:
            print(options.shown(f"{_WORDS[Answer.UNKNOWN]:<12} {why}"))
        for note in self.notes:
            print(options.shown(f"{'note':<12} {note}"))
        counts = (sum(each.answer is answer for each in judged) for answer in _WORDS)
        words = zip(_WORDS.values(), counts, strict=True)
        without = len(verdicts) - len(tested)
        sums = [*words, (NO_OCCASION, without)]
        print(f"\n{', '.join(f'{word} {count}' for word, count in sums)}")
        return code


_WORDS: Final = {Answer.NO: "broken", Answer.YES: "kept", Answer.UNKNOWN: "not checked"}

NOT_CHECKED, AS_FAR = "not checked: ", "kept as far as was judged: "

NO_OCCASION: Final = "no occasion"
"""Nothing happened that could break it: no mission failed, nothing was near."""


def _words(finding: Finding) -> str:
    return f"{_WORDS[finding.answer]} {_name(finding.promise)}: {finding.text}"


def _plain(finding: Finding) -> dict[str, object]:
    return {
        "promise": _name(finding.promise),
        "means": finding.promise,
        "answer": finding.answer,
        "occasion": finding.occasion,
        "at": round(finding.at, 3),
        "who": finding.who,
        "what": finding.what,
        "evidence": finding.evidence,
    }


def _by_promise(verdicts: list[Finding]) -> list[Finding]:
    """One verdict for each promise: of several rules, the worst; those without an occasion last.

    What was not checked by one rule, and kept by another, is kept as far as was judged.
    """
    found: dict[Promise, Finding] = {}
    kept = {each.promise for each in verdicts if each.answer is Answer.YES}
    for each in sorted(verdicts, key=_rank):
        partly = each.promise in kept and each.what.startswith(NOT_CHECKED)
        what = AS_FAR + each.what.removeprefix(NOT_CHECKED) if partly else each.what
        found.setdefault(each.promise, replace(each, what=what))
    order = list(_WORDS)
    return sorted(found.values(), key=lambda each: (not each.occasion, order.index(each.answer)))


def _rank(verdict: Finding) -> tuple[bool, int]:
    """What was broken comes first, then what was not checked."""
    return not verdict.occasion, (Answer.NO, Answer.UNKNOWN, Answer.YES).index(verdict.answer)


# A recording --------------------------------------------------------------------------------------


def _recorded(args: Options, file: Path, audit: _Audit) -> None:
    options.need("mcap", "record")
    from armadico.watch.recordings import Past, RecordingError, UnreadError

    try:
        past = Past(file, options.reporter("armadico audit"))
        past.check()
        _read(args, past, audit)
    except UnreadError as error:
        audit.unread.append(str(error))
    except RecordingError as error:
        raise UsageError(str(error)) from None


def _read(args: Options, past: Past, audit: _Audit) -> None:
    """Judge a recording. Raises UsageError if it holds several robots, or not the one named."""
    from armadico.core.messages import PROTOCOL
    from armadico.watch.recorder import REFUSED

    namespace, others = args.mesh.namespace, set[str]()
    lost = rows = 0
    size = sum(path.stat().st_size for path in past.paths)
    with _progress(size) as progress:
        for row in past.rows():
            progress(row.place.at, str(row.place.path))
            namespace = namespace or row.namespace
            if row.namespace != namespace:
                others.add(row.namespace)
                continue
            rows += 1
            message = row.received
            lost += message is None and row.key.endswith(REFUSED)
            audit.update(row.t / 1e9, row.key, message)
    if not args.mesh.namespace and others:
        names = ", ".join(sorted({namespace, *others}))
        raise UsageError(f"{past.path} holds {names}; name one robot: --namespace NS")
    if not rows and others:
        names = ", ".join(sorted(others))
        raise UsageError(f"{past.path} holds no messages of {namespace!r}; --namespace: {names}")
    audit.unread += past.damage
    if not rows:
        audit.unread.append(f"{past.path} holds no messages")
    if (protocol := past.about["protocol"]) != str(PROTOCOL):
        audit.unread.append(
            f"recorded with protocol {protocol}, whose keys do not name who published a claim, a"
            " stop or a path: that they are of whom they say was not checked"
        )
    if lost:
        audit.unread.append(f"{lost} messages that could not be decoded")


@contextmanager
def _progress(size: int) -> Iterator[Callable[[int, str], None]]:
    """A function to call with the place of each record: a bar on a terminal."""
    if not sys.stderr.isatty():
        yield lambda *_: None
        return
    from armadico.cli.pool import progress

    done: dict[str, int] = {}
    total = size // MEGABYTE + 1
    with progress("megabytes", total) as step:
        stepped = 0

        def show(at: int, path: str) -> None:
            nonlocal stepped
            done[path] = at
            while stepped < min(sum(done.values()) // MEGABYTE, total):
                stepped += 1
                step()

        yield show
        for _ in range(total - stepped):
            step()


# A running society --------------------------------------------------------------------------------


def _live(args: Options, audit: _Audit) -> None:
    """Judge what a society publishes, until Ctrl-C or for a time."""
    robot = args.mesh.of(args.mesh.namespace or default_namespace())
    demand = robot.demand()
    import signal
    import time

    from armadico.core.messages import Message
    from armadico.observe.view import View
    from armadico.observe.watching import Observer

    class Account:
        """A view, and the auditor beside it."""

        def __init__(self) -> None:
            self.view = View()

        def token(self, instance: str, *, there: bool, t: float) -> None:
            self.view.token(instance, there=there, t=t)

        def update(self, key: str, message: Message | None, t: float) -> None:
            self.view.update(key, message, t)
            audit.update(t, key, message)

        def learn(self, message: Message, t: float) -> None:
            self.view.learn(message, t)
            audit.learn(message)

    signals: list[int] = []
    with robot.joined() as mesh:
        # A KeyboardInterrupt raised within `cbor2.dumps` is ignored (cbor2 6.2).
        before = signal.signal(signal.SIGINT, lambda number, _: signals.append(number))
        try:
            observer = Observer(mesh, demand, Account())
            end = time.monotonic() + (float("inf") if args.for_s is None else args.for_s)
            while not signals and time.monotonic() < end:
                observer.take(min(TICK_S, max(end - time.monotonic(), 0.0)))
                audit.tick(observer.now)
                if not mesh.reachable:
                    audit.unread.append(
                        f"the robot's router is not reachable after {audit.lasts:.1f} s"
                    )
                    break
        finally:
            signal.signal(signal.SIGINT, before)
        if observer.watcher.dropped:
            audit.unread.append(f"{observer.watcher.dropped} messages that were not read in time")
        if not observer.view.alive:
            raise AbsentError("no agent is alive", robot.namespace)


main: Final = Command(
    "armadico audit",
    Options,
    run,
    "Judge by its messages whether a robot's society keeps its promises, such as: a goal that is"
    " reported as reached is reached. Each promise is broken, kept, or was not checked, with the"
    " reason, or it had no occasion: if no mission failed, none failed without a cause. The exit"
    " code is 1 if one was broken, else 3 if one was not checked, since messages are missing or"
    " there is no society, else 0.",
    EXAMPLES,
)
