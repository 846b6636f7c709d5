"""What each client may do, by one TOML file. Sans-IO: it is asked, and says why not.

A section says what is limited; what it does not name is not. A client's own section has the keys of
`[default]` that it does not state itself. docs/policy.md describes the keys.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from hashlib import sha256
from math import hypot, inf, isfinite
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec
from msgspec import Meta, Struct

from armadico.config.lines import line_of
from armadico.config.loading import Document, convert, document, read_text
from armadico.config.worlds import World, distance
from armadico.core.config_errors import ConfigError, ConfigNameError, ConfigValueError, advice
from armadico.core.messages import LARGEST
from armadico.watch.assistant.policy.area import Area, Place, Polygon, away, wrong_with
from armadico.watch.assistant.tools import TOOLS

LONGEST: Final = 1_000_000
"""Most bytes of a policy file."""

CORNERS: Final = 512
"""Most corners of a section's polygons together: each leg of each path is judged against all."""

ON_MAP_M: Final = 0.3
"""What is sensed this near to a wall of the map is the wall; what is farther away may be a person.
Sensors do not tell a person from a chair. A choice: the error of sonars and of a sure pose."""

BY_SONARS: Final = (
    "people_m is meant for robots with lasers only: echoes of sonars are counted as people, so"
    " drives are refused and cancelled although nobody is near"
)
"""An echo off the map's walls may be a person: it is not left out, so that the limit holds."""

SPARE_M: Final = 0.15
"""A path keeps so much more distance from the border than the robot needs, because behaviours do
not follow it exactly."""

NEARER_M: Final = 0.02
"""A robot that comes nearer by less than this does not come nearer: an echo differs by more."""

STOP: Final = "stop"
"""The tool that no policy limits."""

DRIVING: Final = ("goto", "mission")
"""The tools that set the robot in motion, so that they can need approval."""

BOUND: Final = frozenset({"move", "take-photo", "check-alarm", "wait"})
"""Tasks whose paths keep the terms of their mission. Others drive on paths of other agents."""

_HOURS: Final = re.compile(r"((?:[01]\d|2[0-3]):[0-5]\d)-((?:[01]\d|2[0-3]):[0-5]\d)\Z", re.ASCII)

DAYS: Final = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")

Corner = Annotated[tuple[float, ...], Meta(min_length=2, max_length=2)]
Corners = Annotated[tuple[Corner, ...], Meta(max_length=256)]
Polygons = Annotated[tuple[Corners, ...], Meta(min_length=1, max_length=64)]
Words = Annotated[tuple[str, ...], Meta(min_length=1, max_length=64)]
Lifted = Annotated[tuple[str, ...], Meta(max_length=64)]
"""Without any, a client's section lifts the rule of the default one."""
Day = Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """The limits of one client; None: there is none of that kind."""

    area: Polygons | None = None  # corners, m: where the robot may be
    rooms: Words | None = None  # the same, by rooms of the map
    keep_out: Polygons | None = None
    keep_out_rooms: Words | None = None
    v_max: Annotated[float, Meta(gt=0, le=100)] | None = None  # m/s
    people_m: Annotated[float, Meta(gt=0, le=10)] | None = None  # from the robot's edge
    hours: Words | None = None  # as "08:00-18:00", by the clock of the agent's computer
    days: Annotated[tuple[Day, ...], Meta(min_length=1, max_length=7)] | None = None
    goals_an_hour: Annotated[int, Meta(ge=0, le=10_000)] | None = None
    forbidden: Lifted | None = None  # tools
    approval: Lifted | None = None  # tools
    approval_rooms: Lifted | None = None  # a way into or through them


class _File(Struct, frozen=True, forbid_unknown_fields=True):
    default: Section
    clients: dict[Annotated[str, Meta(min_length=1, max_length=60)], Section] = {}


