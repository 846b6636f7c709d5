"""The present of a running society, from its messages alone (sans-IO).

`Account` keeps what is received of a society, live or from a recording. `present` makes a `Present`
of it: the state from which a virtual society begins (`armadico.rehearsal.fork`). What is not known
stays unknown, and is named: `lacks` is what a positive answer would need, `unforked` what a virtual
society is without.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import cos, hypot, isnan, radians, sin
from pathlib import PurePath
from typing import Final

from msgspec import Struct, json

from armadico.agents.supervision.messages import HostShare, KeptState
from armadico.cli.parsing import version
from armadico.core.discovery import AGENTS, installed
from armadico.core.hands import release
from armadico.core.judgement import Answer, Judgement, no, unknown, yes
from armadico.core.membership import agent_of
from armadico.core.messages import (
    Card,
    Description,
    Message,
    MonitorReport,
    ParametersReply,
    Tuning,
    line,
)
from armadico.core.resources import WHEELS
from armadico.core.services import derived, matches, service_of
from armadico.launch.latch import rests
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.geometry import Pose2, to_world
from armadico.mobile.messages import (
    BatteryLevel,
    ByHand,
    Correction,
    FleetPose,
    LocalMap,
    MissionState,
    OccupancyGrid,
    Pose,
    Scan,
    Sonar,
    Truth,
)
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import bearings_of, is_readable, ranges_of
from armadico.observe.diagnosis import diagnose
from armadico.observe.findings import Sort
from armadico.observe.measures import watched
from armadico.observe.view import View
from armadico.observe.watching import Presence
from armadico.rehearsal.sight import Ray

ODD: Final = 0.5
"""An error of the odometry that is larger, in rad/rad, rad/m or m/m, is taken as not known."""

WHEELS_KNOWN: Final = 6
"""Length of a known estimate in `Correction.wheels`."""

STALE_S: Final = 2.0
"""A robot whose newest state or pose is older is not known now, nor is what stands around it."""

CELL_M: Final = 0.1
"""Side of the cells in which obstacles are kept."""

KEPT: Final = 5
"""Newest messages of obstacles of each sensor: what most of them have is there, an echo is not."""

SHARES_S: Final = 3.0
"""A host that keeps agents up says so each second: after so long it is not known any more."""

GONE_S: Final = 6.0
"""An agent that has been gone for less may be restarted: its host needs no longer."""

APART: Final = ("assistant", "monitor", "teleop", "wakeup")
"""Agents that only watch, restart others, or pass on what people and programs ask for."""

VIRTUAL: Final = "virtual"
"""The version on cards of the virtual mesh, whose agents are those of this program."""

SONAR: Final = "sonar"
"""The sensor of `LocalMap`, as in `Obstacles.sensor`."""

LASER: Final = "laser"

SURE: Final = 0.9
"""A point of a sonar's local map of less probability may be a ghost, such as a false echo."""

RAYS: Final = 120
"""Most rays of a laser's scan that are compared with the map."""

SURE_M: Final = 0.35
"""By sonar, obstacles that are farther from all such points are guessed, not measured."""

LOST_RAD: Final = radians(30.0)
"""A heading that is known less well is lost."""


FAULTS: Final = frozenset(
    {
        *(Sort.FAULT, Sort.PROMISE, Sort.STALLED, Sort.DEVICE, Sort.SILENT, Sort.SLOW, Sort.STALE),
        *(Sort.LINK, Sort.HOST, Sort.UNREACHABLE, Sort.UNSOUND, Sort.REFUSED, Sort.FOREIGN),
        *(Sort.TWICE, Sort.MIXED, Sort.MAP),
    }
)
"""What a diagnosis may find that no sample has: there all agents, wheels and sensors work, but for
sensors that report nothing. Other findings are in the samples, such as agents that are not alive
and what blocks the way, or stop the robot at once."""


def kinds() -> tuple[type[Message], ...]:
    """The installed messages that an account needs."""
    bases: tuple[type[Message], ...] = (Obstacles, ByHand)
    more: tuple[type[Message], ...] = (
        *(Card, ParametersReply, Tuning, FleetPose, LocalMap, Correction, MonitorReport, HostShare),
    )
    several = (kind for base in bases for kind in derived(base))
    every = dict.fromkeys((*watched(), *more, *several))
    return tuple(kind for kind in every if kind is not Truth)


