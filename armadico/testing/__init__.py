"""What an agent is tested with: alone, or in a small society under a virtual clock.

    from armadico.testing import Alone, obstacles
    from armadico import Point

    def test_it_keeps_off_a_wall():
        alone = Alone(Wander(Identity("wander-1")))
        alone.holding()                              # cycles until it has the wheels
        alone.cycle(points=[Point(0.5, 0.0)])        # a wall 0.5 m ahead
        v, _ = alone.commanded
        assert v == 0.0

No process, no network and no waiting: messages and the time go in, messages come out.
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
