"""A guest that watches and stops: it joins a society, and stops it after half a metre.

In another terminal first: armadico run sc4
"""

from math import hypot

import armadico
from armadico import Pose, RobotState

with armadico.connect() as guest:
    print("here:", ", ".join(name for name, _ in guest.agents()))
    start = guest.latest(Pose, timeout=30.0)

    def away() -> float:
        here = guest.latest(Pose)
        return hypot(here.x - start.x, here.y - start.y)

    guest.wait_for(lambda: away() > 0.5, timeout=60.0)
    guest.stop()  # returns when the wheels rest; latched, whoever leaves
    print(f"stopped {away():.2f} m on, by", guest.latest(RobotState).stop.by)
    guest.resume()
