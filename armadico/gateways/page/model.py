"""One robot as the page shows it (sans-IO).

Messages, tokens and the time go in, `parts` is what is to be shown; what people ask of it there is
in `asked`.
"""

from __future__ import annotations

from base64 import b64encode
from collections import deque
from collections.abc import Callable, Collection, Mapping
from math import isfinite
from typing import Any, Final

from armadico.agents.supervision.messages import HostShare
from armadico.agents.teleop.messages import Stick, TeleopStatus
from armadico.config.worlds import World
from armadico.core.messages import Message, ParameterChange, ParametersReply, RobotState
from armadico.core.resources import WHEELS
from armadico.core.services import QUIET_S, service_of
from armadico.gateways.page.asked import Asked, Shipped
from armadico.gateways.page.known import Known
from armadico.mobile.errand import Progress
from armadico.mobile.messages import OccupancyGrid, Pose
from armadico.mobile.obstacles import Obstacles
from armadico.observe.pictures import colour
from armadico.observe.standing import NO_TABLE, Hosts, Installed, standing
from armadico.observe.view import View, agent_of

EXCHANGES: Final = 30
LINES: Final = 40
POINTS: Final = 300
TRAIL: Final = 3000
TRAIL_M: Final = 0.04
"""What is shown at the most: exchanges, lines of the log, points that are near, and points of the
path, so far apart."""


