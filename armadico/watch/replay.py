"""Replay of an agent from its journal, sans-IO, under the journal's own clock.

The agent is built again with its recorded parameters, random numbers and identity, and receives
its recorded inputs at the recorded times. Its outputs are compared byte for byte with the recorded
ones. The result is equality, or the first difference with both sides and the last inputs.

With other parameters or other code the inputs stay as recorded (open loop). The outputs are then
the decisions for the recorded inputs; their effects on the world are not simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Any, Final

import msgspec
from msgspec import Struct, msgpack

from armadico.config.loading import convert, set_values
from armadico.core import journal as j
from armadico.core.agent import Agent, DeviceAgent, Identity, Parameters
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import agent_class
from armadico.core.driver import Driver
from armadico.core.errors import UnknownNameError
from armadico.core.kernel import Subscription
from armadico.core.messages import BidRecord, Message, MessageError, decode, line, plain
from armadico.core.outgoing import SendQuery
from armadico.observe.conditions import software
from armadico.observe.journals import Entry, Head, Journal, files, stream
from armadico.observe.watching import kind_at

Subscriptions = Mapping[str, Subscription]  # by pattern
Queries = dict[int, type[Message]]  # those under way, by number

INPUTS: Final = 5  # last inputs shown with a difference
LONGEST: Final = 300  # characters shown of one input or output


class ReplayError(ValueError):
    """This journal cannot be replayed; the message has the reason."""


class Difference(Struct, frozen=True, kw_only=True):
    """The first moment at which the outputs differ from the recorded ones."""

    at: float  # s since the agent's journal began
    output: int  # number of equal outputs before it
    then: tuple[str, ...]  # recorded outputs and wake-up time, from the first difference on
    now: tuple[str, ...]  # the same, replayed
    inputs: tuple[str, ...]  # the last inputs, newest last


class Outcome(Struct, frozen=True, kw_only=True):
    """The result of one agent's replay."""

    namespace: str
    name: str
    instance: str
    began: float = 0.0  # s since 1970, by the recorder's clock
    seconds: float = 0.0  # duration replayed
    inputs: int = 0
    outputs: int = 0  # recorded outputs; compared one by one up to the first difference
    different: int = 0  # moments that differ
    difference: Difference | None = None  # the first of them
    refusal: str = ""  # why it was not replayed
    end: str = ""  # why its journal ends before the agent did
    notes: tuple[str, ...] = ()  # changes since the recording: code, parameters

    @property
    def equal(self) -> bool:
        """Whether there were outputs, and all of them are equal."""
        return not self.refusal and self.difference is None and self.outputs > 0


@dataclass(frozen=True, slots=True)
class Moment:
    """One input of an agent, with the recorded and the replayed outputs."""

    at: float  # s since its journal began
    entry: Entry
    then: bytes | None  # outputs, encoded (`core.journal.outputs`); none: not collected yet
    now: bytes | None
    due_then: float | None  # wake-up time without further input, s by its clock
    due_now: float | None
    bids: tuple[BidRecord, ...]  # replayed bids for this input

    @property
    def differs(self) -> bool:
        """Whether the outputs or the wake-up times differ."""
        return self.then != self.now or repr(self.due_then) != repr(self.due_now)  # NaN is NaN


@dataclass
class Life:
    """One agent that receives the inputs of its journal again; iterate `moments` once."""

    journal: Journal
    sets: Sequence[str] = ()  # changed parameters, each KEY=VALUE
    kind: type[Agent] | None = None  # its class; none: the installed class of its name
    agent: Agent = field(init=False)
    notes: tuple[str, ...] = field(init=False)
    end: str = field(init=False)  # why the journal ends early
    raised: str = field(init=False, default="")  # the exception of the replayed code

    def __post_init__(self) -> None:
        """Build the agent. Raises ReplayError, and ConfigError for an invalid parameter."""
        journal = self.journal
        if journal.head is None:
            raise ReplayError(journal.fault)
        self.end = journal.fault
        head = journal.head
        kind = _class(head) if self.kind is None else self.kind
        parameters = _parameters(head, kind, self.sets)
        self.notes = tuple(_notes(head, kind, self.sets))
        who = head.instance, head.host, head.pid, head.version, _stream(head)
        identity = Identity(*who, head.table, head.map, protocol=head.protocol)
        self.agent = kind(identity, parameters)

    def moments(self) -> Iterator[Moment]:
        """All inputs in order, up to an exception of the agent's code, which is in `raised`."""
        entries = self._entries()
        start = next(entries, None)
        if start is None:
            return
        began, admit = float(start[1]), bool(start[2])
        clock = 0.0
        driver = Driver(self.agent, began, admit=admit, wall=lambda: clock)
        queries: Queries = {}
        subscriptions = {to.pattern: to for to in self.agent.kernel.subscriptions}
        entry = next(entries, None)
        seen: BidRecord | None = None
        while entry is not None:
            if entry[0] == j.ASKED:
                clock = float(entry[5])
            self._enter(driver, entry, subscriptions, queries)
            following = next(entries, None)
            then = now = due_then = due_now = None
            if following is not None and following[0] == j.TAKE:
                (_, then, due_then), following = following, next(entries, None)
                given = [] if self.raised else driver.drain()
                for item in given:
                    if isinstance(item, SendQuery):
                        queries[item.id] = item.reply
                now, due_now = j.outputs(given), driver.wakeup
            bids = _since(self.agent, seen)
            seen = bids[-1] if bids else seen
            if self.raised and following is not None and following[0] == j.LEAVE and then is None:
                self.raised = ""  # the recorded agent failed here too, and ended
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
        subscriptions: Subscriptions,
        queries: Queries,
    ) -> None:
        try:
            _DO[entry[0]](driver, entry, subscriptions, queries)
        except Exception as error:  # the agent's code may have changed
            self.raised = f"{type(error).__name__}: {error}"


