"""An agent's journal: what enters and leaves it, in the order in which it does, sans-IO.

Nobody outside knows when an agent received what, and in which order: deliveries, wake-ups, answers,
tokens and the bytes of its device come by many ways, and a fault may hold up or spoil them on the
way to this one agent only. So an agent that is asked to keeps its own journal. It is all that its
decisions hang on, besides its code and the files that it read: whoever builds the same agent anew
and does to it what the journal says gets the same out of it (`armadico.observe.replay`).

An *entry* is an array: first one of the numbers below, then the agent's time, s:

    START, now, admit, head        its driver was made; `head` says who it is
    BEGIN, now      WAKE, now      LEAVE, now
    TOKEN, now, name, instance, alive
    DELIVER, now, pattern, key, payload         by the subscription's pattern; as bytes, or the
                                   message, where one process had read it for several
    ASKED, now, key, payload, call, clock       `clock` is what its machine's clock showed, s
    REPLIED, now, question, payload             none: nobody answered in time
    RECEIVED, now, data            LINK, now, up, why           ROUTER, now, there
    SLOW, now, took                REFUSE, now, key, why       REPORT, now, dropped
    TAKE, outputs, due             what it gave, encoded: an array of arrays; and when it is to be
                                   woken, s, or none

    of outputs:  PUBLISH, key, message   ASK_FOR, id, key, request, timeout   WRITE, data
                 ANNOUNCE   OPEN_PORT   REPLY, call, key, message

Entries are gathered for a while and become a *frame*: their array in MessagePack, compressed
(zlib), after its length (4 bytes, the highest first). Frames follow one another, cut into
*pieces* (`messages.JournalPiece`), which are numbered, so that one that was lost is missed.
"""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from msgspec import msgpack

from armadico.core.agent import Agent, AskFor, Publish, Subscription, Write
from armadico.core.driver import Announce, Driver, Output, Reply
from armadico.core.messages import JournalPiece, JournalRequest, Message, MessageError, decode
from armadico.core.services import service_of

FORMAT: Final = 3
"""The version of all this; one more whenever it changes."""

READABLE: Final = (2, FORMAT)
"""Before 3 there was no `ROUTER`."""

EVERY_S: Final = 0.5
"""How long entries are gathered, s: of a killed agent's last moments so much is missing."""

PIECE: Final = 60_000
"""Bytes of a piece at the most: less than a payload may have."""

START: Final = 0
BEGIN: Final = 1
WAKE: Final = 2
LEAVE: Final = 3
TOKEN: Final = 4
DELIVER: Final = 5
ASKED: Final = 6
REPLIED: Final = 7
RECEIVED: Final = 8
LINK: Final = 9
SLOW: Final = 10
REFUSE: Final = 11
REPORT: Final = 12
TAKE: Final = 13
ROUTER: Final = 14

PUBLISH: Final = 0
ASK_FOR: Final = 1
WRITE: Final = 2
ANNOUNCE: Final = 3
OPEN_PORT: Final = 4
REPLY: Final = 5

KEPT: Final = 4_000_000
"""Bytes of the newest pieces that an agent keeps for a recorder which missed one: some minutes."""

NOTHING: Final = b"\x90"
"""No outputs, encoded."""


def _repr(value: Any) -> str:
    """What an agent put into a message that no message carries: it was never sent."""
    return repr(value)


_ENCODER: Final = msgpack.Encoder(enc_hook=_repr)


def outputs(items: list[Output]) -> bytes:
    """What a driver gave, encoded: the same bytes for the same outputs."""
    if not items:
        return NOTHING
    plain = [_plain(item) for item in items]
    try:
        return _ENCODER.encode(plain)
    except (OverflowError, TypeError, ValueError):  # a number that no message carries
        return _ENCODER.encode([[*each[:1], repr(each[1:])] for each in plain])


def _plain(item: Output) -> tuple[Any, ...]:
    if isinstance(item, Publish):
        return (PUBLISH, item.key, item.message)
    if isinstance(item, Write):
        return (WRITE, item.data)
    if isinstance(item, AskFor):
        return (ASK_FOR, item.id, item.key, item.request, item.timeout)
    if isinstance(item, Reply):
        return (REPLY, item.call, item.key, item.message)
    return (ANNOUNCE,) if isinstance(item, Announce) else (OPEN_PORT,)


def _called(item: Output, of: int) -> Output:
    """A reply to the number of its call in the journal (0), or to the call (1)."""
    return Reply(item.call[of], item.key, item.message) if isinstance(item, Reply) else item


