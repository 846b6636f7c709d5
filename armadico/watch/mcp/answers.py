"""Answers of the MCP tools that only read: the state of a society as objects for JSON.

Of files, the one of added places alone is read, whenever places are asked for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from math import ceil, degrees, hypot, pi
from typing import Final

import msgspec

from armadico.config.named import Gazetteer
from armadico.config.worlds import Segment
from armadico.core.messages import Message
from armadico.core.resources import WHEELS
from armadico.mobile.geometry import to_world
from armadico.mobile.messages import MissionStatus
from armadico.mobile.obstacles import Obstacles
from armadico.observe import described
from armadico.observe.described import rounded
from armadico.observe.findings import NOTHING, Demand
from armadico.observe.jsons import Json, JsonObject
from armadico.watch.assistant.messages import AssistantRecord
from armadico.watch.assistant.policy.messages import Approvals
from armadico.watch.explained import Collision, Exchange, Press
from armadico.watch.mcp.picture import drawn
from armadico.watch.why import Chronicle

RECORDS: Final = 200  # requests of programs kept for the history

LARGEST_PICTURE: Final = (72, 36)  # columns, rows

FINEST_M: Final = 0.2  # the smallest side of a picture's cell

# Without a world the picture shows this distance around the robot.
AROUND_M: Final = 5.0

# The fields of an agent's card that are shown.
CARD: Final = ("host", "provides", "owns", "resources", "holds")

NO_WORLD: Final = "no world was named to this server (--world): only what is sensed is known"

ARROWS: Final = ">^<v"

LEGEND: Final = "# wall, o something that was sensed, > ^ < v the robot, G its goal; x right, y up"


class Society(Chronicle):
    """The received state of a society, with the answer of each tool that only reads."""

    def __init__(
        self,
        gazetteer: Gazetteer | None,
        missions: Mapping[str, str],
        demand: Demand = NOTHING,
        begun: float = 0.0,
    ) -> None:
        """Begin without any messages.

        `missions` are the titles, by name, of those that can be ordered.
        """
        super().__init__(demand=demand, begun=begun)
        self.gazetteer = gazetteer
        self._world = None if gazetteer is None else gazetteer.world
        self._missions = missions
        self._requests: deque[tuple[float, AssistantRecord]] = deque(maxlen=RECORDS)
        self.policy = ""  # the last one that an assistant agent has published
        self.status_at = float("-inf")  # s; when the interface agent last reported

    def update(self, key: str, message: Message | None, t: float) -> None:
        super().update(key, message, t)
        if isinstance(message, AssistantRecord):
            self._requests.append((t, message))
        elif isinstance(message, Approvals):
            self.policy = message.policy or self.policy
        elif isinstance(message, MissionStatus):
            self.status_at = t

    def orderer(self, mission: int) -> str:
        """Return the program that ordered a goal; empty if no known request led to it."""
        found = (r.request.by for _, r in self._requests if r.reply.mission == mission)
        return next(found, "")

    def where(self, now: float) -> JsonObject:
        """Return the robot's state, pose, mission and driver; null if it was not received.

        If `connected` is false, the rest is the last report.
        """
        view = self.view
        pose, world = view.pose, self._world
        room = None if pose is None or world is None else world.room_at(pose.x, pose.y)
        found: JsonObject = rounded(
            {
                "room": None if room is None else room.name,
                "connected": view.state_is_fresh(now),
                "robot": described.robot(view),
                "pose": described.pose(view, now),
                "mission": described.mission(view, now),
                "wheels": described.resource(view, WHEELS.name, now),
            }
        )
        return found

    def map(self) -> JsonObject:
        """Return the size of the known world and a picture of it in letters."""
        world, pose = self._world, self.view.pose
        found: JsonObject = {}
        if world is not None:
            found |= {"world": world.name}
            bounds = world.bounds
        elif pose is not None:
            around = AROUND_M
            bounds = (pose.x - around, pose.y - around, pose.x + around, pose.y + around)
            found["note"] = NO_WORLD
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

    def places(self) -> JsonObject:
        """Return the places that have names; poses in m and degrees."""
        if self.gazetteer is None:
            return {"places": [], "note": NO_WORLD}
        found = []
        for place in self.gazetteer.places:
            turned = {} if place.heading is None else {"heading": round(degrees(place.heading), 1)}
            at = {"x": round(place.x, 2), "y": round(place.y, 2)} | turned
            found.append({"name": place.name, "sort": place.sort.value} | at)
        return {"places": found}

    def picture(self) -> bytes:
        """Return the map as PNG. Raises ConfigError if the file of added places is invalid."""
        world, view, pose = self._world, self.view, self.view.pose
        x, y = (0.0, 0.0) if pose is None else (pose.x, pose.y)
        around = (x - AROUND_M, y - AROUND_M, x + AROUND_M, y + AROUND_M)
        path = view.trajectory
        way = () if path is None else path.waypoints[path.leg :]
        about = view.description
        radius = 0.2 if about is None else about.half_width
        return drawn(
            around if world is None else world.bounds,
            world,
            () if self.gazetteer is None else self.gazetteer.places,
            self._sensed(),
            ((x, y), *((at.x, at.y) for at in way)) if way and pose is not None else (),
            None if pose is None else (pose.x, pose.y, pose.theta, radius),
        )

    def _sensed(self) -> Iterator[tuple[float, float]]:
        """Yield the points that sensors report now, m in the world."""
        pose = self.view.pose
        if pose is None:
            return
        for message in self.view.newest.values():
            if isinstance(message, Obstacles):
                for p in message.points:
                    yield to_world((pose.x, pose.y, pose.theta), p.x, p.y)

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
        """Return the last events since the start, newest last; `ago` is in s.

        `unknown` has the kinds of events of which some may not be known, and why.
        """
        events = sorted(self._events(), key=lambda event: event[0])[-last:]
        found: list[Json] = [{"ago": round(now - t, 1), "what": what} for t, what in events]
        return {"events": found, "unknown": self.unknown}

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
                f"{request.asker} asked: {request.tool} {request.text}: {came}{more}",
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
        for x, y in self._sensed():
            put(x, y, "o")
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
