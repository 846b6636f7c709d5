"""Tools to test an agent alone, or in a small society under a virtual clock.

    alone = Alone(Careful(Identity("careful-1")))
    alone.give(drive_to((4.0, 0.0, 0.0)))      # a trajectory: m, m, rad
    alone.holding()                            # cycles until it holds the wheels
    alone.cycle(points=[Point(0.3, 0.0)])      # an obstacle 0.3 m ahead of the axle
    assert alone.commanded[0] < 0.1            # m/s

No process, no network and no waiting: messages and the time go in, messages come out.

The contracts of plug-ins are base classes of tests: `armadico.contracts`.
"""

from armadico.testing.alone import (
    PIONEER,
    Alone,
    claims,
    commands,
    covariance,
    drive_to,
    obstacles,
    wall,
)
from armadico.testing.society import Bidder, ResourceOwner, RobotOwner, Society, bidder

__all__ = [
    "PIONEER",
    "Alone",
    "Bidder",
    "ResourceOwner",
    "RobotOwner",
    "Society",
    "bidder",
    "claims",
    "commands",
    "covariance",
    "drive_to",
    "obstacles",
    "wall",
]