class Account:
    """What was received of one society (an `observe.watching.Account`). Times are s.

    Attributes:
        view: Its view.
        local: The newest local map of the sonars, with the pose at that time, and the time.
        obstacles: By sensor, the newest obstacles, each with the pose at that time, and the time.
        others: By name, the newest poses of the fleet's other robots, with their times.
        grid: The newest map made by driving.
        scan: The newest scan of the laser, with the pose at that time, and the time.
        ranged: By sensor, when its newest readings came.
        wheels: The newest estimate of the odometry's errors, as in `Correction`; empty: none.
        elsewhere: Whether the readings fit another place, as in `Correction`.
        off_map: Whether the map does not show the robot's place, likewise.
        parameters: By instance, its parameters.
        tuned: By agent, the parameters that were changed while it ran.
        shares: By launcher, its newest report of the agents that it keeps up, and the time.
    """

    def __init__(self) -> None:
        self.view = View()
        self.local: tuple[LocalMap, Pose, float] | None = None
        self.obstacles: dict[str, deque[tuple[Obstacles, Pose, float]]] = {}
        self.others: dict[str, tuple[FleetPose, float]] = {}
        self.grid: OccupancyGrid | None = None
        self.scan: tuple[Scan, Pose, float] | None = None
        self.ranged: dict[str, float] = {}
        self.wheels: tuple[float, ...] = ()
        self.elsewhere = self.off_map = False
        self.parameters: dict[str, ParametersReply] = {}
        self.tuned: dict[str, dict[str, str]] = {}
        self.shares: dict[str, tuple[HostShare, float]] = {}

    def token(self, instance: str, *, there: bool, t: float) -> None:
        self.view.token(instance, there=there, t=t)

    def update(self, key: str, message: Message | None, t: float) -> None:
        self.view.update(key, message, t)
        self._keep(message, t)

    def learn(self, message: Message, t: float) -> None:
        self.view.learn(message, t)
        self._keep(message, t)

    def _keep(self, message: Message | None, t: float) -> None:
        match message:
            case Obstacles():
                pose = self.view.pose
                if pose is not None:
                    known = self.obstacles.setdefault(message.sensor, deque(maxlen=KEPT))
                    known.append((message, pose, t))
            case LocalMap():
                pose = self.view.pose
                self.local = self.local if pose is None else (message, pose, t)
            case Sonar():
                self.ranged[SONAR] = t
            case Scan():
                self.ranged[LASER] = t
                pose = self.view.pose
                self.scan = self.scan if pose is None else (message, pose, t)
            case Correction():
                odd = any(abs(each) >= ODD for each in message.wheels)
                self.wheels = () if odd or len(message.wheels) != WHEELS_KNOWN else message.wheels
                self.elsewhere, self.off_map = message.elsewhere, message.off_map
            case FleetPose():
                self.others[message.robot] = message, t
            case OccupancyGrid():
                self.grid = message
            case ParametersReply():
                self.parameters[message.instance] = message
            case HostShare():
                self.shares[message.instance] = message, t
            case Tuning():
                for each in message.settings:
                    self.tuned.setdefault(each.agent, {})[each.setting.name] = each.setting.json


class AgentNow(Struct, frozen=True):
    """One kind of agent of the society."""

    name: str  # its name
    instances: int = 1  # how many are alive
    # Its parameters that differ from the defaults, KEY=VALUE; None: not known.
    sets: tuple[str, ...] | None = None
    installed: bool = True  # whether it is installed here
    drives: bool = False  # whether it competes for the wheels, as far as its card says
    lacks: str = ""  # what is not known of it, if it takes part; empty: nothing


class OtherRobot(Struct, frozen=True):
    """Another robot of the fleet as last seen: its middle (m), and the radius of its circle (m)."""

    name: str
    x: float
    y: float
    radius: float
    age_s: float


