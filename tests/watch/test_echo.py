"""What is published is shown, whoever's message it is."""

from __future__ import annotations

import cbor2
import pytest

from armadico.cli import options
from armadico.core.messages import LARGEST_PAYLOAD
from armadico.observe.watching import Received
from armadico.watch.commands.echo import line_of


@pytest.mark.parametrize(
    ("data", "shows"),
    [
        (cbor2.dumps([[7, 12], 1.25, "near\x1b[2J"]), "[[7, 12], 1.25, near\ufffd[2J]"),
        (b"\xff\x00", "ff00"),
        (bytes(LARGEST_PAYLOAD + 1), "0000"),
    ],
)
def test_another_packages_message_is_shown_as_the_values_that_it_has(
    data: bytes, shows: str
) -> None:
    line = options.shown(line_of(Received("robot1", "room-finder/room", data, 0), as_json=False))
    assert f"room-finder/room  not in the table of services: {shows}" in line
