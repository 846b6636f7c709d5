"""Agents of other developers: python toys.py KIND HOST, on the mesh of ARMADICO_HOSTS.

`driver` bids for the wheels with all that it has, `foreign` does so by another protocol, and `late`
is on a machine whose clock is an hour ahead.
"""

from __future__ import annotations

import logging
import sys
import time
from typing import Any, ClassVar

from msgspec.structs import replace

from armadico.config.endpoints import endpoints
from armadico.core.agent import Agent
from armadico.core.exchange import Bid
from armadico.core.messages import PROTOCOL, Card, Message, RobotState
from armadico.core.resources import WHEELS, Resource
from armadico.runtime.process import identity, serve

AHEAD_S = 3600.0


class Driver(Agent):
    """Drives straight on, past any obstacle."""

    name = "driver"
    reacts_to = RobotState
    provides: ClassVar[tuple[type[Message], ...]] = ()
    competes_for: ClassVar[tuple[Resource, ...]] = (WHEELS,)

    def bid(self, message: Any) -> Bid:
        return Bid(utility=1.0, action=(0.3, 0.0), critical=True)


class Foreign(Driver):
    """Joins all the same, although its card is of a protocol that the others do not understand."""

    def fill_card(self, card: Card) -> Card:
        return replace(card, protocol=PROTOCOL + 1, newest=0)


def main(kind: str, host: str) -> None:
    logging.basicConfig(stream=sys.stderr)
    ahead = AHEAD_S if kind == "late" else 0.0
    mesh = endpoints(host=host, passing=False).mesh()
    toy = Foreign if kind == "foreign" else Driver
    serve([toy(identity("driver", host))], mesh, wall=lambda: time.time() + ahead)


if __name__ == "__main__":
    main(*sys.argv[1:])
