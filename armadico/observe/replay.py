"""An agent's life gone through again, from its journal, sans-IO, under the journal's own clock.

The same agent is built anew, with the parameters, the random numbers and the identity that it had,
and what entered it enters it again, at the same times. What it gives is compared with what it gave
then, byte for byte: equal, or the first difference, with both sides and what had just entered.

With other parameters, or other code, the inputs stay as they were: the loop is open. What comes out
is what would have been decided at each moment, had the world gone on as it did; not what would have
come of that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec
from msgspec import Struct, msgpack

from armadico.config.discovery import agent_class
from armadico.config.errors import ConfigError
from armadico.config.loading import convert, set_values
from armadico.core import journal as j
from armadico.core.agent import Agent, AskFor, DeviceAgent, Identity, Subscription
from armadico.core.driver import Driver
from armadico.core.errors import UnknownNameError
from armadico.core.messages import BidRecord, Message, MessageError, decode, line, plain
from armadico.observe.conditions import software
from armadico.observe.journals import Entry, Head, Journal, files, stream
from armadico.observe.watching import kind_at

Listens = Mapping[str, Subscription]
"""What an agent listens to, by patterns."""

INPUTS: Final = 5
"""What had entered last is told with a difference: so many."""

LONGEST: Final = 300
"""Characters of one input or output that are told."""


class ReplayError(ValueError):
    """This life cannot be gone through again; the message says why."""


class Difference(Struct, frozen=True, kw_only=True):
    """The first moment at which an agent gives something else than it gave then."""

    at: float  # s since the agent's journal began
    output: int  # how many outputs were equal before it
    then: tuple[str, ...]  # what it gave at that moment, and when it wanted to be woken,
    now: tuple[str, ...]  # and what it gives
    inputs: tuple[str, ...]  # what had entered it just before, the newest last


class Outcome(Struct, frozen=True, kw_only=True):
    """What came of one agent's replay."""

    namespace: str
    name: str
    instance: str
    began: float = 0.0  # s since 1970, by the recorder's clock
    seconds: float = 0.0  # of its life that were gone through
    inputs: int = 0
    outputs: int = 0  # what it gave then; compared one by one up to the first difference
    different: int = 0  # moments at which it gives something else
    difference: Difference | None = None  # the first of them
    refusal: str = ""  # why it was not gone through at all
    end: str = ""  # why its journal ends before it did
    notes: tuple[str, ...] = ()  # what is otherwise than it was: code, parameters

    @property
    def equal(self) -> bool:
        """Whether all that it decided, and that is something, was gone through and is the same."""
        return not self.refusal and self.difference is None and self.outputs > 0


@dataclass(frozen=True, slots=True)
class Moment:
    """One thing that entered an agent, and what it gave then and now."""

    at: float  # s since its journal began
    entry: Entry
    then: bytes | None  # outputs, encoded (`core.journal.outputs`); none: they were not taken yet
    now: bytes | None
    due_then: float | None  # when it wanted to be woken if nothing comes before, s by its clock
    due_now: float | None
    bids: tuple[BidRecord, ...]  # that it made of it, now

    @property
    def differs(self) -> bool:
        """Whether it gives something else, or wants to be woken at another time."""
        return self.then != self.now or repr(self.due_then) != repr(self.due_now)  # NaN is NaN