class Robot:
    def __init__(
        self,
        namespace: str,
        world: World | None = None,
        missions: Mapping[str, Shipped] | None = None,
        bits64: Callable[[], int] = lambda: 1,
        helpers: Collection[str] = (),
        installed: Installed = lambda _: (),
        hosts: Hosts = NO_TABLE,
    ) -> None:
        """Nothing is known yet.

        Args:
            namespace: The robot's.
            world: Whose walls are shown.
            missions: Those that can be ordered, by name.
            bits64: Draws the number that tells one stop from another.
            helpers: Agents that can be started beside the page, where no host would.
            installed: As `standing` takes it.
            hosts: As `standing` takes it.
        """
        self.namespace = namespace
        self.known = Known(helpers)
        self.asked = Asked(self.known, missions or {}, bits64)
        self.world = world
        self.missions = missions or {}
        self._installed, self._hosts = installed, hosts
        self._near: dict[str, tuple[list[list[float]], float]] = {}
        self._grid: dict[str, Any] | None = None
        self._trail: deque[list[Any]] = deque(maxlen=TRAIL)

    # What comes in -------------------------------------------------------------------------------

    def heard(self, key: str, message: Message | None, t: float, *, asked: bool = False) -> None:
        """Take what was published on a key, or an answer to what everybody was `asked`, at t (s).

        None: it cannot be read.
        """
        if not asked:
            self.view.take(key, message, t)
        elif message is not None:
            self.view.learn(message, t)
        match message:
            case RobotState():
                self.asked.heard(message, t)
            case Pose():
                self._step(message, t)
            case Obstacles():
                self._near = {s: near for s, near in self._near.items() if t - near[1] <= QUIET_S}
                self._near[message.sensor] = (_points(message), t)
            case OccupancyGrid():
                self._grid = _grid(message)
            case HostShare() | ParametersReply() | ParameterChange():
                self.known.take(key, message, t)

    def router(self, *, there: bool, t: float) -> None:
        """The robot's router can be reached, or cannot."""
        self.view.router(there=there, t=t)

    def token(self, instance: str, *, there: bool, t: float) -> None:
        """A liveliness token came or went."""
        self.known.token(instance, there=there, t=t)

    @property
    def view(self) -> View:
        return self.known.view

    # What is shown -------------------------------------------------------------------------------

    def parts(self, t: float) -> dict[str, Any]:
        """All that is shown at t (s), by parts that change each at their own pace."""
        return {
            "body": self._body(),
            "motion": self._motion(t),
            "stop": self._latch(t),
            "mission": self._mission(),
            "wheels": self._wheels(t),
            "resources": self._resources(t),
            "exchanges": self._exchanges(),
            "agents": self._agents(t),
            "board": self._board(),
            "near": [p for points, at in self._near.values() if t - at <= QUIET_S for p in points],
            "grid": self._grid,
            "log": self._log(),
            "could": sorted(self.known.could(t)),
            "standing": self._standing(t),
            "hand": self._stick(t),
            "parameters": self._tunable(),
        }

    @property
    def trail(self) -> list[list[Any]]:
        """The way that was driven, for who comes late: x, y, and who was obeyed."""
        return list(self._trail)

    @property
    def still(self) -> dict[str, Any]:
        found = [{"name": each.name, "title": each.title} for each in self.missions.values()]
        return {"missions": found, "world": None if self.world is None else drawn(self.world)}

    def _body(self) -> dict[str, Any] | None:
        body = self.view.description
        if body is None:
            return None
        return {
            "name": body.robot,
            "front": body.front,
            "rear": body.rear,
            "half_width": body.half_width,
            "v_max": body.v_max,
            "w_max": body.w_max,
        }

    def _motion(self, t: float) -> dict[str, Any]:
        view = self.view
        pose, state, truth = view.pose, view.state, view.truth
        found: dict[str, Any] = {
            "heard": view.hears_robot(t),
            "silent_s": None if view.heard_at is None else round(t - view.heard_at, 1),
            "battery": view.battery,
            "where": view.whereabouts(t),
        }
        if state is not None:
            found |= {"v": _short(state.v), "w": _short(state.w), "cycle": state.cycle.number}
            found |= {"stalled": state.stalled, "motors": state.motors}
        if pose is not None:
            found |= {"x": _short(pose.x), "y": _short(pose.y), "theta": _short(pose.theta)}
            found |= {"deviation": _short(pose.deviation), "lost": view.lost_since is not None}
        if truth is not None:
            found["truth"] = [_short(truth.x), _short(truth.y), _short(truth.theta)]
        return found

    def _latch(self, t: float) -> dict[str, Any]:
        """`held` only by the robot's own word, and only while that is fresh."""
        stop, pressed = self.view.stop, self.asked.pressed
        return {
            "held": self.view.stopped(t) is True,
            "known": self.view.state is not None,
            "stopped": stop.stopped,
            "by": stop.by,
            "press": str(stop.press),
            "code": stop.code if stop.stopped else "",  # programs are told it, to be confirmed
            "asked": pressed is not None and pressed.stopped,
            "rolling": "" if pressed is None else pressed.latching.rolling,
        }

    def _mission(self) -> dict[str, Any]:
        status, trajectory = self.view.mission, self.view.trajectory
        found: dict[str, Any] = {"tasks": self.view.tasks}
        if status is not None:
            found |= {"state": status.state.value, "note": status.note}
            found |= {"to_go": round(status.to_go, 2)}
        if trajectory is not None:
            way = [[_short(w.x), _short(w.y), _short(w.theta)] for w in trajectory.waypoints]
            found |= {"way": way, "leg": trajectory.leg, "waits": trajectory.waits}
            found |= {"start": [_short(trajectory.start.x), _short(trajectory.start.y)]}
        return found

    def _wheels(self, t: float) -> dict[str, Any]:
        """Who drives, and what all that contend would: the others by the bids that they keep."""
        view, wheels = self.view, WHEELS.name
        driver, claim = view.driver(wheels, t), view.claim(wheels, t)
        rows = []
        for agent in view.agents:
            if agent.card is None or wheels not in agent.card.resources:
                continue
            record = view.bid(agent.instance, wheels)
            row: dict[str, Any] = {"name": agent.name, "colour": colour(agent.name)}
            row["drives"] = agent.instance == driver
            if claim is not None and claim.ballot.instance == agent.instance:
                row |= {"utility": claim.utility, "critical": claim.critical, "why": ""}
            elif record is not None:
                row |= {"utility": record.utility, "critical": record.critical}
                row |= {"why": record.reason}
            rows.append(row)
        return {"driver": _name(driver), "contenders": rows}

    def _resources(self, t: float) -> list[dict[str, Any]]:
        view = self.view
        held = {name: view.driver(name, t) for name in view.resources if name != WHEELS.name}
        return [{"name": name, "holder": _name(who)} for name, who in held.items()]

    def _agents(self, t: float) -> list[dict[str, Any]]:
        """Who is alive, and who should be: by the word of the hosts that keep agents up."""
        kept = {(each.agent, each.pid): each for each in self.known.kept(t)}
        rows = []
        for agent in self.view.agents:
            row: dict[str, Any] = {"name": agent.name, "instance": agent.instance[-8:]}
            row |= {"colour": colour(agent.name), "alive": True, "pid": 0, "kept": False}
            if agent.card is not None:
                row |= {"host": agent.card.host, "pid": agent.card.pid}
                row["kept"] = kept.pop((agent.name, agent.card.pid), None) is not None
            rows.append(row)
        alive = self.view.names
        for each in kept.values():
            if each.agent not in alive:
                row = {"name": each.agent, "instance": "", "colour": colour(each.agent)}
                row |= {"alive": False, "pid": 0, "kept": True, "host": each.host}
                rows.append(row | {"state": each.state, "why": each.why})
        return sorted(rows, key=lambda row: (row["name"], row["instance"]))

    def _log(self) -> list[dict[str, Any]]:
        lines = list(self.view.logs)[-LINES:]
        return [
            {
                "t": round(said.at, 1),
                "name": agent_of(said.instance),
                "level": said.log.level,
                "text": said.log.text,
            }
            for said in lines
        ]

    def _standing(self, t: float) -> dict[str, Any]:
        found = standing(self.view, t, self._installed, self._hosts)
        cause = found.cause
        told: dict[str, Any] = {"stands": found.stands, "sentences": list(found.sentences)}
        if cause is not None:
            told |= {"sort": cause.sort.value, "who": cause.who, "todo": cause.todo}
        return told

    def _stick(self, t: float) -> dict[str, Any]:
        """Whose hand drives; `there`: somebody would take the stick."""
        key = service_of(Stick).key
        there = any(a.card and key in a.card.requests for a in self.view.agents)
        found: dict[str, Any] = {"there": there, "hand": "", "holds": False}
        status = self.view.hand(t)
        if not isinstance(status, TeleopStatus):
            return found
        return found | {
            "hand": status.hand,
            "holds": status.holds,
            "v": _short(status.v),
            "w": _short(status.w),
            "v_max": status.v_max,
            "w_max": status.w_max,
            "note": status.note,
        }

    def _tunable(self) -> list[dict[str, Any]]:
        """What may be changed, by agent."""
        return [
            {
                "agent": agent.name,
                "instance": agent.instance,
                "rows": self.known.parameters[agent.instance],
            }
            for agent in self.view.agents
            if self.known.parameters.get(agent.instance)
        ]

    def _board(self) -> list[dict[str, Any]]:
        return [_mission(mission) for mission in self.view.missions]

    def _exchanges(self) -> list[dict[str, Any]]:
        rows = []
        for each in self.view.exchanges:
            if each.resource == WHEELS.name:
                row: dict[str, Any] = {"t": round(each.at, 2)}
                row |= {"from": _name(each.before), "to": _name(each.now)}
                if each.claim is not None:
                    row |= {"utility": each.claim.utility, "critical": each.claim.critical}
                rows.append(row)
        return rows[-EXCHANGES:]

    # What it comes to ----------------------------------------------------------------------------

    def _step(self, pose: Pose, t: float) -> None:
        x, y = _short(pose.x), _short(pose.y)
        name = _name(self.view.driver(WHEELS.name, t))
        if self._trail:
            last = self._trail[-1]
            if abs(x - last[0]) + abs(y - last[1]) < TRAIL_M:
                return
        self._trail.append([x, y, name])


