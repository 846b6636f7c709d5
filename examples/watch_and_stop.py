"""A client that joins a society and stops the robot after half a metre.

First, in another terminal: armadico run sc4
"""

import sys
from math import hypot

import armadico
from armadico import Pose, RobotState

with armadico.connect() as guest:
    print("here:", ", ".join(name for name, _ in guest.agents()))
    start = guest.latest(Pose, timeout=5.0)
    if start is None:
        sys.exit("no pose is published; first, in another terminal: armadico run sc4")

    def away() -> float:
        here = guest.latest(Pose)
        return hypot(here.x - start.x, here.y - start.y)

    guest.wait_for(lambda: away() > 0.5, timeout=60.0)
    guest.stop()  # returns when the wheels rest; the stop is latched
    print(f"stopped after {away():.2f} m, by", guest.latest(RobotState).stop.by)
    guest.resume()
