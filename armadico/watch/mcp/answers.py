"""Answers of the MCP tools that only read: the state of a society as objects for JSON (sans-IO)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from math import ceil, cos, degrees, hypot, pi, sin
from typing import Final

import msgspec

from armadico.config.worlds import Segment, World
from armadico.core.messages import Message
from armadico.core.resources import WHEELS
from armadico.mobile.obstacles import Obstacles
from armadico.observe import described
from armadico.observe.described import rounded
from armadico.observe.findings import NOTHING, Demand
from armadico.observe.jsons import JsonObject
from armadico.watch.assistant.messages import AssistantRecord
from armadico.watch.explained import Collision, Exchange, Press
from armadico.watch.why import Chronicle

RECORDS: Final = 200  # requests of programs kept for the history

LARGEST_PICTURE: Final = (72, 36)  # columns, rows

FINEST_M: Final = 0.2  # the smallest side of a picture's cell

# Without a world the picture shows this distance around the robot.
AROUND_M: Final = 5.0

# The fields of an agent's card that are shown.
CARD: Final = ("host", "provides", "owns", "resources", "holds")

ARROWS: Final = ">^<v"

LEGEND: Final = "# wall, o something that was sensed, > ^ < v the robot, G its goal; x right, y up"


class Society(Chronicle):
    """The received state of a society, with the answer of each tool that only reads."""

    def __init__(
        self,
        world: World | None,
        missions: Mapping[str, str],
        demand: Demand = NOTHING,
        begun: float = 0.0,
    ) -> None:
        """Begin without any messages.

        Args:
            world: The world of the robot, or None if unknown.
            missions: Titles of the missions that can be ordered, by name.
            demand: What the society should be.
            begun: See `Chronicle`.
        """
        super().__init__(demand=demand, begun=begun)
        self._world = world
        self._missions = missions
        self._requests: deque[tuple[float, AssistantRecord]] = deque(maxlen=RECORDS)

    def update(self, key: str, message: Message | None, t: float) -> None:
        super().update(key, message, t)
        if isinstance(message, AssistantRecord):
            self._requests.append((t, message))

    def where(self, now: float) -> JsonObject:
        """Return the robot's state, pose, mission and driver; null if it was not received.

        If `connected` is false, the rest is the last report.
        """
        view = self.view
        found: JsonObject = rounded(
            {
                "connected": view.state_is_fresh(now),
                "robot": described.robot(view),
                "pose": described.pose(view, now),
                "mission": described.mission(view),
                "wheels": described.resource(view, WHEELS.name, now),
            }
        )
        return found

    def map(self) -> JsonObject:
        """Return the named places and a picture of the known world."""
        world, pose = self._world, self.view.pose
        found: JsonObject = {}
        if world is not None:
            rooms = {
                room.name: [round((room.x1 + room.x2) / 2, 2), round((room.y1 + room.y2) / 2, 2)]
                for room in world.rooms
            }
            goals = {
                name: [round(x, 2), round(y, 2), round(degrees(theta), 1)]
                for name, (x, y, theta) in (world.goals | world.docks).items()
            }
            found |= {"world": world.name, "rooms": rooms, "goals": goals}
            bounds = world.bounds
        elif pose is not None:
            around = AROUND_M
            bounds = (pose.x - around, pose.y - around, pose.x + around, pose.y + around)
            found["note"] = "no world was named to this server (--world): only what is sensed"
        else:
            return {
                "note": "no world was named to this server, and no pose of a robot was received"
            }
        rows, cell = self._picture(bounds)
        return found | {
            "bounds": [round(each, 2) for each in bounds],
            "picture": rows,
            "legend": f"{LEGEND}; a letter is {cell:.2f} m, the last row is y {bounds[1]:.1f}",
        }

    def who(self) -> JsonObject:
        """Return the agents that are alive."""
        return {"agents": [described.agent(seen, *CARD) for seen in self.view.agents]}

    def missions(self) -> JsonObject:
        """Return the missions that can be ordered and those on the board."""
        return {
            "available": [{"name": name, "title": what} for name, what in self._missions.items()],
            "board": [described.errand(each) for each in self.view.missions],
        }

    def why(self, now: float) -> JsonObject:
        """Return why the robot stands now, and what else is wrong or not known."""
        return described.diagnosis(self.view, now, self.demand)

    def moment(self) -> JsonObject:
        """Return the moment marked last: the holders, and what the other agents would do."""
        if not self.moments:
            return {"note": "nothing is known of this moment"}
        found: JsonObject = msgspec.to_builtins(self.moments[-1])
        return found

    def history(self, now: float, last: int) -> JsonObject:
        """Return the last events since the start, newest last; `ago` is in s."""
        events = sorted(self._events(), key=lambda event: event[0])[-last:]
        return {"events": [{"ago": round(now - t, 1), "what": what} for t, what in events]}

    def _events(self) -> Iterator[tuple[float, str]]:
        explained: list[Exchange | Press | Collision]
        explained = [*self.exchanges, *self.presses, *self.collisions]
        for event in explained:
            yield self._begun + event.t, " ".join(event.sentences)
        for logged in self.view.logs:
            yield logged.at, f"{logged.instance}: {logged.log.text}"
        for t, record in self._requests:
            request, reply = record.request, record.reply
            more = f"; {record.left_out} more before it were too many" if record.left_out else ""
            came = f"refused, {reply.refusal}" if reply.refusal else reply.text or "answered"
            yield (
                t,
                f"{request.by or 'a program'} asked: {request.tool} {request.text}: {came}{more}",
            )

    # The picture ---------------------------------------------------------------------------------

    def _picture(self, bounds: Segment) -> tuple[list[str], float]:
        """Return rows of letters, top row first, and the side of a cell, m."""
        x1, y1, x2, y2 = bounds
        across, down = LARGEST_PICTURE
        cell = max((x2 - x1) / across, (y2 - y1) / down, FINEST_M)
        columns, rows = ceil((x2 - x1) / cell) + 1, ceil((y2 - y1) / cell) + 1
        letters = [[" "] * columns for _ in range(rows)]

        def put(x: float, y: float, letter: str) -> None:
            column, row = round((x - x1) / cell), rows - 1 - round((y - y1) / cell)
            if 0 <= column < columns and 0 <= row < rows:
                letters[row][column] = letter

        for wall in () if self._world is None else self._world.barriers:
            for x, y in _along(wall, cell / 2):
                put(x, y, "#")
        pose, view = self.view.pose, self.view
        if pose is not None:
            c, s = cos(pose.theta), sin(pose.theta)
            for message in view.newest.values():
                if isinstance(message, Obstacles):
                    for p in message.points:
                        put(pose.x + c * p.x - s * p.y, pose.y + s * p.x + c * p.y, "o")
        if view.trajectory is not None and view.trajectory.waypoints:
            goal = view.trajectory.waypoints[-1]
            put(goal.x, goal.y, "G")
        if pose is not None:
            put(pose.x, pose.y, ARROWS[round(pose.theta / (pi / 2)) % 4])
        return ["".join(row).rstrip() for row in letters], cell


def _along(wall: Segment, step: float) -> Iterator[tuple[float, float]]:
    """Yield points of a wall at most `step` m apart."""
    x1, y1, x2, y2 = wall
    count = max(ceil(hypot(x2 - x1, y2 - y1) / step), 1)
    for at in range(count + 1):
        share = at / count
        yield x1 + share * (x2 - x1), y1 + share * (y2 - y1)