class Journalled(Driver):
    """A driver that keeps a journal of its agent; to whoever runs it, it is as any other."""

    def __init__(
        self,
        agent: Agent,
        now: float,
        head: bytes,
        *,
        admit: bool = True,
        wall: Callable[[], float] | None = None,
        publishes: bool = True,
    ) -> None:
        """Begin to look around, and the journal.

        Args:
            agent: Whose life it is.
            now: The time, s.
            head: Who the agent is, for `START`.
            admit: Without, it joins whoever is alive.
            wall: Wall time for the card, s since 1970.
            publishes: Its pieces are published as they come; without, `pieces` is asked for them.
        """
        super().__init__(agent, now, admit=admit, wall=None if wall is None else self._shown)
        self._machine = wall
        self._clock = 0.0  # what that showed when the agent was last asked for something
        self._entries: list[Any] = [(START, now, admit, head)]
        self._taken = True  # whether `take` was called since anything entered
        self._publishes = publishes
        self._close_at = now + EVERY_S
        self._number = 0  # of the next piece
        self._calls_asked = 0
        self._ended = False
        self._ready: list[JournalPiece] = []
        self._kept: deque[JournalPiece] = deque()  # those that may be asked for,
        self._kept_bytes = 0
        self._again: list[Output] = []  # and those that were
        self._again_key = service_of(JournalRequest).key_for(instance=agent.instance)
        self._piece_key = service_of(JournalPiece).key_for(instance=agent.instance)

    def pieces(self) -> list[JournalPiece]:
        """All that is in the journal by now and was not taken yet."""
        self._close()
        ready, self._ready = self._ready, []
        return ready

    @property
    def queries(self) -> dict[str, type[Message]]:
        """See `Driver`; and a piece again."""
        return self._queries() | {self._again_key: JournalRequest}

    # What enters ---------------------------------------------------------------------------------

    def begin(self, now: float) -> None:
        self._note((BEGIN, now))
        super().begin(now)

    @property
    def wakeup(self) -> float | None:
        """See `Driver`; and when the journal's next pieces are due."""
        due = self._due()
        if not (self._publishes and self._entries):
            return due
        return self._close_at if due is None or self._close_at < due else due

    def wake(self, now: float) -> None:
        due = self._due()
        if due is not None and now >= due:
            self._note((WAKE, now))
            super().wake(now)
        if self._publishes and now >= self._close_at:
            self._close_at = now + EVERY_S
            self._close()

    def leave(self, now: float) -> None:
        self._note((LEAVE, now))
        super().leave(now)
        self._ended = True

    def deliver(self, to: Subscription, key: str, payload: bytes | Message, now: float) -> None:
        self._note((DELIVER, now, to.pattern, key, payload))
        super().deliver(to, key, payload, now)

    def token(self, name: str, instance: str, alive: bool, now: float) -> None:
        self._note((TOKEN, now, name, instance, alive))
        super().token(name, instance, alive, now)

    def asked(self, key: str, payload: bytes | Message, call: Any, now: float) -> None:
        """See `Driver`; a piece that is asked for enters nobody, and is in no journal."""
        if key == self._again_key:
            self._give_again(key, payload, call)
            return
        self._clock = 0.0 if self._machine is None else self._machine()
        self._calls_asked += 1
        self._note((ASKED, now, key, payload, self._calls_asked, self._clock))
        super().asked(key, payload, (self._calls_asked, call), now)

    def replied(self, question: int, reply: Message | None, now: float) -> None:
        self._note((REPLIED, now, question, reply))
        super().replied(question, reply, now)

    def received(self, data: bytes, now: float) -> None:
        self._note((RECEIVED, now, data))
        super().received(data, now)

    def link(self, up: bool, why: str, now: float) -> None:
        self._note((LINK, now, up, why))
        super().link(up, why, now)

    def router(self, there: bool, now: float) -> None:
        self._note((ROUTER, now, there))
        super().router(there, now)

    def slow(self, took: float) -> None:
        self._note((SLOW, self.now, took))
        super().slow(took)

    def refuse(self, key: str, why: object, now: float) -> None:
        self._note((REFUSE, now, key, str(why)))
        super().refuse(key, why, now)

    def report(self, dropped: dict[str, int], now: float) -> None:
        self._note((REPORT, now, dropped))
        super().report(dropped, now)

    # What leaves ---------------------------------------------------------------------------------

    def drain(self) -> list[Output]:
        """See `Driver`; and the journal's pieces, if they are published."""
        given, shown = super().drain(), False
        if given:
            self._entries.append((TAKE, [_called(item, 0) for item in given], self._due()))
            # Whoever sees it sees its journal, too, however soon it is killed.
            shown = any(isinstance(item, Announce) for item in given)
            given = [_called(item, 1) for item in given]
        elif not self._taken:
            self._entries.append((TAKE, [], self._due()))
        self._taken = True
        if self._publishes:
            if self._ended or shown:
                self._close()
            if self._ready:
                given += [Publish(self._piece_key, piece) for piece in self._ready]
                self._keep(self._ready)
                self._ready = []
            if self._again:
                given += self._again
                self._again = []
        return given

    # Inside --------------------------------------------------------------------------------------

    def _note(self, entry: tuple[Any, ...]) -> None:
        self._entries.append(entry)
        self._taken = False

    def _keep(self, pieces: list[JournalPiece]) -> None:
        for piece in pieces:
            self._kept.append(piece)
            self._kept_bytes += len(piece.data)
        while self._kept_bytes > KEPT:
            self._kept_bytes -= len(self._kept.popleft().data)

    def _give_again(self, key: str, payload: bytes | Message, call: Any) -> None:
        try:
            request = decode(payload, JournalRequest) if isinstance(payload, bytes) else payload
        except MessageError:
            return
        if not (self._kept and isinstance(request, JournalRequest)):
            return
        place = request.number - self._kept[0].number
        if 0 <= place < len(self._kept):
            self._again.append(Reply(call, key, self._kept[place]))

    def _shown(self) -> float:
        return self._clock

    def _close(self) -> None:
        """Make a frame of the entries that were gathered, and pieces of it."""
        if not self._entries:
            return
        entries, self._entries = self._entries, []
        for place, entry in enumerate(entries):
            if entry[0] == TAKE:
                entries[place] = (TAKE, outputs(entry[1]), entry[2])
        packed = zlib.compress(_ENCODER.encode(entries), 1)
        frame = len(packed).to_bytes(4, "big") + packed
        for begin in range(0, len(frame), PIECE):
            data = frame[begin : begin + PIECE]
            self._ready.append(JournalPiece(self.agent.instance, self._number, data))
            self._number += 1
