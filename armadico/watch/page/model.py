"""One robot on the page (sans-IO).

Inputs are messages, tokens, requests and the time. `parts` returns the data to show, `drain` the
publications, queries and answers. The page makes no decisions: a goal is a mission, as from any
other client.
"""

from __future__ import annotations

from base64 import b64encode
from collections import deque
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from functools import cache
from typing import Final, Never, cast

from armadico.config.map_graphs import graph_of
from armadico.config.named import Gazetteer
from armadico.config.worlds import Unseen, World
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import PAGE
from armadico.core.installed import loaded
from armadico.core.membership import agent_of
from armadico.core.messages import Message
from armadico.core.resources import WHEELS
from armadico.core.services import QUIET_S
from armadico.mobile.messages import MapGraph, OccupancyGrid, Pose
from armadico.mobile.obstacles import Obstacles
from armadico.observe import described
from armadico.observe.described import rounded
from armadico.observe.findings import NOTHING, Demand
from armadico.observe.jsons import Json, JsonObject
from armadico.observe.page_part import Desk, Out, Part
from armadico.observe.page_requests import Asked, Reader, Start
from armadico.observe.view import View
from armadico.watch.page.own import Goals, Parameters, Starting, StopLatch
from armadico.watch.pictures import colour

# Largest numbers shown:
EXCHANGES: Final = 30
LINES: Final = 40  # of the log
POINTS: Final = 300  # of one sensor
TRAIL: Final = 3000  # points of the driven path
TRAIL_M: Final = 0.04  # distance between two of them


@cache
def capabilities() -> tuple[type[Part], ...]:
    """The parts that installed capabilities add."""
    return tuple(part for _, part in loaded(PAGE, Part))


def reader() -> Reader:
    """Reads the requests of the page and of all capabilities."""
    kinds: tuple[type[Part], ...] = (Goals, StopLatch, Parameters, *capabilities())
    return Reader([Start, *(request for kind in kinds for request in kind.requests)])


