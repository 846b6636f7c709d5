"""What other controllers and simulators do to a client that ours does not: traps, set on purpose.

Each was seen on a controller that clients meet (docs/controller.md says which). Together they are
the unkind controller: an agent that reaches its goals there relies on nobody's kindness.
"""

from __future__ import annotations

from enum import Enum


class Trap(Enum):
    """A trap, by the name that `armadico sim --unkind` knows it by."""

    FIRST_PACKET = "first-packet"
    """A packet in the handshake is a SYNC whatever its number, and is answered with that number:
    after a VEL (11) it is in step, and SYNC0 but a pulse, until CLOSE or until the client goes."""

    PORT = "port"
    """Neither CLOSE nor silence ends a connection: the port is the client's until it hangs up."""

    RAYS = "rays"
    """A sonar is a single ray: what stands beside its middle is not there."""

    SHORT = "short"
    """Status packets end at the digital outputs, as those of P2OS do; ARCOS has more."""

    ODOMETRY = "odometry"
    """OPEN sets the odometry to zero."""


UNKIND = frozenset(Trap)
KIND: frozenset[Trap] = frozenset()
