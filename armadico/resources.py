"""The resources agents share, each declared once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from armadico.messages import Ballot, Command, Cycle, Message, RobotState


@dataclass(frozen=True)
class Resource:
    """Something that one agent at a time may use.

    `parameters` names the numbers of an action, `scale` is the size of each that counts as big in
    an exchange (3.13), `neutral` the action that does nothing, `measured` what it does now by the
    robot's own word. A contender must exceed the
    holder's utility by more than `margin`; 0 is the thesis.
    """

    name: str
    parameters: tuple[str, ...]
    scale: tuple[float, ...]
    neutral: tuple[float, ...]
    command: Callable[[Cycle, Ballot, tuple[float, ...]], Message]
    measured: Callable[[RobotState], tuple[float, ...]]
    margin: float = 0.05


def _wheels(cycle: Cycle, ballot: Ballot, action: tuple[float, ...]) -> Command:
    return Command(cycle, ballot, action[0], action[1])


WHEELS = Resource(
    name="wheels",
    parameters=("v", "w"),
    scale=(0.75, 1.745),  # m/s and rad/s: the fast controller's and the profile's usual maxima
    neutral=(0.0, 0.0),
    command=_wheels,
    measured=lambda state: (state.v, state.w),
)
"""The robot's motion. The robot agent owns the port and obeys whoever holds this."""
