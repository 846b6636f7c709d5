"""The latch that stops the robot, as tools say it.

A stop is a state, not an edge: it is said again until the robot agent's own state shows it.
"""

from __future__ import annotations

from typing import Final

from armadico.client import Client
from armadico.messages import RobotState, Stop

AGAIN_S: Final = 0.1
"""How often the stop is said until it is echoed."""


def say(client: Client, *, stopped: bool, by: str, timeout: float) -> Stop | None:
    """Stop or release the robot; what the robot agent says then, None if it says nothing of it.

    The client listens to `RobotState` already.
    """

    def echoed() -> Stop | None:
        state = client.latest(RobotState)
        return state.stop if state is not None and state.stop.stopped == stopped else None

    counter = 0
    for _ in range(max(1, round(timeout / AGAIN_S))):
        newest = client.latest(RobotState)
        if newest is not None:
            counter = max(counter, newest.stop.counter)
        client.publish(Stop(counter + 1, stopped, by))
        done = client.wait_for(echoed, AGAIN_S)
        if done is not None:
            return done
    return None
