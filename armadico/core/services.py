"""The table of services: which message goes by which key, how often, and how long it is good for.

Freshness checks and the protocol page are drawn from it. Who provides and who requests a service
is not here: that is read from the agents' classes and from the cards of those that are alive. An
agent that brings a message of its own adds its row with `register`. A resource needs no row: its
keys come from its declaration (`armadico.core.resources.Resource`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from functools import cache
from math import inf
from typing import Final

from armadico.core import messages as m
from armadico.core.cycles import PERIOD
from armadico.core.resources import declared

QUIET_S: Final = 0.5
"""Who looks on, from a machine that may be busy, takes nobody for silent sooner."""


class Kind(Enum):
    """How a service is published and kept."""

    STATE = "state"  # the latest value replaces the one before
    EVENT = "event"  # each one counts: queued, bounded, never merged
    LATCHED = "latched"  # everybody remembers the newest, by its counter (armadico.core.latched)
    QUERY = "query"  # answered when asked


@dataclass(frozen=True)
class Service:
    """One row. `key` holds {instance}, {name} or {resource} where it differs between publishers."""

    message: type[m.Message]
    key: str
    kind: Kind
    rate_hz: float | None  # as promised by whoever provides it; None: as it happens
    fresh_cycles: int | None  # older than this in cycles is stale; None: no cycle, never stale
    meaning: str
    reply: type[m.Message] | None = None
    watchers_only: bool = False

    @property
    def pattern(self) -> str:
        """The key expression that catches every publisher's key."""
        return "/".join("*" if "{" in chunk else chunk for chunk in self.key.split("/"))

    @property
    def deadline_s(self) -> float | None:
        """The longest silence that the row allows, s; None: it may be silent for ever.

        Only what is published all the time has one: claims and commands end with a tenure. Where no
        freshness is promised it is two periods.
        """
        if self.kind is not Kind.STATE or self.rate_hz is None:
            return None
        return max((self.fresh_cycles or 0) * PERIOD, 2.0 / self.rate_hz)

    @property
    def tells_s(self) -> float:
        """A message older than this tells whoever looks on nothing of now, s."""
        return inf if self.deadline_s is None else max(self.deadline_s, QUIET_S)

    def key_for(self, **names: str) -> str:
        """The key of one publisher. Raises KeyError if a name is missing."""
        return self.key.format(**names)


_S, _E, _L, _Q = Kind.STATE, Kind.EVENT, Kind.LATCHED, Kind.QUERY

