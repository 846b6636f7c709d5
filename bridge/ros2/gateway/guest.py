"""What the gateway does on the mesh: it reads what it translates, and requests goals."""

from __future__ import annotations

from typing import ClassVar

from armadico.bridge.ros2.gateway.society import Society
from armadico.core.guest import Guest
from armadico.core.messages import Message, RobotState
from armadico.mobile.messages import MissionRequest, MissionStatus


class Gateway(Guest):
    """ROS 2 nodes' way to a society: any of them may send the robot to a goal."""

    receives: ClassVar[tuple[type[Message], ...]] = (*Society().kinds, MissionStatus, RobotState)
    queries: ClassVar[tuple[type[Message], ...]] = (MissionRequest,)