class Present(Struct, frozen=True, kw_only=True):
    """A society at one moment. Lengths are m, angles rad, in the world's frame."""

    robot: str = ""  # the name of its profile, as the robot agent describes it
    profile: str = ""  # the profile with which its agents were launched: a name or a file
    world: str = ""  # the map with which they were launched: a name or a file; "": none
    maps: tuple[str, ...] = ()  # the digests on their cards of that map; empty: not known
    grid: OccupancyGrid | None = None  # the map made by driving, if one is served
    pose: Pose2 | None = None  # the estimated pose
    covariance: tuple[float, ...] = ()  # its covariance as in `Pose`; empty: not known
    speeds: tuple[float, float] = (0.0, 0.0)  # ahead and around, as measured, m/s and rad/s
    wheels: tuple[float, ...] = ()  # errors of the odometry, as in `Correction`; empty: not known
    # The robot's footprint and limits, as its agent publishes them.
    described: Description | None = None
    goal: Pose2 | None = None  # that of the present mission; None: there is none
    # The top speed that this mission has to keep, m/s; None: it has none.
    mission_v_max: float | None = None
    agents: tuple[AgentNow, ...] = ()  # the agents that take part
    absent: tuple[str, ...] = ()  # those that should, and are not alive
    # Cells (their middles) in which something stands, by the robot's sensors.
    obstacles: tuple[tuple[float, float], ...] = ()
    others: tuple[OtherRobot, ...] = ()  # other robots as last seen
    silent: tuple[str, ...] = ()  # range sensors that the robot has, and that report nothing
    rays: tuple[Ray, ...] = ()  # rays of the laser
    battery: float | None = None  # the share left; None: not known
    exact: bool = False  # the society takes the odometry as free of errors
    # Yes; or why nothing can be told, or the robot would not drive.
    ready: Judgement = unknown("nothing was received")
    lacks: tuple[str, ...] = ()  # what a positive answer would need and nobody knows
    unforked: tuple[str, ...] = ()  # what a virtual society of it is without

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its agents."""
        return tuple(agent.name for agent in self.agents)


def present(account: Account, now: float) -> Present:
    """The present of a society, from what was received of it until `now`, s."""
    view, notes = account.view, Notes()
    pose, state = view.pose, view.state
    terms = None if view.trajectory is None else view.trajectory.terms
    agents = tuple(_agents(account))
    world = _launched(agents, "world")
    if {"monitor", "wakeup"} & view.names:
        notes.unforked.append("monitor and wakeup: a rehearsal restarts no agent")
    _note_surroundings(account, now, notes)
    _note_faults(account, now, notes)
    if account.grid is None and view.trajectory is not None and view.trajectory.revision:
        notes.lacks.append("the map that is made meanwhile, which nobody served")
    return Present(
        robot="" if view.description is None else view.description.robot,
        profile=_launched(agents, "profile"),
        world=world or view.world,
        maps=_maps(view, line(PurePath(world).stem) or view.world),
        grid=account.grid,
        pose=None if pose is None else (pose.x, pose.y, pose.theta),
        covariance=() if pose is None else pose.covariance,
        speeds=(0.0, 0.0) if state is None or rests(state.v, state.w) else (state.v, state.w),
        wheels=account.wheels,
        described=view.description,
        goal=_goal(view),
        mission_v_max=None if terms is None else terms.v_max,
        agents=agents,
        absent=absent(account, now),
        obstacles=tuple(_obstacles(account, now)),
        others=tuple(_others(account, now)),
        silent=tuple(_silent(account, now)),
        rays=tuple(_rays(account, now)),
        battery=None if view.level is None else view.level.share,
        exact=_launched(agents, "exact") == "true",
        ready=_ready(view, now),
        lacks=tuple(dict.fromkeys(notes.lacks)),
        unforked=tuple(dict.fromkeys(notes.unforked)),
    )


def present_at(messages: Iterable[tuple[float, Message | Presence]], at: float) -> Present:
    """The present at a time (s) of a recording, by its messages in order, with their times (s)."""
    account, told = Account(), set[str]()
    for t, message in messages:
        if t > at:
            break
        if isinstance(message, Presence):
            told.add(message.instance)
            account.token(message.instance, there=message.there, t=t)
            continue
        if isinstance(message, Card) and message.instance not in told:
            # Recordings of virtual runs have tokens late. A card never revives who is gone.
            account.token(message.instance, there=True, t=t)
        if key := _key(message):  # by its rates a diagnosis knows who publishes nothing
            account.update(key, message, t)
        else:
            account.learn(message, t)
    return present(account, at)


def _key(message: Message) -> str:
    """The key on which a recorded message was published; "": it is not known."""
    try:
        row = service_of(type(message))
    except KeyError:
        return ""
    if isinstance(message, Obstacles):
        return row.key_for(name=message.sensor)
    return "" if "{" in row.key else row.key


@dataclass
class Notes:
    """What a rehearsal lacks, for people."""

    lacks: list[str] = field(default_factory=list)
    unforked: list[str] = field(default_factory=list)


def _ready(view: View, now: float) -> Judgement:
    """Whether a rehearsal can begin, and the robot would drive."""
    state, pose, at = view.state, view.pose, view.state_at
    if state is None or at is None or now - at > STALE_S:
        since = "" if at is None else f" for {now - at:.1f} s"
        return unknown(
            f"the robot's state is not known: no robot/state{since}", "`armadico doctor` shows why"
        )
    if state.stop.stopped:
        how = release(state.stop, motors=state.motors)
        return no(f"the robot is stopped by {state.stop.requester}", how)
    if state.fault:
        return no(f"the robot cannot be driven: {state.fault}")
    if not state.motors:
        return no("the robot's motors are off", release(state.stop, motors=state.motors))
    hand = view.hand(now)
    if hand is not None and hand.driven_by:
        return no(f"{hand.driven_by} drives by hand")
    posed = view.pose_at
    if pose is None or posed is None or now - posed > STALE_S:
        since = "" if posed is None else f" for {now - posed:.1f} s"
        return unknown(
            f"the robot's pose is not known: no encoder/pose{since}", "`armadico doctor`"
        )
    if pose.deviation > LOST_M or pose.heading_deviation > LOST_RAD:
        return unknown(
            f"the robot is lost: its pose is known to {pose.deviation:.2f} m only",
            "`armadico goto X Y DEG --from X Y DEG` says where it is; or wait until it has found"
            " itself",
        )
    if view.description is None:
        return unknown("the robot's size is not known: no robot/description", "`armadico doctor`")
    if not view.complete:
        names = sorted({agent_of(each) for each in view.alive if each not in view.cards})
        what = f"no card of {', '.join(names)}" if names else "no agent is alive"
        return unknown(f"the society is not known: {what}", "`armadico ps` shows it")
    return yes()


def _goal(view: View) -> Pose2 | None:
    """The goal of the mission under way."""
    way, status = view.trajectory, view.mission
    if way is None or not way.waypoints:
        return None
    if status is not None and status.state not in (MissionState.DRIVING, MissionState.PLANNING):
        return None
    last = way.waypoints[-1]
    return last.x, last.y, last.theta


# Agents -------------------------------------------------------------------------------------------


def _agents(account: Account) -> Iterator[AgentNow]:
    view, known, here = account.view, installed(AGENTS), version()
    counts = Counter(agent_of(each) for each in view.alive)
    for name in sorted(counts):
        one = next(each for each in sorted(view.alive) if agent_of(each) == name)
        card, reply = view.cards.get(one), account.parameters.get(one)
        drives = card is not None and WHEELS.name in card.resources
        sets = None if reply is None or reply.fixed is None else _sets(reply)
        if sets is not None and name in account.tuned:
            sets = _over(sets, account.tuned[name])
        if name in APART:
            continue
        lacks = ""
        if name not in known:
            lacks = f"{name}: it is not installed here"
        elif sets is None:
            lacks = f"the parameters of {name}: it did not tell them"
        elif card is not None and card.version not in (here, VIRTUAL, ""):
            lacks = f"how {name} {card.version} behaves: here it is {here}"
        yield AgentNow(name, counts[name], sets, name in known, drives, lacks)


def absent(account: Account, now: float) -> tuple[str, ...]:
    """The agents that are not alive and may be restarted.

    Their host keeps them up, a monitor misses them, or they were alive a moment ago. Agents that
    were ended on request, and those of a host that leaves in order, are none of them.
    """
    view, kept, ended = account.view, set[str](), set[str]()
    for share, at in account.shares.values():
        for each in share.kept:
            if share.leaving or each.state is KeptState.ENDED:
                ended.update(each.agents)
            elif now - at <= SHARES_S:
                kept.update(each.agents)
    for report in view.reports.values():
        kept.update(report.missing if report.acts else ())
    gone = {agent_of(each) for each, at in view.gone.items() if now - at <= GONE_S}
    return tuple(sorted((kept | gone - ended) - view.names - {*APART}))


def _sets(reply: ParametersReply) -> tuple[str, ...]:
    """What differs from the defaults, as KEY=VALUE."""
    given = {each.name: each.json for each in reply.fixed or ()}
    given |= {each.name: each.json for each in reply.parameters}
    return tuple(f"{name}={_value(text)}" for name, text in given.items())


def _over(sets: tuple[str, ...], tuned: Mapping[str, str]) -> tuple[str, ...]:
    """The parameters with those that were changed while the agent ran."""
    kept = (each for each in sets if each.partition("=")[0] not in tuned)
    return (*kept, *(f"{name}={_value(text)}" for name, text in tuned.items()))


def _value(text: str) -> str:
    """A JSON value as `--set` takes it."""
    return "none" if text == "null" else text


def _launched(agents: tuple[AgentNow, ...], name: str) -> str:
    """The value of a parameter with which an agent was launched; "" if none was."""
    for agent in agents:
        for each in agent.sets or ():
            key, _, value = each.partition("=")
            if key == name and value not in ("none", '""'):
                return str(json.decode(value)) if value[:1] == '"' else value
    return ""


def _maps(view: View, world: str) -> tuple[str, ...]:
    """The digests of the map of a name on the agents' cards; of all maps if the name is ""."""
    cards = (card for _, _, card in view.agents if card is not None and card.map)
    return tuple(sorted({card.map for card in cards if world in ("", card.world)}))