@dataclass
class Life:
    """One agent that lives its journal once more; go through `moments` once."""

    journal: Journal
    sets: Sequence[str] = ()
    """Parameters that are otherwise, each KEY=VALUE."""
    kind: type[Agent] | None = None
    """Its class; none: the one that is installed by its name."""
    agent: Agent = field(init=False)
    notes: tuple[str, ...] = field(init=False)
    end: str = field(init=False)  # why the journal ends early
    raised: str = field(init=False, default="")  # what its own code raised, now

    def __post_init__(self) -> None:
        """Build the agent. Raises ReplayError, and ConfigError for a setting that it refuses."""
        journal = self.journal
        if journal.head is None:
            raise ReplayError(journal.fault)
        self.end = journal.fault
        head = journal.head
        kind = _class(head) if self.kind is None else self.kind
        parameters = _parameters(head, kind, self.sets)
        self.notes = tuple(_notes(head, kind, self.sets))
        who = Identity(head.instance, head.host, head.pid, head.version, _stream(head))
        self.agent = kind(who, parameters)

    def moments(self) -> Iterator[Moment]:
        """All that entered it, in order. What the agent's own code raises ends it: `raised`."""
        entries = self._entries()
        start = next(entries, None)
        if start is None:
            return
        began, admit = float(start[1]), bool(start[2])
        clock = 0.0
        driver = Driver(self.agent, began, admit=admit, wall=lambda: clock)
        asked: dict[int, type[Message]] = {}
        listens = {to.pattern: to for to in self.agent.subscriptions()}
        entry = next(entries, None)
        seen: BidRecord | None = None
        while entry is not None:
            if entry[0] == j.ASKED:
                clock = float(entry[5])
            self._enter(driver, entry, listens, asked)
            following = next(entries, None)
            then = now = due_then = due_now = None
            if following is not None and following[0] == j.TAKE:
                (_, then, due_then), following = following, next(entries, None)
                given = [] if self.raised else driver.drain()
                for item in given:
                    if isinstance(item, AskFor):
                        asked[item.id] = item.reply
                now, due_now = j.outputs(given), driver.wakeup
            bids = _since(self.agent, seen)
            seen = bids[-1] if bids else seen
            if self.raised and following is not None and following[0] == j.LEAVE and then is None:
                self.raised = ""  # it failed then, too, and left
            yield Moment(float(entry[1]) - began, entry, then, now, due_then, due_now, bids)
            if self.raised:
                return
            entry = following

    def _entries(self) -> Iterator[Entry]:
        try:
            yield from self.journal.entries()
        except ValueError as error:
            self.end = f"its journal is damaged: {error}"

    def _enter(
        self,
        driver: Driver,
        entry: Entry,
        listens: Listens,
        asked: dict[int, type[Message]],
    ) -> None:
        try:
            _DO[entry[0]](driver, entry, listens, asked)
        except Exception as error:  # an agent's own code, which may be other code than it was
            self.raised = f"{type(error).__name__}: {error}"


class Replay:
    """One agent's life gone through again, and compared moment by moment."""

    def __init__(
        self, journal: Journal, sets: Sequence[str] = (), kind: type[Agent] | None = None
    ) -> None:
        """Build the agent.

        Args:
            journal: Its life.
            sets: Parameters that are otherwise, each KEY=VALUE.
            kind: Its class; none: the one that is installed by its name.

        Raises ConfigError for a setting that it refuses. What else is in the way is `refusal`.
        """
        self.journal = journal
        self.refusal = ""
        self.began = journal.began if journal.frames else 0.0  # s since 1970
        self._life: Life | None = None
        self._inputs = self._outputs = self._different = 0
        self._at = 0.0
        self._first: Difference | None = None
        try:
            self._life = Life(journal, sets, kind)
        except ReplayError as error:
            self.refusal = str(error)

    def moments(self) -> Iterator[Moment]:
        """All moments, each compared by the time that it comes out. To be gone through once."""
        life = self._life
        if life is None:
            return
        recent: list[Entry] = []
        for moment in life.moments():
            self._inputs += 1
            self._at = moment.at
            recent.append(moment.entry)
            if moment.differs or life.raised:
                self._different += 1
                if self._first is None:
                    self._first = _difference(life, moment, recent, self._outputs)
            if moment.then is not None:
                self._outputs += _count(moment.then)
                del recent[:-INPUTS]
            yield moment

    def outcome(self) -> Outcome:
        """What came of it so far."""
        journal, life = self.journal, self._life
        return Outcome(
            namespace=journal.namespace,
            name=journal.name,
            instance=journal.instance,
            began=self.began,
            seconds=self._at,
            inputs=self._inputs,
            outputs=self._outputs,
            different=self._different,
            difference=self._first,
            refusal=self.refusal,
            end="" if life is None else life.end,
            notes=() if life is None else life.notes,
        )


def replayed(
    journal: Journal, sets: Sequence[str] = (), kind: type[Agent] | None = None
) -> Outcome:
    """Go through an agent's life again, and compare: see `Replay`. Raises ConfigError."""
    replay = Replay(journal, sets, kind)
    for _ in replay.moments():
        pass
    return replay.outcome()


