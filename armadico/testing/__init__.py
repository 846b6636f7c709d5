"""Tools to test an agent alone, or in a small society under a virtual clock.

    alone = Alone(Careful(Identity("careful-1")))
    alone.give(drive_to((4.0, 0.0, 0.0)))      # a trajectory: m, m, rad
    alone.holding()                            # cycles until it holds the wheels
    alone.cycle(points=[Point(0.3, 0.0)])      # an obstacle 0.3 m ahead of the axle
    assert alone.commanded[0] < 0.1            # m/s

No process, no network and no waiting: messages and the time go in, messages come out.

The contracts of plug-ins are base classes of tests (`armadico.testing.contract`).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

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

if TYPE_CHECKING:
    from armadico.testing.agents import AgentContract, ResourceContract
    from armadico.testing.robots import RobotContract
    from armadico.testing.worlds import WorldContract

__all__ = [
    "PIONEER",
    "AgentContract",
    "Alone",
    "Bidder",
    "ResourceContract",
    "ResourceOwner",
    "RobotContract",
    "RobotOwner",
    "Society",
    "WorldContract",
    "bidder",
    "claims",
    "commands",
    "covariance",
    "drive_to",
    "obstacles",
    "wall",
]

_CONTRACTS: Final = {
    "AgentContract": "agents",
    "ResourceContract": "agents",
    "RobotContract": "robots",
    "WorldContract": "worlds",
}


def __getattr__(name: str) -> Any:
    # They need a whole society, and some the bridge: imported when first used.
    if name not in _CONTRACTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_CONTRACTS[name]}"), name)