def _note_faults(account: Account, now: float, notes: Notes) -> None:
    view = account.view
    for found in diagnose(view, now=now):
        if found.sort is Sort.SLOW and found.answer is Answer.UNKNOWN:
            # A live society is observed for long enough; a recording may begin just before.
            notes.unforked.append(f"whether agents are too slow: {found.what.rstrip('.')}")
        elif found.sort in FAULTS and found.answer is not Answer.YES:
            notes.lacks.append(f"what this changes: {found.what.rstrip('.')}")
    if not any(report.instance in view.alive for report in view.reports.values()):
        notes.unforked.append("faults of sensors, wheels and agents: no monitor reports them")
    for name, _, card in view.agents:
        if card is not None and WHEELS.name in card.owns and card.version != VIRTUAL:
            notes.unforked.append(
                "delays of the robot's line and of the network, which nobody measures"
            )
        if card is not None and card.learnt:  # localization in a sample begins to learn again
            notes.unforked.append(f"what {name} has learnt: {card.learnt}")
    if account.elsewhere:
        notes.lacks.append("where the robot is: its readings fit another place, too")
    if account.off_map:
        notes.lacks.append("what is around the robot: the map does not show this place")
    state = view.state
    if state is not None and state.stalled:
        notes.lacks.append("what blocks the robot: it is stalled")