# Building it --------------------------------------------------------------------------------------


def _class(head: Head) -> type[Agent]:
    try:
        return agent_class(head.name)
    except (UnknownNameError, ImportError) as error:
        raise ReplayError(f"{error} (it was {head.kind})") from None


def _parameters(head: Head, kind: type[Agent], sets: Sequence[str]) -> Any:
    try:
        then = convert(head.parameters, kind.parameters, "its parameters then", "")
    except ConfigError as error:
        raise ReplayError(f"{error}: its code is another one now") from None
    now = set_values(then, sets)
    try:
        here = files(then)
    except (ConfigError, OSError) as error:
        raise ReplayError(f"a file that it read is not as it was: {error}") from None
    for name, was in head.files.items():
        if here.get(name) != was and getattr(now, name, None) == getattr(then, name, None):
            named = head.parameters.get(name)
            raise ReplayError(
                f"{name} {named!r} is not what it read then: what stands in it has changed, or it"
                f" is another one of that name (was {was}, is {here.get(name)})"
            )
    return now


def _stream(head: Head) -> Any:
    try:
        return stream(head.random)
    except (ValueError, TypeError) as error:
        raise ReplayError(f"its random numbers cannot be gone on with: {error}") from None


def _notes(head: Head, kind: type[Agent], sets: Sequence[str]) -> Iterator[str]:
    code = software()
    if head.source != code.source:
        yield f"recorded with other code: {head.commit}, and this is {code.commit}"
    named = f"{kind.__module__}:{kind.__qualname__}"
    if head.kind != named:
        yield f"it was {head.kind}, and is {named} here"
    if sets:
        yield f"open loop, with {', '.join(sets)}: what entered it stays as it was"


# What enters --------------------------------------------------------------------------------------


def _read(payload: Any, kind: type[Message] | None) -> Any:
    """A payload as it was handed over: bytes, or a message that had been read."""
    return payload if isinstance(payload, bytes) or kind is None else msgspec.convert(payload, kind)


def _deliver(driver: Driver, e: Entry, listens: Listens, _: Any) -> None:
    to = listens.get(e[2])
    if to is not None:  # or it does not listen to that any more
        driver.deliver(to, e[3], _read(e[4], to.message), e[1])


def _asked(driver: Driver, e: Entry, _listens: Any, _: Any) -> None:
    driver.asked(e[2], _read(e[3], driver.answers(e[2])), e[4], e[1])


def _replied(driver: Driver, e: Entry, _: Any, asked: dict[int, type[Message]]) -> None:
    kind = asked.pop(e[2], None)
    if kind is not None:  # or it did not ask, this time
        driver.replied(e[2], None if e[3] is None else msgspec.convert(e[3], kind), e[1])


def _received(driver: Driver, e: Entry, _listens: Any, _: Any) -> None:
    if isinstance(driver.agent, DeviceAgent):
        driver.received(e[2], e[1])


def _link(driver: Driver, e: Entry, _listens: Any, _: Any) -> None:
    if isinstance(driver.agent, DeviceAgent):
        driver.link(e[2], e[3], e[1])


_DO: Final[Mapping[int, Callable[[Driver, Entry, Listens, Any], None]]] = {
    j.BEGIN: lambda d, e, _l, _a: d.begin(e[1]),
    j.WAKE: lambda d, e, _l, _a: d.wake(e[1]),
    j.LEAVE: lambda d, e, _l, _a: d.leave(e[1]),
    j.TOKEN: lambda d, e, _l, _a: d.token(e[2], e[3], e[4], e[1]),
    j.DELIVER: _deliver,
    j.ASKED: _asked,
    j.REPLIED: _replied,
    j.RECEIVED: _received,
    j.LINK: _link,
    j.ROUTER: lambda d, e, _l, _a: d.router(e[2], e[1]),
    j.SLOW: lambda d, e, _l, _a: d.slow(e[2]),
    j.REFUSE: lambda d, e, _l, _a: d.refuse(e[2], e[3], e[1]),
    j.REPORT: lambda d, e, _l, _a: d.report(e[2], e[1]),
}