SERVICES: tuple[Service, ...] = (
    Service(m.RobotState, "robot/state", _S, 10, 3, "odometry, speeds, battery; moves the cycle"),
    Service(m.Description, "robot/description", _S, 1, None, "the robot's body and limits"),
    Service(m.Sonar, "robot/sonar", _S, 10, 3, "the sonars that fired since the cycle before"),
    Service(m.Scan, "robot/scan", _S, 10, 3, "the laser's newest scan"),
    Service(m.Stop, "robot/stop", _L, None, None, "latch or release the stop; anyone may"),
    Service(m.Pose, "encoder/pose", _S, 10, 3, "where the robot is, by its encoders"),
    Service(m.Origin, "encoder/origin", _L, 1, None, "where the odometry's origin lies"),
    Service(m.InitialPose, "encoder/initial", _E, None, None, "where the robot stands, by people"),
    Service(m.Correction, "localization/correction", _S, 10, 3, "where it lies by map and sonars"),
    Service(m.Particles, "localization/particles", _S, 2, 3, "places where the robot may be"),
    Service(m.Obstacles, "{name}/obstacles", _S, 10, 3, "what is near, by one sensor; body frame"),
    Service(m.LocalMap, "sonar/map", _S, 2, 3, "the local map's cells, for those who watch"),
    Service(m.OccupancyGrid, "mapping/grid", _S, 1, None, "the map made by driving"),
    Service(
        m.MapRequest, "mapping/request", _Q, None, None, "the same, now", reply=m.OccupancyGrid
    ),
    Service(m.Trajectory, "trajectory", _L, 1, None, "the mission's waypoints"),
    Service(m.PlanRequest, "path/plan", _Q, None, None, "a way to a goal", reply=m.Plan),
    Service(m.Planned, "path/planned", _E, None, None, "what the planner's holder asked for"),
    Service(
        m.MissionRequest, "mission/request", _Q, None, None, "go to a goal", reply=m.MissionReply
    ),
    Service(
        m.MissionStatus,
        "mission/status",
        _S,
        1,
        None,
        "how far the mission has come; 5 Hz under way",
    ),
    Service(
        m.ExploreRequest, "explore/request", _Q, None, None, "map a place", reply=m.MissionReply
    ),
    Service(m.ExploreStatus, "explore/status", _S, 1, None, "how far the exploration has come"),
    Service(m.Stick, "teleop/stick", _E, 10, 3, "where a hand has the stick"),
    Service(m.TeleopStatus, "teleop/status", _S, 1, 3, "whose hand drives; 10 Hz while one does"),
    Service(m.FleetPose, "fleet/{robot}/pose", _S, 5, None, "a robot, for the others to keep off"),
    Service(
        m.FleetPassages, "fleet/{robot}/passages", _E, 2, None, "narrow places that a robot holds"
    ),
    Service(m.FleetTasks, "fleet/tasks", _E, None, None, "the list that a fleet works on"),
    Service(m.FleetClaims, "fleet/{robot}/claims", _E, 1, None, "tasks that a robot holds; done"),
    Service(m.FleetRequest, "tasks/request", _Q, None, None, "do these tasks", reply=m.FleetReply),
    Service(m.FleetBoard, "tasks/board", _L, None, None, "the list, and what of it is done"),
    Service(m.FleetStatus, "tasks/status", _S, 1, None, "how far it is, and what the robot holds"),
    Service(m.HostShare, "wakeup/{instance}/share", _S, 1, None, "what a host keeps up, and could"),
    Service(
        m.WakeupRequest,
        "wakeup/{instance}",
        _Q,
        None,
        None,
        "start, restart or end an agent on a host",
        reply=m.WakeupReply,
    ),
    Service(m.MonitorReport, "monitor/{instance}", _S, 1, None, "who is missing, and who acts"),
    Service(m.BatteryLevel, "battery/level", _S, 0.2, None, "the battery; oftener towards 10 V"),
    Service(m.BatteryAlarm, "battery/alarm", _E, None, None, "it has to be charged soon"),
    Service(m.EnergyRequest, "battery/enough", _Q, None, None, "will it do?", reply=m.EnergyReply),
    Service(
        m.ChargeStatus, "battery/charging", _S, 1, 3, "what the charger does; 10 Hz in the dock"
    ),
    Service(m.ChargeRequest, "battery/charge", _Q, None, None, "charge it", reply=m.MissionReply),
    Service(m.Alarm, "alarm", _E, None, None, "an alarm in a room; anyone may say so"),
    Service(m.MissionOrder, "mission/order", _Q, None, None, "do a mission", reply=m.MissionReply),
    Service(
        m.MissionCancel, "mission/cancel", _Q, None, None, "leave one be", reply=m.MissionReply
    ),
    Service(
        m.MissionProposal,
        "mission/proposal",
        _Q,
        None,
        None,
        "the interface agent passes an order on",
        reply=m.MissionReply,
    ),
    Service(
        m.MissionWithdrawal,
        "mission/withdrawal",
        _Q,
        None,
        None,
        "and a cancellation",
        reply=m.MissionReply,
    ),
    Service(m.Board, "mission/board", _L, 1, None, "the missions, and how far they have come"),
    Service(m.SubplanRequest, "mission/subplan", _E, None, None, "asks the planner agents"),
    Service(m.Subplan, "mission/subplan/answer", _E, None, None, "what a planner agent would do"),
    Service(m.Photo, "mission/photo", _E, None, None, "a photo that a mission had taken"),
    Service(m.Claim, "resource/{resource}/utility", _E, 10, 3, "the holder's bid, made public"),
    Service(m.Ack, "resource/{resource}/ack", _S, 10, 3, "what the owner obeys and refuses by"),
    Service(m.Command, "resource/{resource}/cmd/{instance}", _E, 10, 3, "the holder's action"),
    Service(m.Command, "robot/cmd/{instance}", _E, 10, 3, "the same, for the wheels"),
    Service(m.Ask, "agent/{name}/{instance}/card", _Q, None, None, "who, where, what", m.Card),
    Service(m.Ask, "agent/{name}/{instance}/bids", _Q, None, None, "recent bids", m.BidHistory),
    Service(
        m.ParametersRequest,
        "agent/{name}/{instance}/parameters",
        _Q,
        None,
        None,
        "what may be changed live; change it",
        reply=m.ParametersReply,
    ),
    Service(m.ParameterChange, "agent/{name}/{instance}/changed", _E, None, None, "it was changed"),
    Service(
        m.AssistantRequest,
        "assistant/request",
        _Q,
        None,
        None,
        "a program asks for something",
        reply=m.AssistantReply,
    ),
    Service(m.AssistantRecord, "assistant/record", _E, None, None, "what a program asked for"),
    Service(m.Tuning, "tuning", _L, None, None, "all that was changed so, remembered"),
    Service(m.Log, "log/{instance}", _E, None, None, "lines for people"),
    Service(
        m.JournalPiece,
        "journal/{instance}",
        _E,
        None,
        None,
        "what enters and leaves an agent, if it was asked to keep it",
        watchers_only=True,
    ),
    Service(
        m.JournalRequest,
        "journal/{instance}/piece",
        _Q,
        None,
        None,
        "a piece of it again, while it is kept",
        reply=m.JournalPiece,
    ),
    Service(
        m.Truth, "sim/truth", _S, 10, None, "the simulated robot's true pose", watchers_only=True
    ),
)

