"""The robot's condition and the driving agent, as ROS 2 diagnostics and battery state."""

from __future__ import annotations

import math
from typing import Final, TypeVar

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.geometry import stamp_of
from armadico.core import messages as m
from armadico.core.membership import agent_of
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.messages import BatteryLevel, MapGraph, MissionStatus, Pose
from armadico.observe.view import driver

# Interval of battery state and diagnostics; a change of the driving agent is published immediately.
EACH_S: Final = 1.0

MOST: Final = 64  # resources whose acks are used; those of others are discarded
OK, WARN, ERROR = 0, 1, 2  # levels of diagnostic_msgs/DiagnosticStatus

_M = TypeVar("_M", bound=m.Message)


class Health:
    """The state of one robot."""

    def __init__(self, prefix: str) -> None:
        """`prefix` begins the names of statuses: the namespace and a slash, or nothing."""
        self.newest: dict[type[m.Message], m.Message] = {}  # the newest message of each kind
        self._prefix = prefix
        self._acks: dict[str, m.Ack] = {}
        self._battery_at = self._due_at = 0  # ns: not before then

    def known(self, kind: type[_M]) -> _M | None:
        """The newest message of a kind; None if there was none."""
        message = self.newest.get(kind)
        return message if isinstance(message, kind) else None

    def on_ack(self, ack: m.Ack) -> None:
        """Process an ack; if the driving agent has changed, the diagnostics are due."""
        before = self._acks.get(ack.resource)
        if before is None and len(self._acks) >= MOST:
            return
        self._acks[ack.resource] = ack
        if before is None or driver(before) != driver(ack):
            self._due_at = 0

    def battery(
        self, state: m.RobotState, header: types.Header, at: int
    ) -> types.BatteryState | None:
        """The battery state at a time (ns), if it is due."""
        if at < self._battery_at:
            return None
        self._battery_at = at + int(EACH_S * 1e9)
        level = self.known(BatteryLevel)
        share = math.nan if level is None else level.share
        return types.BatteryState(
            header,
            voltage=state.battery_v,
            temperature=math.nan,
            current=math.nan,
            charge=math.nan,
            capacity=math.nan,
            design_capacity=math.nan,
            percentage=share,
            power_supply_status=types.CHARGING if state.charging else types.DISCHARGING,
            present=True,
        )

    def diagnostics(self, at: int) -> types.DiagnosticArray | None:
        """The diagnostics at a time (ns), if they are due."""
        state = self.known(m.RobotState)
        if at < self._due_at or (state is None and not self._acks):
            return None
        self._due_at = at + int(EACH_S * 1e9)
        known = [self._holder(ack) for _, ack in sorted(self._acks.items())]
        if state is not None:
            known.append(self._robot(state))
        if (graph := self.known(MapGraph)) is not None:
            wrong = f"the map may be wrong: {graph.uncertain}"
            level, text = (WARN, wrong) if graph.uncertain else (OK, "ok")
            known.append(self._status(level, "map", text, {"map": graph.summary}))
        return types.DiagnosticArray(types.Header(stamp_of(at)), known)

    def _holder(self, ack: m.Ack) -> types.DiagnosticStatus:
        holder = driver(ack)
        ballot = ack.obeyed if holder is not None else None
        values = {
            "holder": holder or "",
            "utility": f"{ack.utility:.3f}" if holder else "",
            "critical": str(ack.critical).lower(),
            "term": "" if ballot is None else str(ballot.term),
            "cycle": str(ack.cycle.number),
        }
        name = "no agent" if holder is None else agent_of(holder)
        return self._status(OK, f"{ack.resource} holder", name, values)

    def _robot(self, state: m.RobotState) -> types.DiagnosticStatus:
        values = {
            "v": f"{state.v:.3f}",
            "w": f"{state.w:.3f}",
            "motors": str(state.motors).lower(),
            "battery": f"{state.battery_v:.1f}",
        }
        if (mission := self.known(MissionStatus)) is not None:
            values["mission"] = mission.state.value
            values["mission note"] = mission.note
        level, text = OK, "ok"
        if state.stalled:
            level, text = WARN, "stalled"
        if state.stop.stopped:
            level, text = WARN, f"stopped by {state.stop.requester}"
        pose = self.known(Pose)
        if pose is not None and pose.deviation > LOST_M:
            level, text = ERROR, f"lost: the deviation of the pose is {pose.deviation:.1f} m"
        return self._status(level, "robot", text, values)

    def _status(
        self, level: int, what: str, text: str, values: dict[str, str]
    ) -> types.DiagnosticStatus:
        pairs = [types.KeyValue(name, value) for name, value in values.items()]
        description = self.known(m.Description)
        robot = "" if description is None else description.robot
        return types.DiagnosticStatus(level, self._prefix + what, text, robot, pairs)