class Robot:
    def __init__(
        self,
        namespace: str,
        world: World | None = None,
        bits64: Callable[[], int] = lambda: 1,
        helpers: Collection[str] = (),
        demand: Demand = NOTHING,
        gazetteer: Gazetteer | None = None,
    ) -> None:
        """Start without messages.

        `bits64` returns the random number of a stop. `helpers` are agents that can be started
        beside the page if no host can start them. The gazetteer has the places that the page offers
        by name.
        """
        self.namespace = namespace
        self.view = View()
        self.world = world
        self._gazetteer = gazetteer
        self._desk = Desk(self.view, bits64)
        added = [kind(self._desk) for kind in capabilities()]
        own = (Goals(self._desk), StopLatch(self._desk), Parameters(self._desk))
        self._parts: tuple[Part, ...] = (*own, Starting(self._desk, helpers, added), *added)
        self._handlers = {kind: part for part in self._parts for kind in part.requests}
        self._demand = demand
        self._near: dict[str, tuple[list[list[float]], float]] = {}
        self._grid: JsonObject | None = None
        self._graph: JsonObject | None = None
        self._trail: deque[list[Json]] = deque(maxlen=TRAIL)

    # Input ---------------------------------------------------------------------------------------

    def receive(
        self, key: str, message: Message | None, t: float, *, is_reply: bool = False
    ) -> None:
        """Process a publication or a reply, at t (s); None cannot be decoded."""
        if not is_reply:
            self.view.update(key, message, t)
        elif message is not None:
            self.view.learn(message, t)
        match message:
            case None:
                return
            case Pose():
                self._step(message, t)
            case Obstacles():
                self._near = {s: near for s, near in self._near.items() if t - near[1] <= QUIET_S}
                self._near[message.sensor] = (_points(message), t)
            case OccupancyGrid():
                self._grid = _cells(message, message.cell, revision=message.revision)
            case MapGraph():
                self._graph = _graph(message)
        for part in self._parts:
            part.receive(key, message, t)

    def router(self, *, there: bool, t: float) -> None:
        self.view.router(there=there, t=t)

    def token(self, instance: str, *, there: bool, t: float) -> None:
        self.view.token(instance, there=there, t=t)
        for part in self._parts:
            part.on_token(instance, there=there)

    def request(self, browser: str, request: Asked, t: float) -> None:
        """Handle a browser's request. Raises RequestError."""
        self._handlers[type(request)].request(browser, cast("Never", request), t)

    def on_reply(self, number: int, reply: Message | None) -> None:
        """Process a query's reply; None is a timeout."""
        self._desk.on_reply(number, reply)

    def leave(self, browser: str) -> None:
        for part in self._parts:
            part.on_leave(browser)

    def wake(self, t: float) -> None:
        for part in self._parts:
            part.wake(t)

    # Output --------------------------------------------------------------------------------------

    def drain(self) -> list[Out]:
        """The publications, queries and answers since the last call, in order."""
        return self._desk.drain()

    def parts(self, t: float) -> dict[str, object]:
        """All data to show at t (s), in parts that change at different rates."""
        view = self.view
        parts: dict[str, object] = {
            "body": self._body(),
            "motion": self._motion(t),
            "mission": self._mission(t),
            "wheels": self._wheels(t),
            "resources": [
                described.resource(view, name, t) for name in view.resources if name != WHEELS.name
            ],
            "exchanges": self._exchanges(),
            "agents": self._agents(),
            "near": [p for points, at in self._near.values() if t - at <= QUIET_S for p in points],
            "grid": self._grid,
            "graph": self._graph,
            "slam": described.slam(view, t),
            "log": self._log(),
            "standing": self.standing(t),
        }
        for part in self._parts:
            part.show(parts, t)
        return parts

    @property
    def trail(self) -> list[list[Json]]:
        """The path driven so far, for a browser that connects: x, y, and the driving agent."""
        return list(self._trail)

    @property
    def fixed(self) -> JsonObject:
        """The data that do not change while a browser is connected."""
        found: JsonObject = {"world": None if self.world is None else drawn(self.world)}
        found["places"] = []
        with suppress(ConfigError):  # a damaged file of places: `armadico places` names the line
            found["places"] = [
                [place.name, place.x, place.y, place.heading]
                for place in (() if self._gazetteer is None else self._gazetteer.places)
            ]
        for part in self._parts:
            found |= part.fixed
        return found

    def standing(self, t: float) -> JsonObject:
        """Why the robot stands, and what else is wrong or not known."""
        return described.diagnosis(self.view, t, self._demand)

    def _body(self) -> JsonObject | None:
        body = self.view.description
        if body is None:
            return None
        shown = ("front", "rear", "half_width", "v_max", "w_max")
        return {"name": body.robot} | {name: getattr(body, name) for name in shown}

    def _motion(self, t: float) -> JsonObject:
        view, truth = self.view, self.view.truth
        found: JsonObject = {
            "connected": view.state_is_fresh(t),
            "silent_s": None if view.state_at is None else round(t - view.state_at, 1),
        }
        found |= rounded((described.robot(view) or {}) | (described.pose(view, t) or {}))
        if view.pose is not None and view.pose.covariance:
            xx, xy, _, yy, _, _ = view.pose.covariance
            found["covariance"] = rounded([xx, xy, yy], 5)
        if truth is not None:
            found["truth"] = rounded([truth.x, truth.y, truth.theta])
        return found

    def _mission(self, t: float) -> JsonObject:
        trajectory = self.view.trajectory
        found: JsonObject = {"tasks": self.view.tasks}
        found |= rounded(described.mission(self.view, t) or {}, 2)
        if trajectory is not None:
            way = [[w.x, w.y, w.theta] for w in trajectory.waypoints]
            found |= {"way": rounded(way), "leg": trajectory.leg, "waits": trajectory.waits}
            found |= {"start": rounded([trajectory.start.x, trajectory.start.y])}
            found["unseen"] = rounded([[s.x1, s.y1, s.x2, s.y2] for s in trajectory.unseen])
        return found

    def _wheels(self, t: float) -> JsonObject:
        found = described.resource(self.view, WHEELS.name, t)
        for each in found["contenders"]:
            each["colour"] = colour(each["name"])
        return found

    def _agents(self) -> list[Mapping[str, Json]]:
        return [
            {"pid": 0}
            | described.agent(seen, "host", "pid", "version")
            | {"instance": seen.instance[-8:], "colour": colour(seen.name)}
            | {"alive": True, "kept": False}
            for seen in self.view.agents
        ]

    def _log(self) -> list[JsonObject]:
        lines = list(self.view.logs)[-LINES:]
        return [
            {
                "t": round(line.at, 1),
                "name": agent_of(line.instance),
                "level": line.log.level,
                "text": line.log.text,
            }
            for line in lines
        ]

    def _exchanges(self) -> list[JsonObject]:
        rows = []
        for each in self.view.exchanges:
            if each.resource == WHEELS.name:
                row: JsonObject = {"t": round(each.at, 2)}
                row |= {"from": _name(each.before), "to": _name(each.now)}
                if each.claim is not None:
                    row |= {"utility": each.claim.utility, "critical": each.claim.critical}
                rows.append(row)
        return rows[-EXCHANGES:]

    def _step(self, pose: Pose, t: float) -> None:
        x, y = rounded([pose.x, pose.y])
        name = _name(self.view.driver(WHEELS.name, t))
        if self._trail:
            last = self._trail[-1]
            if abs(x - last[0]) + abs(y - last[1]) < TRAIL_M:
                return
        self._trail.append([x, y, name])


def drawn(world: World) -> JsonObject:
    unseen = world.unseen
    return {
        "bounds": rounded(world.bounds),
        "walls": rounded(world.walls),
        "columns": rounded(world.columns),
        "forbidden": rounded(world.forbidden),
        "unseen": unseen and _cells(unseen, unseen.cell_m, theta=unseen.theta),
        "rooms": [[room.name, room.x1, room.y1, room.x2, room.y2] for room in world.rooms],
        "docks": {name: list(pose) for name, pose in world.docks.items()},
    }


def _cells(of: Unseen | OccupancyGrid, cell_m: float, **more: Json) -> JsonObject:
    """Cells, which the browser inflates."""
    found: JsonObject = {name: getattr(of, name) for name in ("x", "y", "rows", "columns")}
    return found | {"cell": cell_m, "packed": b64encode(of.packed).decode()} | more


def _name(instance: str | None) -> str | None:
    return None if instance is None else agent_of(instance)


def _points(obstacles: Obstacles) -> list[list[float]]:
    every = -(-len(obstacles.points) // POINTS) or 1
    return [[round(p.x, 3), round(p.y, 3)] for p in obstacles.points[::every]]


def _graph(message: MapGraph) -> JsonObject | None:
    try:
        graph = graph_of(message)
    except ValueError:  # a malformed graph is not drawn
        return None
    return {
        "revision": message.revision,
        "places": graph.places.round(2).tolist(),
        "loops": graph.loops.tolist(),
        "off": graph.off.tolist(),
    }