def drawn(world: World) -> dict[str, Any]:
    """A world as the page draws it."""
    walls = [[_short(v) for v in wall] for wall in world.walls]
    return {
        "name": world.name,
        "bounds": [_short(v) for v in world.bounds],
        "walls": walls,
        "columns": [[_short(v) for v in column] for column in world.columns],
        "forbidden": [[_short(v) for v in line] for line in world.forbidden],
        "rooms": [[room.name, room.x1, room.y1, room.x2, room.y2] for room in world.rooms],
        "docks": {name: list(pose) for name, pose in world.docks.items()},
        "goals": {name: list(pose) for name, pose in world.goals.items()},
    }


def _name(instance: str | None) -> str | None:
    return None if instance is None else agent_of(instance)


def _points(obstacles: Obstacles) -> list[list[float]]:
    every = -(-len(obstacles.points) // POINTS) or 1
    return [[_short(p.x), _short(p.y)] for p in obstacles.points[::every]]


def _grid(message: OccupancyGrid) -> dict[str, Any]:
    """The browser inflates it."""
    return {
        "x": message.x,
        "y": message.y,
        "cell": message.cell,
        "rows": message.rows,
        "columns": message.columns,
        "packed": b64encode(message.packed).decode(),
    }


def _mission(mission: Progress) -> dict[str, Any]:
    return {
        "mission": str(mission.number),
        "name": mission.name,
        "state": mission.state,
        "over": mission.over,
        "priority": mission.priority,
        "doing": "" if mission.over else mission.summary,
        "ahead": list(mission.ahead[:5]),
        "note": mission.note,
        "done": mission.done,
        "by": mission.by,
    }


def _short(value: float) -> float:
    """So many digits as can be seen; cm of a degree, mm of a metre."""
    return round(value, 3) if isfinite(value) else 0.0
