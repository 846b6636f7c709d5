"""An agent's journal: all its inputs and outputs, in order, sans-IO.

Deliveries, wake-ups, replies, tokens and the device's bytes reach an agent by several ways, and a
fault may delay or corrupt them for this one agent only. Therefore their times and order are known
only to the agent itself, and it can keep its own journal. The same code and files with the
journal's inputs give the same outputs (`armadico.watch.replay`).

An *entry* is an array: one of the numbers below, then the agent's time, s:

    START, now, admit, head        the driver was created; `head` is the agent's identity
    BEGIN, now      WAKE, now      LEAVE, now
    TOKEN, now, name, instance, alive
    DELIVER, now, pattern, key, payload         by the subscription's pattern; as bytes, or as the
                                   message, where one process decoded it for several agents
    ASKED, now, key, payload, call, clock       `clock` is the host's clock, s
    REPLIED, now, question, payload             none: timed out
    RECEIVED, now, data            LINK, now, up, why           ROUTER, now, there
    GUARDED, now, acts_s, restarts_s             BRAKED, now     LATCH, now, by
    SLOW, now, took                REFUSE, now, key, why       REPORT, now, dropped
    TAKE, outputs, due             the outputs, encoded: an array of arrays; and the next wake-up,
                                   s, or none

    of outputs:  PUBLISH, key, message   ASK_FOR, id, key, request, timeout   WRITE, data
                 ANNOUNCE   OPEN_PORT   REPLY, call, key, message

Entries are collected for `EVERY_S` and become a *frame*: their array in MessagePack, compressed
(zlib), after its length (4 bytes, big-endian). The stream of frames is cut into *pieces*
(`messages.JournalPiece`). These are numbered, so a lost one is detected.
"""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from msgspec import msgpack
from msgspec.structs import astuple

from armadico.core.agent import Agent
from armadico.core.driver import Announce, Driver, Output, Reply
from armadico.core.kernel import Subscription
from armadico.core.messages import Card, JournalPiece, JournalRequest, Message, MessageError, decode
from armadico.core.outgoing import Publish, SendQuery, Write
from armadico.core.services import service_of

FORMAT: Final = 4  # the version of this format
READABLE: Final = (2, 3, FORMAT)  # format 2 has no `ROUTER`, and 3 no `GUARDED`, `BRAKED`, `LATCH`
EVERY_S: Final = 0.5  # how long entries are collected, s; a killed agent's journal lacks as much
PIECE: Final = 60_000  # largest piece, bytes: less than `messages.LARGEST_PAYLOAD`

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
GUARDED: Final = 15
BRAKED: Final = 16
LATCH: Final = 17

PUBLISH: Final = 0
ASK_FOR: Final = 1
WRITE: Final = 2
ANNOUNCE: Final = 3
OPEN_PORT: Final = 4
REPLY: Final = 5

# Bytes of the newest pieces (some minutes) that an agent keeps for a recorder that missed one.
KEPT: Final = 4_000_000

NOTHING: Final = b"\x90"  # no outputs, encoded

# A value of a type that no message carries was never sent: its `repr` is enough.
_ENCODER: Final = msgpack.Encoder(enc_hook=repr)


def outputs(items: list[Output]) -> bytes:
    """Return a driver's outputs, encoded deterministically."""
    if not items:
        return NOTHING
    plain = [_plain(item) for item in items]
    try:
        return _ENCODER.encode(plain)
    except (OverflowError, TypeError, ValueError):  # a number that no message carries
        return _ENCODER.encode([[*each[:1], repr(each[1:])] for each in plain])


def _plain(item: Output) -> tuple[object, ...]:
    if isinstance(item, Publish):
        return (PUBLISH, item.key, item.message)
    if isinstance(item, Write):
        return (WRITE, item.data)
    if isinstance(item, SendQuery):
        return (ASK_FOR, item.id, item.key, item.request, item.timeout)
    if isinstance(item, Reply):
        # A card of protocol 2 ends before `newest`; so journals of that protocol can be compared.
        old = isinstance(item.message, Card) and not item.message.newest
        message = astuple(item.message)[:-1] if old else item.message
        return (REPLY, item.call, item.key, message)
    return (ANNOUNCE,) if isinstance(item, Announce) else (OPEN_PORT,)


def _called(item: Output, of: int) -> Output:
    """Return a reply with the number of its call in the journal (0), or with the call (1)."""
    return Reply(item.call[of], item.key, item.message) if isinstance(item, Reply) else item


