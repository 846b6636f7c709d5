"""One robot as the page shows it, and what people ask of it there (sans-IO).

Messages, tokens, answers, requests and the time go in; `take` gives what is to be published, asked
and told, `parts` what is to be shown. It decides nothing: a goal is a mission as anybody's, and a
stop holds when the robot says so.
"""

from __future__ import annotations

import zlib
from base64 import b64encode
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from math import atan2, isfinite, remainder, tau
from typing import Any, Final

from msgspec.structs import replace

from armadico.config.worlds import World
from armadico.core.messages import (
    Ack,
    BoardMission,
    Cycle,
    HostShare,
    KeptState,
    Message,
    MissionCancel,
    MissionEnd,
    MissionOrder,
    MissionReply,
    MissionRequest,
    Obstacles,
    OccupancyGrid,
    ParameterChange,
    ParametersReply,
    ParametersRequest,
    Pose,
    RobotState,
    Setting,
    StepEnd,
    Stick,
    Stop,
    TeleopStatus,
    WakeupOrder,
    WakeupReply,
    WakeupRequest,
    Waypoint,
    plain,
)
from armadico.core.resources import WHEELS
from armadico.core.services import service_of
from armadico.observe.page.requests import (
    Cancel,
    Goto,
    Halt,
    Hold,
    Order,
    Request,
    RequestError,
    Restart,
    Resume,
    Start,
    Tune,
    bits,
)
from armadico.observe.pictures import colour
from armadico.observe.standing import Installed, standing
from armadico.observe.view import QUIET_S, View, agent_of, at_work
from armadico.runtime.client import PLANNING_S, PRESS_S, STOP_S
from armadico.runtime.latch import Latching

ANSWER_S: Final = 10.0
"""What an answer to all but a goal may take."""

UNDER_WAY: Final = 8
"""Questions of one browser that may wait for one robot's answers."""

STICK_S: Final = 0.05
"""A browser's stick is passed on no oftener: the newest, or a flood would be one on the mesh."""

EXCHANGES: Final = 30
LINES: Final = 40
POINTS: Final = 300
TRAIL: Final = 3000
TRAIL_M: Final = 0.04
"""What is shown at the most: exchanges, lines of the log, points that are near, and points of the
path, so far apart."""

HAND_S: Final = 2.5
"""Whose hand drives is said each second at least; a report older than this says nothing."""

SHARE_S: Final = 5.0
"""A host that has said nothing for so long keeps nobody up."""


@dataclass(frozen=True)
class Publish:
    """A message to be published on its service's key."""

    message: Message


@dataclass(frozen=True)
class Put:
    """A query; what is answered goes to `Robot.answered` by its number."""

    number: int
    key: str
    message: Message
    reply: type[Message]
    timeout: float


@dataclass(frozen=True)
class Tell:
    """What came of a browser's request."""

    browser: str
    id: int
    ok: bool
    text: str
    over: bool = True
    """False: there is more to come of it."""


@dataclass(frozen=True)
class Spawn:
    """An agent is to be started here, beside the page."""

    browser: str
    id: int
    agent: str


Out = Publish | Put | Tell | Spawn


@dataclass(frozen=True)
class Shipped:
    """A mission that can be ordered by its name."""

    name: str
    title: str
    text: str


@dataclass
class _Waiting:
    """A question that is under way, and whose."""

    browser: str
    id: int
    done: Callable[[Message], tuple[bool, str]]


@dataclass
class _Pressed:
    """A stop or a release that has not been acknowledged yet."""

    latching: Latching
    press: int
    stopped: bool
    since: float
    say_at: float
    whose: list[tuple[str, int]] = field(default_factory=list)


@dataclass
class _Hand:
    """A browser's, on the stick."""

    number: int = 0  # how often it has moved
    say_at: float = 0.0
    newest: Stick | None = None  # that waits until then


