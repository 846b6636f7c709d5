"""A seeded corpus of mangled streams: neither side fails, and both understand what comes next."""

from __future__ import annotations

import random
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from armadico.bridge.p2os.commands import SYNC0, SYNC1
from armadico.bridge.p2os.packets import encode
from armadico.bridge.p2os.session import Reported, Session
from armadico.bridge.p2os.status import Status, encode_status

if TYPE_CHECKING:
    from conftest import Link

    from armadico.bridge.p2os.profile import P2osRobot

FOLDER = Path(__file__).parent / "transcripts"
SEEDS = range(6)
NAMES = encode(b"\x02Rob\0Pioneer\0p2dx\0")


def mangled(stream: bytes, draws: random.Random) -> bytes:
    """Flip, cut, repeat, insert and shuffle, a few times over."""
    data = bytearray(stream)
    for _ in range(draws.randint(1, 40)):
        at = draws.randrange(len(data))
        size = draws.randint(1, 30)
        match draws.randrange(5):
            case 0:
                data[at] ^= 1 << draws.randrange(8)
            case 1:
                del data[at : at + size]
            case 2:
                data[at:at] = data[at : at + size]
            case 3:
                data[at:at] = draws.randbytes(size)
            case _:
                data[at:at] = b"\xfa\xfb" + draws.randbytes(1)
        if not data:
            data = bytearray(b"\xfa")
    return bytes(data)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_controller_survives_and_serves_the_next_client(link: Link, seed: int) -> None:
    draws = random.Random(seed)
    source = draws.choice(sorted(FOLDER.glob("*.c2s.bin"))).read_bytes()
    stream = mangled(source, draws)
    while stream:
        size = draws.randint(1, 40)
        link.controller.receive(stream[:size])
        link.now += 0.01
        link.controller.advance(link.now)
        stream = stream[size:]
    link.let_pass(3.0, client=False)
    link.new_session()
    assert isinstance(link.let_pass(6.0)[-1], Reported)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_session_survives_and_reads_the_next_status(profile: P2osRobot, seed: int) -> None:
    draws = random.Random(seed)
    source = draws.choice(sorted(FOLDER.glob("*.s2c.bin"))).read_bytes()
    session = Session(profile, 0.0)
    for answer in (SYNC0, SYNC1, NAMES):
        session.receive(answer, 0.0)
    assert session.is_open
    stream, now = mangled(source[200:2000], draws), 0.0
    while stream:
        size = draws.randint(1, 90)
        now += 0.05
        session.receive(stream[:size], now)
        stream = stream[size:]
        session.outgoing()
    session.restart(now)
    for pause in (0.2, 0.2, 0.2, 0.2):
        now += pause
        session.receive(b"", now)
    decoder_at = session.decoder.pending
    for answer in (SYNC0, SYNC1, NAMES):
        session.receive(answer, now)
    good = encode_status(
        Status(x_m=0, y_m=0, theta_rad=0, left_m_s=0, right_m_s=0, battery_v=12), profile.p2os
    )
    assert decoder_at == 0
    assert isinstance(session.receive(encode(good), now)[-1], Reported)