_by_message: dict[type[m.Message], Service] = {
    service.message: service for service in SERVICES if service.message is not m.Ask
}

CARD = next(s for s in SERVICES if s.key.endswith("/card"))
BIDS = next(s for s in SERVICES if s.key.endswith("/bids"))
TOKEN = "agent/{name}/{instance}"
"""The liveliness token's key: who is alive."""


def register(service: Service) -> Service:
    """Add a row for a message of one's own. Raises ValueError if the message has one already."""
    known = _by_message.get(service.message)
    if known is not None and known != service:
        raise ValueError(f"{service.message.__name__} already travels on {known.key}")
    _by_message[service.message] = service
    return service


def service_of(message: type[m.Message]) -> Service:
    """The row of a message type. Raises KeyError with advice if there is none."""
    try:
        return _by_message[message]
    except KeyError:
        raise KeyError(
            f"{getattr(message, '__name__', message)!r} is no message with a row in the table of"
            " services; services.register adds one"
        ) from None


def rows_of(message: type[m.Message]) -> tuple[Service, ...]:
    """All rows of a message type; most have one. Raises KeyError if there is none."""
    rows = tuple(service for service in SERVICES if service.message is message)
    return rows or (service_of(message),)


def service_at(key: str) -> Service | None:
    """The row of the table that a key belongs to, at its resource's own rate; None: of no row."""
    service = _row_at(key)
    if service is None or "{resource}" not in service.key:
        return service
    resource = declared(key.split("/")[1])
    if resource is None:  # somebody else's, who alone knows how long its cycles are
        return replace(service, rate_hz=None)
    return service if resource.period_s is None else replace(service, rate_hz=1 / resource.period_s)


@cache
def _row_at(key: str) -> Service | None:
    return next((service for service in SERVICES if matches(service.pattern, key)), None)


def latched() -> tuple[Service, ...]:
    """The rows of all latched states that are known."""
    return tuple(s for s in _by_message.values() if s.kind is Kind.LATCHED)


def matches(pattern: str, key: str) -> bool:
    """Whether a key expression of whole chunks, `*` and `**` catches a key, or one of another's."""
    return _meet(pattern.split("/"), key.split("/"))


def _meet(one: list[str], other: list[str]) -> bool:
    if not (one and other):
        return all(chunk == "**" for chunk in one + other)
    if "**" in (one[0], other[0]):
        return _meet(one[1:], other) or _meet(one, other[1:])
    return (one[0] == other[0] or "*" in (one[0], other[0])) and _meet(one[1:], other[1:])
