"""The contracts of plug-ins, as base classes of tests: `armadico.contracts.contract`.

    from armadico.contracts import RobotContract

A contract is imported when it is first used: each needs a whole society, and some the bridge.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from armadico.contracts.agents import AgentContract, ResourceContract
    from armadico.contracts.mechanisms import MechanismContract
    from armadico.contracts.robots import RobotContract
    from armadico.contracts.worlds import WorldContract

__all__ = [
    "AgentContract",
    "MechanismContract",
    "ResourceContract",
    "RobotContract",
    "WorldContract",
]

_MODULES: Final = {
    "AgentContract": "agents",
    "MechanismContract": "mechanisms",
    "ResourceContract": "agents",
    "RobotContract": "robots",
    "WorldContract": "worlds",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
