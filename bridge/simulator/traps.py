"""Traps: behaviour of other controllers and simulators that ours does not have, enabled on purpose.

Each was observed on a controller that clients meet (docs/controller.md says which). Together they
make the unkind controller, for testing that an agent depends on none of them.
"""

from __future__ import annotations

from enum import Enum


class Trap(Enum):
    """A trap, by its name for `armadico sim --unkind`."""

    FIRST_PACKET = "first-packet"
    """A packet in the handshake is a SYNC whatever its number, and is answered with that number.
    After a VEL (11) the session is open, and SYNC0 is a pulse, until CLOSE or disconnection."""

    PORT = "port"
    """Neither CLOSE nor silence ends a connection: the client keeps the port until it hangs up."""

    RAYS = "rays"
    """A sonar is a single ray: it misses what is beside its axis."""

    SHORT = "short"
    """Status packets end at the digital outputs, as in P2OS; ARCOS has more."""

    ODOMETRY = "odometry"
    """OPEN sets the odometry to zero."""


UNKIND = frozenset(Trap)
KIND: frozenset[Trap] = frozenset()
