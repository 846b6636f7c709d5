"""A journal is kept beside an agent's life, and changes nothing in it."""

from __future__ import annotations

import zlib
from typing import Any, ClassVar

from msgspec import msgpack

from armadico.core import journal as j
from armadico.core.agent import Agent, Identity, Publish
from armadico.core.driver import Driver, Output, Reply
from armadico.core.messages import Ask, Card, JournalPiece, JournalRequest, Log, Message, encode
from armadico.core.services import Kind, Service, register, service_of

AGAIN = "journal/bell-1/piece"


class Ringing(Message, frozen=True):
    """Somebody rings."""

    room: str


register(Service(Ringing, "ringing", Kind.EVENT, None, None, "a test's own"))


class Bell(Agent):
    """Logs what rings."""

    name = "bell"
    receives: ClassVar[tuple[type[Message], ...]] = (Ringing,)

    def on_ringing(self, ringing: Ringing) -> None:
        self.log(f"in {ringing.room}")
        self.wake_at(self.now + 1.0)

    def on_wakeup(self) -> None:
        self.log("still")


def journalled(**more: Any) -> j.Journalled:
    driver = j.Journalled(Bell(Identity("bell-1")), 10.0, b"head", admit=False, **more)
    driver.begin(10.0)
    driver.drain()
    return driver


def ring(driver: Driver, now: float, payload: bytes | None = None) -> list[Output]:
    """What comes of it."""
    to = next(to for to in driver.agent.subscriptions() if to.message is Ringing)
    driver.deliver(to, "ringing", encode(Ringing("R1")) if payload is None else payload, now)
    return driver.drain()


def entries(pieces: list[JournalPiece]) -> list[Any]:
    found, data = list[Any](), b"".join(piece.data for piece in pieces)
    while data:
        end = 4 + int.from_bytes(data[:4], "big")
        found += msgpack.decode(zlib.decompress(data[4:end]))
        data = data[end:]
    return found


def messages(out: list[Output]) -> list[JournalPiece]:
    return [o.message for o in out if isinstance(o, Publish) and type(o.message) is JournalPiece]


def test_what_enters_and_leaves_is_in_it_in_order() -> None:
    driver = journalled(publishes=False)
    ring(driver, 11.0)
    driver.wake(12.0)
    driver.drain()
    driver.drain()  # missing inputs are not logged twice
    found = entries(driver.pieces())
    assert [entry[0] for entry in found] == [
        *(j.START, j.BEGIN, j.TAKE),
        *(j.DELIVER, j.TAKE, j.WAKE, j.TAKE),
    ]
    assert found[0] == [j.START, 10.0, False, b"head"]
    assert found[3][3:] == ["ringing", encode(Ringing("R1"))]
    assert msgpack.decode(found[4][1]) == [[j.PUBLISH, "log/bell-1", [20, "in R1", ""]]]
    assert [entry[2] for entry in found if entry[0] == j.TAKE] == [None, 12.0, None]
    assert driver.pieces() == []


def test_a_spoilt_payload_is_in_it_as_it_came() -> None:
    driver = journalled(publishes=False)
    ring(driver, 11.0, b"\xff")
    delivered, taken = entries(driver.pieces())[-2:]
    assert [delivered[0], *delivered[3:]] == [j.DELIVER, "ringing", b"\xff"]
    assert "rejected or dropped: 1 x on ringing" in str(msgpack.decode(taken[1]))


def test_its_outputs_are_those_of_any_driver() -> None:
    plain = Driver(Bell(Identity("bell-1")), 10.0, admit=False)
    plain.begin(10.0)
    plain.drain()
    kept = journalled(publishes=False)
    assert ring(plain, 11.0) == ring(kept, 11.0)
    assert plain.wakeup == kept.wakeup == 12.0


def test_it_wakes_to_publish_and_its_agent_is_not_woken_for_that() -> None:
    driver = journalled()
    assert driver.wakeup is None  # until something enters
    out = ring(driver, 10.2)
    assert [type(o.message) for o in out if isinstance(o, Publish)] == [Log]
    assert driver.wakeup == 10.0 + j.EVERY_S
    driver.wake(10.0 + j.EVERY_S)
    assert [piece.number for piece in messages(driver.drain())] == [1]


def test_its_beginning_is_published_as_soon_as_it_can_be_seen() -> None:
    driver = j.Journalled(Bell(Identity("bell-1")), 10.0, b"head", admit=False)
    driver.begin(10.0)
    (piece,) = messages(driver.drain())
    assert [entry[0] for entry in entries([piece])] == [j.START, j.BEGIN, j.TAKE]


def test_a_leaving_agent_publishes_all_of_it() -> None:
    driver = journalled()
    ring(driver, 10.1)
    driver.leave(10.2)
    found = entries(messages(driver.drain()))
    assert found[-2][0] == j.LEAVE
    assert found[-1][0] == j.TAKE


def test_a_query_is_answered_to_its_client_and_noted_with_its_number() -> None:
    driver = journalled(publishes=False, wall=lambda: 1e9)
    call = object()
    key = f"agent/bell/{driver.agent.instance}/card"
    driver.on_query(key, Ask(), call, 11.0)
    (reply,) = driver.drain()
    assert isinstance(reply, Reply)
    assert reply.call is call
    assert isinstance(reply.message, Card)
    on_query, taken = entries(driver.pieces())[-2:]
    assert on_query[4:] == [1, 1e9]
    assert msgpack.decode(taken[1])[0][:3] == [j.REPLY, 1, key]


def test_a_lost_piece_is_given_again_and_is_not_part_of_its_life() -> None:
    driver = journalled()
    ring(driver, 10.1)
    driver.wake(10.5)
    (piece,) = messages(driver.drain())
    assert driver.queries[AGAIN] is JournalRequest
    driver.on_query(AGAIN, encode(JournalRequest(1)), "call", 10.6)
    assert driver.drain() == [Reply("call", AGAIN, piece)]
    driver.on_query(AGAIN, encode(JournalRequest(2)), "call", 10.6)  # there is none
    driver.on_query(AGAIN, b"\xff", "call", 10.6)
    assert driver.drain() == []
    assert service_of(JournalRequest).reply is JournalPiece


def test_so_much_is_kept_and_no_more() -> None:
    driver = journalled()
    noise = bytes(range(256)) * 4
    for k in range(200):
        now = 10.0 + 0.6 * k
        ring(driver, now, j.zlib.compress(noise + bytes([k])) * 100)
        driver.wake(now + 0.5)
        driver.drain()
    assert driver._kept_bytes <= j.KEPT
    assert driver._kept_bytes == sum(len(piece.data) for piece in driver._kept)


def test_what_no_message_carries_is_in_it_too() -> None:
    class Wild:
        """Nothing that is sent."""

        def __repr__(self) -> str:
            return "wild"

    wild: Any = Wild()
    nan = j.outputs([Publish("a", Ringing(wild))])
    assert msgpack.decode(nan) == [[j.PUBLISH, "a", ["wild"]]]
    assert j.outputs([Publish("a", Log(2**80, ""))]) != b""