# Surroundings -------------------------------------------------------------------------------------


def provides(view: View, kind: type[Message]) -> bool:
    """Whether a live agent publishes messages of a kind, as its card says."""
    heard = [service_of(each).heard for each in derived(kind)]
    keys = [key for _, _, card in view.agents if card is not None for key in card.provides]
    return any(matches(pattern, key) for pattern in heard for key in keys)


def unheard(account: Account, now: float) -> list[str]:
    """The sensors of which no obstacles have been received for `STALE_S`; * means any."""
    view = account.view
    named = () if view.description is None else view.description.sensors
    expected = (named or ("*",)) if provides(view, Obstacles) else ()
    fresh = {sensor for sensor, known in account.obstacles.items() if now - known[-1][2] <= STALE_S}
    missing = [each for each in expected if each not in fresh and not (each == "*" and fresh)]
    return [*dict.fromkeys((*missing, *(each for each in account.obstacles if each not in fresh)))]


def _note_surroundings(account: Account, now: float, notes: Notes) -> None:
    for sensor in unheard(account, now):
        known = account.obstacles.get(sensor)
        since = f" for {now - known[-1][2]:.1f} s" if known else ""
        notes.lacks.append(f"what stands around the robot: no obstacles by {sensor}{since}")
    if account.view.level is None and provides(account.view, BatteryLevel):
        notes.lacks.append("the battery's charge: no battery/level")
    elif account.view.level is None:
        notes.unforked.append("the battery: no agent reports its charge, so a full one is driven")
    for other in _others(account, now):
        if other.age_s > STALE_S:
            notes.unforked.append(
                f"where {other.name} is now: it stands where it was seen {other.age_s:.0f} s ago"
            )


