"""Places by name, for people and programs: a world's rooms, goals and docks, and added ones.

Added places are kept in a TOML file: beside a map of the user's (`office.map`, then
`office.places.toml`), for a shipped world in the user's data folder.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import StrEnum
from functools import cached_property
from math import degrees, isfinite, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from msgspec import Meta, Struct

from armadico.config.loading import load_table
from armadico.config.shipped import find
from armadico.config.worlds import World, before, load_world
from armadico.config.writing import locked, write_files
from armadico.core.config_errors import ConfigError, ConfigNameError, advice
from armadico.core.messages import LARGEST

if TYPE_CHECKING:
    from armadico.config.places import Places

DATA_VARIABLE: Final = "XDG_DATA_HOME"

DEFAULT_ROBOT: Final = "pioneer-2dx"  # whose body is assumed if the robot is not known

LONGEST: Final = 60  # characters of a name

MOST: Final = 1000  # added places of one world

_NUMBER: Final = re.compile(r"[-+]?(\.?\d|(inf|infinity|nan)$)", re.IGNORECASE)

HERE: Final = "here"  # means the robot's pose on the command line, so no place has this name

Metres = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Degrees = Annotated[float, Meta(ge=-360, le=360)]


class Sort(StrEnum):
    """What a name stands for."""

    ROOM = "room"  # its point where the robot can turn
    GOAL = "goal"
    DOCK = "dock"  # the pose in front of it: the dock agent drives in
    ADDED = "added"


class Named(Struct, frozen=True):
    """A place: x, y in m and a heading in rad; None: any."""

    name: str
    sort: Sort
    x: float
    y: float
    heading: float | None = None


class _Added(Struct, frozen=True, forbid_unknown_fields=True):
    """An added place in its file: m, m, degrees."""

    x: Metres
    y: Metres
    heading: Degrees | None = None


class Gazetteer:
    """The named places of one world, for one robot. The file is read anew whenever it is asked."""

    def __init__(self, world: str | Path, robot: str | Path = DEFAULT_ROBOT) -> None:
        """The world and the robot's profile, by name or path. Raises ConfigError."""
        path = find("worlds", world)
        self.world: World = load_world(world)  # the world
        self.source = str(world)  # its name or path
        self.file = _file(path)  # the file of added places, which need not exist
        self._robot = robot

    @property
    def places(self) -> list[Named]:
        """All places, by name; rooms in which the robot cannot turn are left out.

        Raises ConfigError if the file of added places is invalid.
        """
        found = list(self._of_world)
        taken = {place.name.casefold() for place in found}
        added = self._added()
        found += (
            Named(name, Sort.ADDED, at.x, at.y, None if at.heading is None else radians(at.heading))
            for name, at in added.items()
            if name.casefold() not in taken  # the map has changed since; its own names count
        )
        return sorted(found, key=lambda place: place.name.casefold())

    def of(self, name: str) -> Named:
        """The place of a name; upper and lower case do not matter unless two differ by it alone.

        Raises ConfigNameError for an unknown name, with the nearest that is known.
        """
        places = self.places
        folded = [place for place in places if place.name.casefold() == name.casefold()]
        exact = [place for place in folded if place.name == name]
        if exact or len(folded) == 1:
            return (exact or folded)[0]
        known = [place.name for place in places]
        message = f"no place {name!r} in {self.world.name!r}; {advice(name, known)}"
        raise ConfigNameError("place", name, known, message=message)

    def add(self, name: str, at: tuple[float, float, float | None]) -> None:
        """Add a place, x and y in m and a heading in rad. Raises ConfigError or OSError."""
        check_name(name)
        x, y, heading = at
        if not all(map(isfinite, (x, y, heading or 0.0))) or max(abs(x), abs(y)) > LARGEST:
            raise ConfigError(f"place {name!r}: expected finite numbers, at most {LARGEST:g} m")
        if self.world.outlines and not self.world.inside(x, y):
            x1, y1, x2, y2 = self.world.bounds
            raise ConfigError(
                f"place {name!r}: ({x:g}, {y:g}) is outside {self.world.name!r}, which is x"
                f" {x1:g} to {x2:g} m and y {y1:g} to {y2:g} m"
            )
        if self.world.clearance(x, y) <= 0.0:
            raise ConfigError(f"place {name!r}: ({x:g}, {y:g}) is in a wall")
        with self._changing() as added:
            taken = {place.name.casefold(): place for place in self.places}
            if (other := taken.get(name.casefold())) is not None:
                raise ConfigError(
                    f"the name {name!r} is taken: {other.name!r} is {_article(other.sort)} at"
                    f" ({other.x:g}, {other.y:g}); `armadico places remove` removes added ones"
                )
            if len(added) >= MOST:
                raise ConfigError(f"{self.file} has {MOST} places; remove one")
            turned = None if heading is None else round(degrees(heading), 2)
            added[name] = _Added(round(x, 4), round(y, 4), turned)

    def remove(self, name: str) -> None:
        """Remove an added place. Raises ConfigError or OSError."""
        with self._changing() as added:
            if name not in added:
                place = self.of(name)
                if place.sort is not Sort.ADDED:
                    raise ConfigError(
                        f"{place.name!r} is {_article(place.sort)} of the map: edit the map"
                    )
                name = place.name
            del added[name]

    # Inside --------------------------------------------------------------------------------------

    @cached_property
    def _of_world(self) -> tuple[Named, ...]:
        from armadico.config.places import Places
        from armadico.config.profile import load_profile

        where = Places(self.world, load_profile(self._robot).body)
        found = [Named(name, Sort.DOCK, *before(pose)) for name, pose in self.world.docks.items()]
        found += self._named(where)
        names = dict[str, Named]()
        for place in found:  # a goal in a dock's or a room's place is what the map's author meant
            names[place.name] = place
        return tuple(names.values())

    def _named(self, where: Places) -> Iterator[Named]:
        for name in where.names:
            with suppress(ConfigError):  # a room in which the robot cannot turn
                sort = Sort.GOAL if name in self.world.goals else Sort.ROOM
                yield Named(name, sort, *where.of(name))

    def _added(self) -> dict[str, _Added]:
        return load_table(self.file, _Added) if self.file.exists() else {}

    @contextmanager
    def _changing(self) -> Iterator[dict[str, _Added]]:
        """The added places, which are written when the block ends; one process at a time."""
        folder = self.file.parent
        if not folder.exists():
            folder.mkdir(parents=True, exist_ok=True)
        with locked(folder):
            added = self._added()
            yield added
            write_files({self.file: _text(self.world.name, added).encode()})


