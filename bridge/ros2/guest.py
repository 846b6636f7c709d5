"""What the gateway does on the mesh: it reads what it translates, and requests goals.

`gateway/society.py` subscribes to this list. This module imports no ROS 2, because keys are also
made on computers without it.
"""

from __future__ import annotations

from typing import ClassVar

from armadico.core.guest import Guest
from armadico.core.messages import Ack, Description, Message, RobotState
from armadico.mobile.messages import (
    BatteryLevel,
    LocalMap,
    MapGraph,
    MissionRequest,
    MissionStatus,
    OccupancyGrid,
    Pose,
    Scan,
    Sonar,
    Trajectory,
)
from armadico.mobile.obstacles import Obstacles


class Gateway(Guest):
    """ROS 2 nodes' way to a society: any of them may send the robot to a goal."""

    receives: ClassVar[tuple[type[Message], ...]] = (
        *(RobotState, Description, Ack, Sonar, Scan, Pose, Obstacles, LocalMap, OccupancyGrid),
        *(MapGraph, Trajectory, BatteryLevel, MissionStatus),
    )
    queries: ClassVar[tuple[type[Message], ...]] = (MissionRequest,)