class Journalled(Driver):
    """A driver that also keeps a journal of its agent."""

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
        """Begin admission and the journal.

        `head` is the agent's identity, for `START`; `admit` and `wall` are as in `Driver`. The
        pieces are published, or without `publishes` the caller gets them from `pieces`.
        """
        super().__init__(agent, now, admit=admit, wall=None if wall is None else self._shown)
        self._machine = wall
        self._clock = 0.0  # its value at the last query
        self._entries: list[Any] = [(START, now, admit, head)]
        self._drained = True  # `drain` was called since the last input
        self._publishes = publishes
        self._close_at = now + EVERY_S
        self._number = 0  # of the next piece
        self._calls_received = 0
        self._ended = False
        self._ready: list[JournalPiece] = []
        self._kept: deque[JournalPiece] = deque()
        self._kept_bytes = 0
        self._again: list[Output] = []  # replies with pieces that were requested again
        self._again_key = service_of(JournalRequest).key_for(instance=agent.instance)
        self._piece_key = service_of(JournalPiece).key_for(instance=agent.instance)

    def pieces(self) -> list[JournalPiece]:
        """Return the journal's new pieces since the last call."""
        self._close()
        ready, self._ready = self._ready, []
        return ready

    @property
    def queries(self) -> dict[str, type[Message]]:
        """See `Driver`; and the query for a lost piece."""
        return super().queries | {self._again_key: JournalRequest}

    # Inputs --------------------------------------------------------------------------------------

    def begin(self, now: float) -> None:
        self._note((BEGIN, now))
        super().begin(now)

    @property
    def wakeup(self) -> float | None:
        """See `Driver`; or when the journal's next pieces are due, if that is earlier."""
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

    def on_query(self, key: str, payload: bytes | Message, call: object, now: float) -> None:
        """See `Driver`; a query for a lost piece is not an input of the agent."""
        if key == self._again_key:
            self._resend(key, payload, call)
            return
        self._clock = 0.0 if self._machine is None else self._machine()
        self._calls_received += 1
        self._note((ASKED, now, key, payload, self._calls_received, self._clock))
        super().on_query(key, payload, (self._calls_received, call), now)

    def on_reply(self, question: int, reply: Message | None, now: float) -> None:
        self._note((REPLIED, now, question, reply))
        super().on_reply(question, reply, now)

    def received(self, data: bytes, now: float) -> None:
        self._note((RECEIVED, now, data))
        super().received(data, now)

    def link(self, up: bool, why: str, now: float) -> None:
        self._note((LINK, now, up, why))
        super().link(up, why, now)

    def guarded(self, acts_s: float, restarts_s: float, now: float) -> None:
        self._note((GUARDED, now, acts_s, restarts_s))
        super().guarded(acts_s, restarts_s, now)

    def braked(self, now: float) -> None:
        self._note((BRAKED, now))
        super().braked(now)

    def latch(self, by: str, now: float) -> None:
        self._note((LATCH, now, by))
        super().latch(by, now)

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

    # Outputs -------------------------------------------------------------------------------------

    def drain(self) -> list[Output]:
        """See `Driver`; and the journal's pieces, if they are published."""
        items, announced = super().drain(), False
        if items:
            self._entries.append((TAKE, [_called(item, 0) for item in items], self._due()))
            # An announced agent has published its journal so far, however soon it is killed.
            announced = any(isinstance(item, Announce) for item in items)
            items = [_called(item, 1) for item in items]
        elif not self._drained:
            self._entries.append((TAKE, [], self._due()))
        self._drained = True
        if self._publishes:
            if self._ended or announced:
                self._close()
            if self._ready:
                items += [Publish(self._piece_key, piece) for piece in self._ready]
                self._keep(self._ready)
                self._ready = []
            if self._again:
                items += self._again
                self._again = []
        return items

    # Inside --------------------------------------------------------------------------------------

    def _note(self, entry: tuple[object, ...]) -> None:
        self._entries.append(entry)
        self._drained = False

    def _keep(self, pieces: list[JournalPiece]) -> None:
        for piece in pieces:
            self._kept.append(piece)
            self._kept_bytes += len(piece.data)
        while self._kept_bytes > KEPT:
            self._kept_bytes -= len(self._kept.popleft().data)

    def _resend(self, key: str, payload: bytes | Message, call: object) -> None:
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
        """Make a frame of the collected entries, and pieces of it."""
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