def _obstacles(account: Account, now: float) -> Iterator[tuple[float, float]]:
    """The cells with an obstacle in most of the newest messages of a sensor, if they are fresh.

    Of sonars, which hear ghosts, those near to points that have been measured again and again.
    """
    sure = _sure(account, now)
    found: dict[tuple[int, int], None] = dict.fromkeys(_cell(x, y) for x, y in sure or ())
    for sensor, known in account.obstacles.items():
        if now - known[-1][2] > STALE_S:
            continue
        counts: Counter[tuple[int, int]] = Counter()
        for message, pose, _ in known:
            at = pose.x, pose.y, pose.theta
            counts.update({_cell(*to_world(at, p.x, p.y)) for p in message.points})
        cells = [cell for cell, n in sorted(counts.items()) if 2 * n > len(known)]
        if sensor == SONAR and sure is not None:
            cells = [cell for cell in cells if _is_near(cell, sure)]
        found |= dict.fromkeys(cells)
    return (((i + 0.5) * CELL_M, (j + 0.5) * CELL_M) for i, j in found)


def _silent(account: Account, now: float) -> Iterator[str]:
    """The robot's own range sensors of which no readings have come for `STALE_S`.

    Of a robot that reports its state, so that it is not the connection.
    """
    at, about = account.view.state_at, account.view.description
    if about is None or at is None or now - at > STALE_S:
        return
    for sensor in (SONAR, LASER):
        if sensor in about.sensors and now - account.ranged.get(sensor, -STALE_S) > STALE_S:
            yield sensor


def _rays(account: Account, now: float) -> Iterator[Ray]:
    """Some rays of a fresh scan that are valid, in the world."""
    if account.scan is None or now - account.scan[2] > STALE_S:
        return
    scan, pose, _ = account.scan
    if not is_readable(scan):
        return
    x, y = to_world((pose.x, pose.y, pose.theta), scan.x, scan.y)
    step = max(1, scan.rays // RAYS)
    each = zip(bearings_of(scan)[::step].tolist(), ranges_of(scan)[::step].tolist(), strict=True)
    for bearing, far in each:
        if not isnan(far):  # a ray that met nothing has gone as far as it reaches
            yield Ray(x, y, pose.theta + bearing, min(far, scan.reach))


def _sure(account: Account, now: float) -> list[tuple[float, float]] | None:
    """The points of the local map that are sure, in the world; None: there is no fresh one."""
    if account.local is None or now - account.local[2] > STALE_S:
        return None
    message, pose, _ = account.local
    at = pose.x, pose.y, pose.theta
    return [to_world(at, c.x, c.y) for c in message.cells if c.probability >= SURE]


def _is_near(cell: tuple[int, int], points: Sequence[tuple[float, float]]) -> bool:
    x, y = (cell[0] + 0.5) * CELL_M, (cell[1] + 0.5) * CELL_M
    return any(hypot(x - px, y - py) <= SURE_M for px, py in points)


def _cell(x: float, y: float) -> tuple[int, int]:
    return int(x // CELL_M), int(y // CELL_M)


def _others(account: Account, now: float) -> Iterator[OtherRobot]:
    for name, (pose, at) in sorted(account.others.items()):
        ahead = (pose.front - pose.rear) / 2
        radius = hypot((pose.front + pose.rear) / 2, pose.half_width)
        x, y = pose.x + ahead * cos(pose.theta), pose.y + ahead * sin(pose.theta)
        yield OtherRobot(name, x, y, radius, round(now - at, 3))