@dataclass(frozen=True)
class Rules:
    """The limits of one section, ready to be asked."""

    name: str  # the section's name
    section: Section  # what the file has, with the keys of `[default]`
    area: Area = field(default_factory=lambda: Area(()))  # where the robot may be
    # The rooms whose ways need approval, by name.
    asks: Mapping[str, Area] = field(default_factory=dict)
    # The distance of a place from the map's walls, m.
    barriers: Callable[[float, float], float] = lambda _x, _y: inf

    @property
    def bound(self) -> bool:
        """Whether the robot's motion is limited, so that each path has to keep it."""
        limits = self.section.v_max, self.section.people_m, self.section.hours, self.section.days
        within = not self.area.everywhere or bool(self.asks)
        return within or any(limit is not None for limit in limits)

    @property
    def keeps_off(self) -> bool:
        """Whether the robot has to keep a distance from what may be a person."""
        return self.section.people_m is not None

    @property
    def needs_path(self) -> bool:
        """Whether a path has to be known before the robot moves."""
        return not self.area.everywhere or self.keeps_off or bool(self.asks)

    def forbids(self, tool: str) -> str:
        """Why a tool is refused; "" if it is not."""
        if tool == STOP or tool not in (self.section.forbidden or ()):
            return ""
        return f"the policy ({self.name}) forbids {tool}"

    def closed(self, at: datetime) -> str:
        """Why nothing may be driven at a time of the local clock; "" if it may."""
        section, minute = self.section, 60 * at.hour + at.minute
        spans = [tuple(map(_minute, each.split("-"))) for each in section.hours or ()]
        day = DAYS[at.weekday()]
        if section.days is not None and day not in section.days:
            return f"it is {day}, and the policy ({self.name}) has {', '.join(section.days)}"
        if section.hours is None or any(_within(minute, begin, end) for begin, end in spans):
            return ""
        return f"it is {at:%H:%M}, and the policy ({self.name}) has {', '.join(section.hours)}"

    def outside(self, path: Sequence[Place], needs_m: float, what: str = "the path") -> str:
        """Why a path is refused that has to keep a distance from the border; "" if it is not."""
        place = self.area.leaves(path, needs_m)
        if place is None:
            return ""
        x, y = place
        how = "is outside" if not self.area.has(x, y) else f"is nearer than {needs_m:.2f} m to"
        of = "the area" if not self.area.has(x, y) else "the border of the area"
        return f"{what} {how} {of} of the policy ({self.name}) at ({x:.2f}, {y:.2f})"

    def strangers(self, points: Sequence[Place]) -> list[Place]:
        """The sensed places, in the world, where the map has no wall: perhaps people."""
        if self.section.people_m is None:
            return []
        return [(x, y) for x, y in points if self.barriers(x, y) > ON_MAP_M]

    def too_near(
        self,
        path: Sequence[Place],
        strangers: Sequence[Place],
        radius: float,
        here: Place | None = None,
    ) -> str:
        """Why a path, or a place, is too near to what may be a person; "" if it is not.

        A robot at `here` may always drive away from what is too near already.
        """
        least = self.section.people_m
        if least is None:
            return ""
        for x, y in strangers:
            off = away((x, y), path) - radius
            now = inf if here is None else hypot(here[0] - x, here[1] - y) - radius
            if off < min(least, now - NEARER_M):
                return (  # the least last but one: who cancels says no more than 128 characters
                    f"something on no map, perhaps a person, is {max(off, 0.0):.2f} m from the way,"
                    f" at ({x:.2f}, {y:.2f}): nearer than {least:g} m, by the policy ({self.name})"
                )
        return ""

    def unbound(self, does: Collection[str]) -> str:
        """Why a mission with these tasks is refused; "" if its paths keep them."""
        other = sorted({*does} - BOUND)
        if not self.bound or not other:
            return ""
        return f"the policy ({self.name}) limits drives, and {', '.join(other)} cannot be limited"

    def rooms_to_ask(self, path: Sequence[Place], half_width: float) -> tuple[str, ...]:
        """The rooms that need approval and that a robot of this half width, m, enters on a path."""
        return tuple(name for name, room in self.asks.items() if room.near(path, half_width))

    def asks_for(self, tool: str) -> bool:
        """Whether each use of a tool needs approval."""
        return tool in (self.section.approval or ())


class Policy:
    """The rules of all clients."""

    def __init__(
        self,
        default: Rules,
        clients: Mapping[str, Rules],
        text: str = "",
        world: World | None = None,
    ) -> None:
        self.default, self.clients = default, clients
        found = [] if world is None else [world.barriers, world.bounds, world.rooms]
        self.hash = sha256(text.encode() + msgspec.json.encode(found)).hexdigest()
        """Of the text and the map: under another one a place, and its approval, mean others."""

    def of(self, client: str) -> Rules:
        """The rules for the name that a client has announced."""
        return self.clients.get(client, self.default)

    @property
    def all(self) -> list[Rules]:
        return [self.default, *self.clients.values()]


NO_POLICY: Final = Policy(Rules("none", Section()), {})
"""Without a policy: what the assistant agent refuses by itself is all."""


def load(path: Path | str, world: World | None = None) -> Policy:
    """Read a policy file. Raises ConfigError.

    Its rooms are on the map `world`, which shows what is no person; None: no map.
    """
    return read(read_text(path, LONGEST), path, world)


def read(text: str, path: Path | str = "<text>", world: World | None = None) -> Policy:
    """Read the text of a policy file; see `load`."""
    raw = document(text, path)
    reader = _Reader(text, path, world)
    file = convert(raw, _File, path, text)
    own = {"default": file.default} | file.clients
    for name, section in own.items():
        reader.check(section, ("default",) if section is file.default else ("clients", name))
    shared: Document = raw["default"]  # type: ignore[assignment]  # a table: it was converted
    given: dict[str, Document] = raw.get("clients", {})  # type: ignore[assignment]  # the same
    clients = {
        name: reader.rules(name, convert({**shared, **each}, Section, path, text))
        for name, each in given.items()
    }
    return Policy(reader.rules("default", file.default), clients, text, world)