class Robot:
    """One robot's society."""

    def __init__(
        self,
        namespace: str,
        world: World | None = None,
        missions: Mapping[str, Shipped] | None = None,
        bits64: Callable[[], int] = lambda: 1,
        helpers: Collection[str] = (),
        installed: Installed = lambda _: (),
    ) -> None:
        """Nothing is known yet.

        Args:
            namespace: The robot's.
            world: Whose walls are shown.
            missions: Those that can be ordered, by name.
            bits64: Draws the number that tells one stop from another.
            helpers: Agents that can be started beside the page, where no host would.
            installed: As `standing` takes it.
        """
        self.namespace = namespace
        self.view = View()
        self.world = world
        self.missions = missions or {}
        self.heard_at: float | None = None  # the robot agent's newest state
        self._draw = bits64
        self._helpers = tuple(helpers)
        self._installed = installed
        self._out: list[Out] = []
        self._number = 0
        self._waiting: dict[int, _Waiting] = {}
        self._pressed: _Pressed | None = None
        self._near: dict[str, tuple[list[list[float]], float]] = {}
        self._grid: dict[str, Any] | None = None
        self._shares: dict[str, tuple[HostShare, float]] = {}
        self._driver: str | None = None
        self._exchanges: deque[dict[str, Any]] = deque(maxlen=EXCHANGES)
        self._hand: tuple[TeleopStatus, float] | None = None
        self._sticks: dict[str, _Hand] = {}  # by browser
        self._parameters: dict[str, list[dict[str, Any]]] = {}
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
                self._state(message, t)
            case Ack() if message.resource == WHEELS.name:
                self._drives(t)
            case Pose():
                self._step(message)
            case Obstacles():
                self._near = {s: near for s, near in self._near.items() if t - near[1] <= QUIET_S}
                self._near[message.sensor] = (_points(message), t)
            case OccupancyGrid():
                self._grid = _grid(message)
            case HostShare() if key == _share(message.instance):  # it is asked by that name
                self._shares[message.instance] = (message, t)
            case TeleopStatus():
                self._hand = (message, t)
            case ParametersReply():
                self._parameters[message.instance] = [*map(plain, message.parameters)]
            case ParameterChange():
                self._changed(message)

    def token(self, instance: str, *, there: bool, t: float) -> None:
        """A liveliness token came or went."""
        self.view.token(instance, there=there, t=t)
        if not there:
            self._parameters.pop(instance, None)
            self._shares.pop(instance, None)

    def ask(self, browser: str, request: Request, t: float) -> None:
        """A person asks for something. Raises RequestError if that cannot be asked for."""
        match request:
            case Halt():
                self._stop(browser, request.id, t)
            case Resume():
                self._resume(browser, request, t)
            case Goto():
                self._goto(browser, request)
            case Order():
                self._order(browser, request)
            case Cancel():
                cancel = MissionCancel(bits(request.mission), browser)
                self._put(browser, request.id, cancel, lambda _: "cancelled")
            case Restart():
                self._restart(browser, request, t)
            case Start():
                self._start(browser, request, t)
            case Tune():
                self._tune(browser, request)
            case Hold():
                self._hold(browser, request, t)

    def gone(self, browser: str) -> None:
        """A browser has gone: whatever its hand held it lets go of."""
        state = self.view.state
        if browser in self._sticks and state is not None:
            self._sticks[browser].newest = Stick(state.cycle, browser, 0, 0.0, 0.0, held=False)
            self._publish_stick(self._sticks[browser])
        self._sticks.pop(browser, None)

    def answered(self, number: int, message: Message | None) -> None:
        """What a question was answered; None: nothing, and nothing more will come."""
        waiting = self._waiting.pop(number, None)
        if waiting is None:
            return
        if message is None:
            self._tell(waiting.browser, waiting.id, False, "nobody answered")
        else:
            self._tell(waiting.browser, waiting.id, *waiting.done(message))

    def wake(self, t: float) -> None:
        """Do what is due by the time: an order to stop is repeated until it is acknowledged."""
        for hand in self._sticks.values():
            self._say_stick(hand, t)
        pressed = self._pressed
        if pressed is None:
            return
        if t >= pressed.say_at:
            self._press(pressed, t)
        late = t - pressed.since > STOP_S
        if late and not pressed.stopped:
            self._over(False, "the release was not acknowledged: nothing is heard of the robot")
        elif late:
            for browser, number in pressed.whose:
                said = "SENT, NOT ACKNOWLEDGED by the robot, and sent again until it is"
                self._tell(browser, number, False, said, over=False)
            pressed.whose = []

    def take(self) -> list[Out]:
        """What is to be published, asked and told, in this order; each once."""
        out, self._out = self._out, []
        return out

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
            "exchanges": list(self._exchanges),
            "agents": self._agents(t),
            "board": self._board(),
            "near": [p for points, at in self._near.values() if t - at <= QUIET_S for p in points],
            "grid": self._grid,
            "log": self._log(),
            "could": sorted(self._could(t)),
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
        """What never changes."""
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
            "heard": self._is_heard(t),
            "silent_s": None if self.heard_at is None else round(t - self.heard_at, 1),
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
        stop, pressed = self.view.stop, self._pressed
        return {
            "held": stop.stopped and self._is_heard(t),
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
            record, _ = view.bids.get(agent.instance, (None, 0.0))
            row: dict[str, Any] = {"name": agent.name, "colour": colour(agent.name)}
            row["drives"] = agent.instance == driver
            if claim is not None and claim.ballot.instance == agent.instance:
                row |= {"utility": claim.utility, "critical": claim.critical, "why": ""}
            elif record is not None and record.resource == wheels:
                row |= {"utility": record.utility, "critical": record.critical}
                row |= {"why": record.reason}
            rows.append(row)
        return {"driver": None if driver is None else agent_of(driver), "contenders": rows}

    def _resources(self, t: float) -> list[dict[str, Any]]:
        view = self.view
        held = {name: view.driver(name, t) for name in view.resources if name != WHEELS.name}
        return [
            {"name": name, "holder": None if who is None else agent_of(who)}
            for name, who in held.items()
        ]

    def _agents(self, t: float) -> list[dict[str, Any]]:
        """Who is alive, and who should be: by the word of the hosts that keep agents up."""
        kept = {(each.agent, each.pid): each for each in self._kept(t)}
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

    def _kept(self, t: float) -> Iterator[_KeptAgent]:
        for instance, (share, at) in self._shares.items():
            if t - at > SHARE_S or share.leaving:
                continue
            for process in share.kept:
                if process.state is not KeptState.ENDED:
                    for name in process.agents:
                        yield _KeptAgent(
                            name,
                            process.pid,
                            share.host,
                            instance,
                            process.state.value,
                            process.why,
                        )

    def _could(self, t: float) -> dict[str, str]:
        """Agents that a host would start, and its wakeup agent's instance; empty: the page."""
        found = dict.fromkeys(self._helpers, "")
        for instance, (share, at) in self._shares.items():
            if t - at <= SHARE_S and not share.leaving:
                found |= dict.fromkeys(share.can, instance)
        return {name: who for name, who in found.items() if name not in self.view.names}

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
        found = standing(self.view, t, self._installed)
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
        if self._hand is None or t - self._hand[1] > HAND_S:
            return found
        status = self._hand[0]
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
                "rows": self._parameters[agent.instance],
            }
            for agent in self.view.agents
            if self._parameters.get(agent.instance)
        ]

    def _board(self) -> list[dict[str, Any]]:
        board = self.view.board
        return [] if board is None else [_told(mission) for mission in board.missions]

    def _is_heard(self, t: float) -> bool:
        return self.heard_at is not None and t - self.heard_at <= QUIET_S

    # What is asked for ---------------------------------------------------------------------------

    def _stop(self, browser: str, number: int, t: float) -> None:
        pressed = self._pressed
        if pressed is None or not pressed.stopped:
            if pressed is not None:
                self._over(False, f"stopped again, by {browser}")
            press = self._draw()
            latching = Latching(stopped=True, by=browser, press=press)
            pressed = self._pressed = _Pressed(latching, press, stopped=True, since=t, say_at=t)
            self._press(pressed, t)
        pressed.whose.append((browser, number))

    def _resume(self, browser: str, request: Resume, t: float) -> None:
        """Release the stop that was seen: one that was pressed since is another."""
        stop, pressed = self.view.stop, self._pressed
        if pressed is not None and pressed.stopped and not stop.stopped:
            self._over(False, f"given up, by {browser}: it was never acknowledged")
            self._tell(browser, request.id, True, "the order to stop is given up")
            return
        if not stop.stopped:
            raise RequestError("the robot is not stopped")
        if stop.press != bits(request.press):
            raise RequestError(f"it was stopped again meanwhile, by {stop.by or 'somebody'}")
        if pressed is not None:
            self._over(False, f"released, by {browser}")
        latching = Latching(stopped=False, by=browser, press=0)
        assert self.view.state is not None, "it said who stopped it"
        latching.hear(self.view.state, t)
        self._pressed = _Pressed(latching, stop.press, stopped=False, since=t, say_at=t)
        self._pressed.whose.append((browser, request.id))
        self._press(self._pressed, t)

    def _press(self, pressed: _Pressed, t: float) -> None:
        message = pressed.latching.message()
        if message is not None:
            self._out.append(Publish(message))
        pressed.say_at = t + PRESS_S

    def _over(self, ok: bool, text: str) -> None:
        """What was pressed is acknowledged, or given up."""
        pressed, self._pressed = self._pressed, None
        for browser, number in () if pressed is None else pressed.whose:
            self._tell(browser, number, ok, text)

    def _goto(self, browser: str, request: Goto) -> None:
        theta = request.theta
        if theta is None:  # as one walks there
            pose = self.view.pose
            theta = 0.0 if pose is None else atan2(request.y - pose.y, request.x - pose.x)
        goal = Waypoint(request.x, request.y, remainder(theta, tau))

        def said(reply: MissionReply) -> str:
            stop = ", once the stop is released" if self.view.stop.stopped else ""
            return f"on its way{stop}: {reply.length:.1f} m to go"

        self._put(browser, request.id, MissionRequest(goal), said, PLANNING_S)

    def _order(self, browser: str, request: Order) -> None:
        shipped = self.missions.get(request.mission)
        if shipped is None:
            raise RequestError(f"there is no mission {request.mission!r}")
        packed = zlib.compress(shipped.text.encode())
        order = MissionOrder(shipped.name, packed, None, browser)
        self._put(browser, request.id, order, lambda _: f"{shipped.name} is ordered")

    def _restart(self, browser: str, request: Restart, t: float) -> None:
        """By the wakeup agent that keeps it up: nobody else may end a process."""
        kept = [each for each in self._kept(t) if each.agent == request.agent]
        chosen = next((each for each in kept if each.pid == request.pid), None)
        if chosen is None:
            raise RequestError(
                f"nobody keeps {request.agent} up, so nobody would start it again: that is done by"
                " `armadico up`"
            )
        order = WakeupRequest(WakeupOrder.RESTART, request.agent, chosen.pid, f"asked by {browser}")
        key = service_of(WakeupRequest).key_for(instance=chosen.wakeup)
        done = f"{request.agent} is restarted"
        self._put(browser, request.id, order, lambda _: done, key=key)

    def _start(self, browser: str, request: Start, t: float) -> None:
        wakeup = self._could(t).get(request.agent)
        if wakeup is None:
            raise RequestError(
                f"no host says that it could start {request.agent}; `armadico-agent"
                f" {request.agent}` does so by hand"
            )
        if not wakeup:
            self._out.append(Spawn(browser, request.id, request.agent))
            return
        order = WakeupRequest(WakeupOrder.START, request.agent, 0, f"asked by {browser}")
        key = service_of(WakeupRequest).key_for(instance=wakeup)
        done = f"{request.agent} is started"
        self._put(browser, request.id, order, lambda _: done, key=key)

    def _tune(self, browser: str, request: Tune) -> None:
        """Whether it is in its range the agent says, and why not."""
        instance = request.instance
        if instance not in self.view.alive:
            raise RequestError(f"{instance} is not alive")
        names = {"name": agent_of(instance), "instance": instance}
        key = service_of(ParametersRequest).key_for(**names)
        change = ParametersRequest((Setting(request.name, request.json),), browser)

        def said(reply: ParametersReply) -> str:
            self._parameters[instance] = [*map(plain, reply.parameters)]
            return f"{agent_of(instance)}: {request.name} = {request.json}"

        self._put(browser, request.id, change, said, key=key)

    def _changed(self, change: ParameterChange) -> None:
        """Somebody, here or elsewhere, has changed a parameter."""
        for row in self._parameters.get(change.instance, ()):
            if row["name"] == change.name:
                row["json"] = change.json

    def _hold(self, browser: str, request: Hold, t: float) -> None:
        """Pass on where a stick is, with the cycle that its hand saw."""
        state = self.view.state
        if state is None:
            raise RequestError("nothing is heard of the robot")
        cycle = Cycle(state.cycle.epoch, min(request.cycle, state.cycle.number))
        hand = self._sticks.setdefault(browser, _Hand())
        hand.newest = Stick(cycle, browser, 0, request.v, request.w, request.held)
        self._say_stick(hand, t)

    def _say_stick(self, hand: _Hand, t: float) -> None:
        if hand.newest is not None and t >= hand.say_at:
            hand.say_at = t + STICK_S
            self._publish_stick(hand)

    def _publish_stick(self, hand: _Hand) -> None:
        assert hand.newest is not None, "there is one to be said"
        hand.number += 1
        self._out.append(Publish(replace(hand.newest, number=hand.number)))
        hand.newest = None

    def _put(
        self,
        browser: str,
        number: int,
        message: Message,
        said: Callable[[Any], str],
        timeout: float = ANSWER_S,
        key: str = "",
    ) -> None:
        if sum(each.browser == browser for each in self._waiting.values()) >= UNDER_WAY:
            raise RequestError("too much is asked for at once")
        service = service_of(type(message))
        assert service.reply is not None, "it is a question"

        def done(reply: Message) -> tuple[bool, str]:
            assert isinstance(reply, MissionReply | WakeupReply | ParametersReply)
            return (False, reply.refusal) if reply.refusal else (True, said(reply))

        self._number += 1
        self._waiting[self._number] = _Waiting(browser, number, done)
        put = Put(self._number, key or service.key, message, service.reply, timeout)
        self._out.append(put)

    def _tell(self, browser: str, number: int, ok: bool, text: str, *, over: bool = True) -> None:
        self._out.append(Tell(browser, number, ok, text, over))

    # What it comes to ----------------------------------------------------------------------------

    def _state(self, state: RobotState, t: float) -> None:
        self.heard_at = t
        pressed = self._pressed
        if pressed is None:
            return
        pressed.latching.hear(state, t)
        if pressed.stopped:
            self._stopping(pressed, state.stop)
        elif pressed.latching.done:
            self._over(True, "released")
        elif pressed.latching.refusal:
            self._over(False, pressed.latching.refusal)

    def _stopping(self, pressed: _Pressed, stop: Stop) -> None:
        if pressed.latching.done:
            self._over(True, "the robot is stopped, by its own word")
        elif not stop.stopped and stop.press == pressed.press:
            self._over(False, f"released meanwhile, by {stop.by or 'somebody'}")

    def _drives(self, t: float) -> None:
        """An exchange: the wheels obey another one than before."""
        now = self.view.driver(WHEELS.name, t)
        if now == self._driver:
            return
        claim = self.view.claim(WHEELS.name, t)
        row: dict[str, Any] = {"t": round(t, 2)}
        row["from"] = None if self._driver is None else agent_of(self._driver)
        row["to"] = None if now is None else agent_of(now)
        if claim is not None and claim.ballot.instance == now:
            row |= {"utility": claim.utility, "critical": claim.critical}
        self._driver = now
        self._exchanges.append(row)

    def _step(self, pose: Pose) -> None:
        x, y = _short(pose.x), _short(pose.y)
        name = None if self._driver is None else agent_of(self._driver)
        if self._trail:
            last = self._trail[-1]
            if abs(x - last[0]) + abs(y - last[1]) < TRAIL_M:
                return
        self._trail.append([x, y, name])


@dataclass(frozen=True)
class _KeptAgent:
    agent: str
    pid: int
    host: str
    wakeup: str
    state: str
    why: str


def _share(instance: str) -> str:
    return service_of(HostShare).key_for(instance=instance)


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


def _told(mission: BoardMission) -> dict[str, Any]:
    over = mission.state in (MissionEnd.DONE, MissionEnd.FAILED, MissionEnd.CANCELLED)
    return {
        "mission": str(mission.mission),
        "name": mission.name,
        "state": mission.state.value,
        "over": over,
        "priority": mission.priority,
        "doing": "" if over else at_work(mission),
        "ahead": list(mission.ahead[:5]),
        "note": mission.note,
        "done": sum(result.end is StepEnd.DONE for result in mission.course.results),
        "by": mission.by,
    }


def _short(value: float) -> float:
    """So many digits as can be seen; cm of a degree, mm of a metre."""
    return round(value, 3) if isfinite(value) else 0.0