# What leaves --------------------------------------------------------------------------------------


def _since(agent: Agent, seen: BidRecord | None) -> tuple[BidRecord, ...]:
    """The bids that were made since one."""
    bids = agent.bids
    if not bids or bids[-1] is seen:
        return ()
    found: list[BidRecord] = []
    for bid in reversed(bids):
        if bid is seen:
            break
        found.append(bid)
    return tuple(reversed(found))


def _count(encoded: bytes) -> int:
    """How many outputs there are, without reading them."""
    first = encoded[0]
    return first - 0x90 if first < 0xA0 else len(msgpack.decode(encoded))


def _difference(life: Life, moment: Moment, recent: Sequence[Entry], before: int) -> Difference:
    then = _told(moment.then)
    now = (f"it fails: {life.raised}",) if life.raised else _told(moment.now)
    if repr(moment.due_then) != repr(moment.due_now) and not life.raised:
        then += (_due_told(moment, moment.due_then),)
        now += (_due_told(moment, moment.due_now),)
    same = 0
    while same < min(len(then), len(now)) and then[same] == now[same]:
        same += 1
    return Difference(
        at=moment.at,
        output=before + same,
        then=then[same:],
        now=now[same:],
        inputs=tuple(input_told(entry) for entry in recent[-INPUTS:]),
    )


def _told(encoded: bytes | None) -> tuple[str, ...]:
    try:
        return () if encoded is None else tuple(map(output_told, msgpack.decode(encoded)))
    except Exception:  # whatever damaged outputs make of it: they are told as they came
        return (_short(f"what is no output: {(encoded or b'').hex(' ')}"),)


def _due_told(moment: Moment, due: float | None) -> str:
    if due is None:
        return "to be woken by nothing but what comes"
    entered = moment.entry[1]
    return f"to be woken {due - entered:.3f} s later, if nothing comes before"


def message_told(kind: type[Message] | None, payload: Any) -> str:
    """A message that was read back, by field names, in one line."""
    try:
        if kind is not None:
            return told(msgspec.convert(payload, kind))
    except msgspec.ValidationError:
        pass  # what could not be sent
    return str(payload)


def output_told(item: Sequence[Any]) -> str:
    """One output of a journal, in one line."""
    what, *rest = item
    match what:
        case j.PUBLISH:
            said = f"publish {rest[0]} {message_told(kind_at(rest[0]), rest[1])}"
        case j.WRITE:
            said = f"write {rest[0].hex(' ')}"
        case j.ASK_FOR:
            said = f"ask {rest[1]} {rest[2]}"
        case j.REPLY:
            said = f"reply {rest[1]} {message_told(kind_at(rest[1]), rest[2])}"
        case _:
            said = {j.ANNOUNCE: "announce itself", j.OPEN_PORT: "open its port"}.get(
                what, f"{item}"
            )
    return _short(said)


def input_told(entry: Entry) -> str:
    """One input of a journal, in one line."""
    match entry[0]:
        case j.DELIVER:
            said = f"{entry[3]} {_delivered(entry[3], entry[4])}"
        case j.TOKEN:
            said = f"{entry[3]} {'appears' if entry[4] else 'is gone'}"
        case j.ASKED:
            said = f"query {entry[2]}"
        case j.REPLIED:
            said = "no reply" if entry[3] is None else f"reply {entry[3]}"
        case j.RECEIVED:
            said = f"bytes {entry[2].hex(' ')}"
        case number:
            words = {j.BEGIN: "begin", j.WAKE: "wake up", j.LEAVE: "leave"}
            said = words.get(number, f"{entry}")
    return _short(said)


def _delivered(key: str, payload: Any) -> str:
    """A payload that was delivered, read if it can be."""
    kind = kind_at(key)
    if not isinstance(payload, bytes):
        return message_told(kind, payload)
    try:
        return payload.hex() if kind is None else told(decode(payload, kind))
    except MessageError:
        return payload.hex()


def told(message: Message) -> str:
    """A message by field names, in one line."""
    return msgspec.json.encode(plain(message), enc_hook=str).decode()


def _short(text: str) -> str:
    text = line(text)
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."