class _Reader:
    """Checks sections against the tools and the map, and makes rules of them."""

    def __init__(self, text: str, path: Path | str, world: World | None) -> None:
        self._text, self._path, self._world = text, path, world

    def check(self, section: Section, at: tuple[str, ...]) -> None:
        """Raise ConfigError for a value that means nothing."""
        self._check_numbers(section, at)
        self._check_names(section, at)
        if section.people_m is not None and self._world is None:
            raise self._error((*at, "people_m"), "no map is known, so each wall could be a person")
        for hours in section.hours or ():
            span = _HOURS.match(hours)
            if span is None or span[1] == span[2]:
                raise self._value((*at, "hours"), hours, "a begin and an end, as 08:00-18:00")

    def _check_numbers(self, section: Section, at: tuple[str, ...]) -> None:
        for key in ("v_max", "people_m"):
            value = getattr(section, key)
            if value is not None and not isfinite(value):
                raise self._value((*at, key), value, "a number")
        count = sum(map(len, (section.area or ()) + (section.keep_out or ())))
        if count > CORNERS:
            key = "area" if section.area else "keep_out"
            raise self._error(
                (*at, key), f"expected at most {CORNERS} corners in all polygons, not {count}"
            )
        for key in ("area", "keep_out"):
            for index, polygon in enumerate(getattr(section, key) or ()):
                for corner in polygon:
                    if not all(abs(each) <= LARGEST for each in corner):  # also of NaN
                        raise self._value((*at, key), list(corner), "two numbers, m")
                if wrong := wrong_with(_polygon(polygon)):
                    raise self._error((*at, key), wrong, f"[{index}]")

    def _check_names(self, section: Section, at: tuple[str, ...]) -> None:
        if STOP in (section.forbidden or ()) + (section.approval or ()):
            raise self._error(at, f"{STOP!r}: a stop is never limited; take it out")
        known = [tool for tool in TOOLS if tool != STOP]
        self._known(section, at, "forbidden", "tool", known)
        self._known(section, at, "approval", "tool", DRIVING)
        rooms = [] if self._world is None else [room.name for room in self._world.rooms]
        for key in ("rooms", "keep_out_rooms", "approval_rooms"):
            if getattr(section, key) is not None and not rooms:
                what = "no map is known" if self._world is None else "the map has no rooms"
                raise self._error((*at, key), f"{what}; expected polygons in `area` or `keep_out`")
            self._known(section, at, key, "room", rooms)

    def _error(self, path: tuple[str, ...], what: str, more: str = "") -> ConfigError:
        return ConfigError(f"{'.'.join(path)}{more}: {what}", self._path, self._line(path))

    def _known(
        self, section: Section, at: tuple[str, ...], key: str, kind: str, known: Sequence[str]
    ) -> None:
        for name in getattr(section, key) or ():
            if name not in known:
                text = f"{'.'.join((*at, key))}: no {kind} {name!r}; {advice(name, known)}"
                line = self._line((*at, key))
                raise ConfigNameError(kind, name, known, self._path, line, text)

    def _value(self, path: tuple[str, ...], value: object, allowed: str) -> ConfigError:
        return ConfigValueError(".".join(path), value, allowed, self._path, self._line(path))

    def _line(self, path: tuple[str, ...]) -> int | None:
        return line_of(self._text, path)

    def rules(self, name: str, section: Section) -> Rules:
        """The rules of a section that was checked."""
        inside = [*map(_polygon, section.area or ()), *self._rooms(section.rooms).values()]
        outside = [*map(_polygon, section.keep_out or ())]
        outside += self._rooms(section.keep_out_rooms).values()
        asks = {name: Area([room]) for name, room in self._rooms(section.approval_rooms).items()}
        return Rules(name, section, Area(inside, outside), asks, self._barriers)

    def _rooms(self, names: Sequence[str] | None) -> dict[str, Polygon]:
        rooms = {} if self._world is None else {room.name: room for room in self._world.rooms}
        found = {name: rooms[name] for name in names or ()}
        return {
            name: [(room.x1, room.y1), (room.x2, room.y1), (room.x2, room.y2), (room.x1, room.y2)]
            for name, room in found.items()
        }

    def _barriers(self, x: float, y: float) -> float:
        assert self._world is not None, "checked with people_m"
        return min((distance(x, y, each) for each in self._world.outlines), default=inf)


def _polygon(corners: Corners) -> Polygon:
    return [(x, y) for x, y in corners]


def _minute(time: str) -> int:
    hours, minutes = time.split(":")
    return 60 * int(hours) + int(minutes)


def _within(minute: int, begin: int, end: int) -> bool:
    """Whether a minute of the day is in a span, which may go over midnight."""
    return begin <= minute < end if begin < end else minute >= begin or minute < end