def check_name(name: str) -> None:
    """Raises ConfigError for a name that people could not type, or would take for numbers."""
    if not name or len(name) > LONGEST:
        raise ConfigError(f"a place's name has 1 to {LONGEST} characters (got {len(name)})")
    if not name.isprintable() or name != " ".join(name.split()):
        raise ConfigError(
            f"place {name!r}: expected printable characters, with single spaces within only"
        )
    if name.startswith("-") or like_number(name) or name == HERE:
        raise ConfigError(f"place {name!r}: a name does not begin like a number, and is not {HERE}")


def like_number(word: str) -> bool:
    """Whether a word begins as a number does, so that it is no name."""
    return _NUMBER.match(word) is not None


def _article(sort: Sort) -> str:
    return "an added place" if sort is Sort.ADDED else f"a {sort}"


def _file(world: Path) -> Path:
    """The file of a world's added places."""
    shipped = find("worlds", "empty").parent
    if world.parent.resolve() != shipped.resolve():
        return world.with_name(f"{world.stem}.places.toml")
    return data_folder() / "places" / f"{world.stem}.places.toml"


def data_folder() -> Path:
    """The user's folder of Armadico's data. Raises RuntimeError for a user without a home."""
    base = Path(os.environ.get(DATA_VARIABLE, ""))
    data = base if base.is_absolute() else Path.home() / ".local" / "share"
    return data / "armadico"


def _text(world: str, added: dict[str, _Added]) -> str:
    """The file's text: a table for each place. A JSON string of printable text is one of TOML."""
    lines = [f"# Places that were added to the world {world}: m, m, degrees."]
    for name, at in added.items():
        lines += ["", f"[{json.dumps(name, ensure_ascii=False)}]", f"x = {at.x}", f"y = {at.y}"]
        lines += [] if at.heading is None else [f"heading = {at.heading}"]
    return "\n".join(lines) + "\n"
