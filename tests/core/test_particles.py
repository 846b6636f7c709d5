"""Particles as bytes."""

from __future__ import annotations

from math import pi

import pytest
from msgspec.structs import replace

from armadico.core.messages import Cycle, decode, encode
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Particles
from armadico.mobile.particles import FINEST_M, MOST, message_of, poses_of
from armadico.observe.watching import as_object, from_object

CYCLE = Cycle(1, 2)


@pytest.mark.parametrize("wide", [0.2, 60.0, 5000.0])
def test_places_and_headings_come_back_to_half_a_step(wide: float) -> None:
    poses = [(-7.0 + wide * n / 299, 3.0 - n / 299, -4.0 + 8.0 * n / 299) for n in range(MOST)]
    message = decode(encode(message_of(CYCLE, poses)), Particles)
    assert message.step == pytest.approx(max(FINEST_M, wide / 65535))
    back = poses_of(message)
    assert len(back) == MOST
    for (x, y, theta), (x2, y2, theta2) in zip(poses, back, strict=True):
        assert max(abs(x - x2), abs(y - y2)) <= 0.501 * message.step
        assert abs(wrap(theta - theta2)) <= 1.01 * pi / 65536


def test_a_message_of_them_is_small() -> None:
    poses = [(0.1 * n, 0.2 * n, 0.3 * n) for n in range(MOST)]
    assert len(encode(message_of(CYCLE, poses))) < 6 * MOST + 50


def test_the_bytes_are_as_in_the_protocol() -> None:
    message = message_of(CYCLE, [(1.0, 2.0, 0.0), (1.258, 2.001, -pi / 2)])
    assert (message.x, message.y, message.step) == (1.0, 2.0, 0.001)
    assert message.packed == bytes([0, 0, 0, 0, 0, 0, 2, 1, 1, 0, 0, 0xC0])


def test_none_are_a_message_too_and_what_are_no_particles_is_refused() -> None:
    nothing = message_of(CYCLE, [])
    assert poses_of(decode(encode(nothing), Particles)) == []
    with pytest.raises(ValueError, match="7 bytes"):
        poses_of(replace(nothing, packed=b"7 bytes"))


def test_they_are_recorded_and_read_back_with_their_bytes_as_text() -> None:
    message = message_of(CYCLE, [(1.0, 2.0, 0.5)])
    assert from_object(Particles, as_object(message)) == message
