"""The robot agent: sole owner of the controller's port (thesis 3.7.1).

It numbers the status packets, which makes the frames; obeys whoever's ballot is the largest, and
chooses nobody; echoes what it obeys; orders a stop after 300 ms without a valid command; latches
`robot/stop` from anyone; and keeps the controller's watchdog fed only while all of this works.
"""

from __future__ import annotations

from collections import Counter
from math import radians
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico import agent
from armadico.agent import ERROR, INFO, WARNING, DeviceAgent
from armadico.bridge.p2os.session import Event, LinkLost, Opened, Session, StatusEvent
from armadico.bridge.profile import RobotProfile
from armadico.config.loading import load_resource
from armadico.coordination import Owner, Verdict
from armadico.messages import (
    Claim,
    Command,
    Echo,
    Frame,
    Message,
    RobotState,
    Sonar,
    Stop,
)
from armadico.services import Service

STOP_AFTER_S = 0.3
"""Without a valid command for so long, a stop is ordered."""

PULSE_S = 0.5
"""How often the watchdog is fed when there is nothing else to say."""

REPORT_S = 2.0
"""Refusals are reported at most so often."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The port and the robot behind it."""

    port: Annotated[str, Meta(min_length=1)] = "tcp://127.0.0.1:8101"
    profile: str = "pioneer-2dx"
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # m/s, below the profile's own


class Robot(DeviceAgent):
    """The robot, as the society knows it."""

    name = "robot"
    hears: ClassVar[tuple[type[Message], ...]] = (Command, Claim, Stop)
    provides: ClassVar[tuple[type[Message], ...]] = (RobotState, Sonar)
    Parameters = Parameters
"""