class Replay:
    """One agent's replay, compared moment by moment."""

    def __init__(
        self, journal: Journal, sets: Sequence[str] = (), kind: type[Agent] | None = None
    ) -> None:
        """Build the agent.

        Changed parameters are KEY=VALUE; without a `kind` it has the installed class of its name.
        Raises ConfigError for an invalid parameter. Other obstacles are in `refusal`.
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
        """All moments, each compared before it is yielded; iterate once."""
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
        """The result so far."""
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
    """The result of replaying a journal completely; see `Replay`. Raises ConfigError."""
    replay = Replay(journal, sets, kind)
    for _ in replay.moments():
        pass
    return replay.outcome()


# The agent ----------------------------------------------------------------------------------------


def _class(head: Head) -> type[Agent]:
    try:
        return agent_class(head.name)
    except (UnknownNameError, ImportError) as error:
        raise ReplayError(f"{error} (it was {head.kind})") from None


def _parameters(head: Head, kind: type[Agent], sets: Sequence[str]) -> Parameters:
    try:
        then = convert(head.parameters, kind.parameters, "its parameters then", "")
    except ConfigError as error:
        raise ReplayError(f"{error}: its code has changed since the recording") from None
    now = set_values(then, sets)
    try:
        here = files(then)
    except (ConfigError, OSError) as error:
        raise ReplayError(f"a file that it read has changed: {error}") from None
    for name, was in head.files.items():
        if here.get(name) != was and getattr(now, name, None) == getattr(then, name, None):
            named = head.parameters.get(name)
            raise ReplayError(
                f"{name} {named!r} differs from the file that it read: it has changed, or is"
                f" another file of that name (was {was}, is {here.get(name)})"
            )
    return now


def _stream(head: Head) -> Random:
    try:
        return stream(head.random)
    except (ValueError, TypeError) as error:
        raise ReplayError(f"the recorded state of its random numbers is invalid: {error}") from None


def _notes(head: Head, kind: type[Agent], sets: Sequence[str]) -> Iterator[str]:
    code = software()
    if head.source != code.source:
        yield f"recorded with other code: {head.commit}; this is {code.commit}"
    named = f"{kind.__module__}:{kind.__qualname__}"
    if head.kind != named:
        yield f"its class was {head.kind}; here it is {named}"
    if sets:
        yield f"open loop with {', '.join(sets)}: the inputs stay as recorded"


# Inputs -------------------------------------------------------------------------------------------


def _read(payload: object, kind: type[Message] | None) -> Any:
    """A payload as the driver received it: bytes or a decoded message."""
    return payload if isinstance(payload, bytes) or kind is None else msgspec.convert(payload, kind)


def _on_delivery(driver: Driver, e: Entry, subscriptions: Subscriptions, _: object) -> None:
    to = subscriptions.get(e[2])
    if to is not None:  # None: the code no longer subscribes to it
        driver.deliver(to, e[3], _read(e[4], to.message), e[1])


def _on_query(driver: Driver, e: Entry, _listens: object, _: object) -> None:
    driver.on_query(e[2], _read(e[3], driver.answers(e[2])), e[4], e[1])


def _on_reply(driver: Driver, e: Entry, _: object, queries: Queries) -> None:
    kind = queries.pop(e[2], None)
    if kind is not None:  # None: the replayed agent sent no such query
        driver.on_reply(e[2], None if e[3] is None else msgspec.convert(e[3], kind), e[1])


Do = Callable[[Driver, Entry, Subscriptions, Queries], None]


def _to_device(do: Callable[[Driver, Entry], None]) -> Do:
    """An input of agents with a device alone: the replayed code may have none."""

    def give(driver: Driver, e: Entry, _listens: object, _: object) -> None:
        if isinstance(driver.agent, DeviceAgent):
            do(driver, e)

    return give


_DO: Final[Mapping[int, Do]] = {
    j.BEGIN: lambda d, e, _l, _a: d.begin(e[1]),
    j.WAKE: lambda d, e, _l, _a: d.wake(e[1]),
    j.LEAVE: lambda d, e, _l, _a: d.leave(e[1]),
    j.TOKEN: lambda d, e, _l, _a: d.token(e[2], e[3], e[4], e[1]),
    j.DELIVER: _on_delivery,
    j.ASKED: _on_query,
    j.REPLIED: _on_reply,
    j.RECEIVED: _to_device(lambda d, e: d.received(e[2], e[1])),
    j.LINK: _to_device(lambda d, e: d.link(e[2], e[3], e[1])),
    j.GUARDED: _to_device(lambda d, e: d.guarded(e[2], e[3], e[1])),
    j.BRAKED: _to_device(lambda d, e: d.braked(e[1])),
    j.LATCH: lambda d, e, _l, _a: d.latch(e[2], e[1]),
    j.ROUTER: lambda d, e, _l, _a: d.router(e[2], e[1]),
    j.SLOW: lambda d, e, _l, _a: d.slow(e[2]),
    j.REFUSE: lambda d, e, _l, _a: d.refuse(e[2], e[3], e[1]),
    j.REPORT: lambda d, e, _l, _a: d.report(e[2], e[1]),
}


# Outputs ------------------------------------------------------------------------------------------


def _since(agent: Agent, seen: BidRecord | None) -> tuple[BidRecord, ...]:
    """The bids after `seen`."""
    bids = agent.kernel.bids
    if not bids or bids[-1] is seen:
        return ()
    found: list[BidRecord] = []
    for bid in reversed(bids):
        if bid is seen:
            break
        found.append(bid)
    return tuple(reversed(found))


def _count(encoded: bytes) -> int:
    """The number of outputs, from the head of the MessagePack array."""
    first = encoded[0]
    return first - 0x90 if first < 0xA0 else len(msgpack.decode(encoded))


def _difference(life: Life, moment: Moment, recent: Sequence[Entry], before: int) -> Difference:
    then = _describe(moment.then)
    now = (f"it fails: {life.raised}",) if life.raised else _describe(moment.now)
    if repr(moment.due_then) != repr(moment.due_now) and not life.raised:
        then += (_describe_due(moment, moment.due_then),)
        now += (_describe_due(moment, moment.due_now),)
    same = 0
    while same < min(len(then), len(now)) and then[same] == now[same]:
        same += 1
    return Difference(
        at=moment.at,
        output=before + same,
        then=then[same:],
        now=now[same:],
        inputs=tuple(describe_input(entry) for entry in recent[-INPUTS:]),
    )


def _describe(encoded: bytes | None) -> tuple[str, ...]:
    try:
        return () if encoded is None else tuple(map(describe_output, msgpack.decode(encoded)))
    except Exception:  # damaged outputs can raise anything
        return (_short(f"invalid output: {(encoded or b'').hex(' ')}"),)


def _describe_due(moment: Moment, due: float | None) -> str:
    if due is None:
        return "no wake-up without input"
    return f"wake-up {due - moment.entry[1]:.3f} s later, without earlier input"


def describe_payload(kind: type[Message] | None, payload: object) -> str:
    """A recorded message by field names, in one line."""
    try:
        if kind is not None:
            return describe(msgspec.convert(payload, kind))
    except msgspec.ValidationError:
        pass  # an invalid message, which could not be sent
    return str(payload)


def describe_output(item: Sequence[Any]) -> str:
    what, *rest = item
    match what:
        case j.PUBLISH:
            text = f"publish {rest[0]} {describe_payload(kind_at(rest[0]), rest[1])}"
        case j.WRITE:
            text = f"write {rest[0].hex(' ')}"
        case j.ASK_FOR:
            text = f"query {rest[1]} {rest[2]}"
        case j.REPLY:
            text = f"reply {rest[1]} {describe_payload(kind_at(rest[1]), rest[2])}"
        case _:
            text = {j.ANNOUNCE: "announce itself", j.OPEN_PORT: "open its port"}.get(
                what, f"{item}"
            )
    return _short(text)


def describe_input(entry: Entry) -> str:
    match entry[0]:
        case j.DELIVER:
            text = f"{entry[3]} {_describe_delivery(entry[3], entry[4])}"
        case j.TOKEN:
            text = f"{entry[3]} {'appears' if entry[4] else 'is gone'}"
        case j.ASKED:
            text = f"query {entry[2]}"
        case j.REPLIED:
            text = "no reply" if entry[3] is None else f"reply {entry[3]}"
        case j.RECEIVED:
            text = f"bytes {entry[2].hex(' ')}"
        case number:
            words = {j.BEGIN: "begin", j.WAKE: "wake up", j.LEAVE: "leave"}
            text = words.get(number, f"{entry}")
    return _short(text)


def _describe_delivery(key: str, payload: object) -> str:
    kind = kind_at(key)
    if not isinstance(payload, bytes):
        return describe_payload(kind, payload)
    try:
        return payload.hex() if kind is None else describe(decode(payload, kind))
    except MessageError:
        return payload.hex()


def describe(message: Message) -> str:
    """A message by field names, in one line."""
    return msgspec.json.encode(plain(message), enc_hook=str).decode()


def _short(text: str) -> str:
    text = line(text)
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."
