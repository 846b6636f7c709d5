"""Robots as their owners describe them, for tests of agents that are handed messages by hand."""

from __future__ import annotations

import atexit
import shutil
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from armadico.bridge.robot import Parameters, Robot
from armadico.config.shipped import find
from armadico.core.agent import Identity
from armadico.core.messages import Description
from armadico.mobile.motion import Body

LASER = """
[laser]
x_m = 0.12
y_m = 0.0
bearing_deg = 0.0
min_m = 0.1
max_m = 30.0
angle_min_deg = -135.0
angle_max_deg = 135.0
rays = 720
rate_hz = 40.0
noise_m = 0.01
"""


@cache
def with_laser() -> str:
    """Return the file of a profile: a Pioneer with a laser."""
    folder = mkdtemp(prefix="armadico-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    file = Path(folder, "pioneer-laser.toml")
    file.write_text(find("robots", "pioneer-2dx").read_text() + LASER)
    return str(file)


@cache
def described(profile: str = "pioneer-2dx") -> Description:
    """Return the description of a robot with this profile."""
    return Robot(Identity("robot-1"), Parameters(port="memory:", profile=profile)).description()


@cache
def body(profile: str = "pioneer-2dx") -> Body:
    """The same as the behaviours have it."""
    return Body.of(described(profile))
