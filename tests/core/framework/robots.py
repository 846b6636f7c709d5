"""Robots as their owners describe them, for tests of agents that are handed messages by hand."""

from __future__ import annotations

from functools import cache

from armadico.bridge.robot import Parameters, Robot
from armadico.core.agent import Identity
from armadico.core.messages import Description
from armadico.mobile.motion import Body


@cache
def described(profile: str = "pioneer-2dx") -> Description:
    """Return the description of a robot with this profile."""
    return Robot(Identity("robot-1"), Parameters(port="memory:", profile=profile)).description()


@cache
def body(profile: str = "pioneer-2dx") -> Body:
    """The same as the behaviours have it."""
    return Body.of(described(profile))
