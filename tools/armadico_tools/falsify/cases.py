"""A situation as data: a hostile holder, people, delays, lost readings; from a vector of numbers.

The search works in the unit cube; `Setting.case` maps a point of it to a case that can be driven.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import cos, hypot, pi, sin, tau
from random import Random
from typing import Annotated, Final

import msgspec
from msgspec import Meta, Struct

from armadico.config.profile import load_profile
from armadico.config.worlds import World, hull, load_world
from armadico.core.config_errors import ConfigError

WORLDS: Final = ("rooms-a", "rooms-b", "offices", "house", "hall")

PHASES: Final = 6
"""Commands of the holder, one after the other."""

PEOPLE: Final = 2
"""At most."""

GAIN: Final = 2.0
"""The strongest turn towards what is nearest, rad/s per rad."""

DELAY_S: Final = 0.25
"""The longest delay of the holder's commands: later ones are rejected."""

DROPOUT: Final = 0.3
"""The largest share of readings that are lost."""

WALKS_M_S: Final = (0.3, 1.5)
PERSON_M: Final = 0.25
ROOM_M: Final = 0.1
"""At the start there is so much more room than the robot needs to turn."""

RING_M: Final = 0.1
"""Step of the search for a place with room."""

SIZE: Final = 3 + 2 * PHASES + 3 + 3 * PEOPLE
"""Numbers of a case."""

Real = Annotated[float, Meta(ge=-1e4, le=1e4)]


class Case(Struct, frozen=True, omit_defaults=True):
    """A run that can be repeated exactly. Lengths in m, angles in rad, times in s.

    `commands` are (v, w) in m/s and rad/s, each for an equal part of the time. `towards` is added
    to w for each rad to what is nearest. `people` are x, y and speed; they do not heed the robot.
    """

    robot: str
    world: str
    seed: int
    lasts: Annotated[float, Meta(gt=0, le=600)]
    start: tuple[Real, Real, Real]
    commands: Annotated[tuple[tuple[Real, Real], ...], Meta(min_length=1, max_length=1000)]
    towards: Real = 0.0
    delay: Annotated[float, Meta(ge=0, le=10)] = 0.0
    dropout: Annotated[float, Meta(ge=0, le=1)] = 0.0
    people: tuple[tuple[Real, Real, Annotated[float, Meta(gt=0, le=3)]], ...] = ()

    def dumps(self) -> str:
        """The case as one line of JSON."""
        return msgspec.json.encode(self).decode()


def loads(text: str | bytes) -> Case:
    """A case from its JSON. Raises ConfigError."""
    try:
        return msgspec.json.decode(text, type=Case)
    except msgspec.DecodeError as error:
        raise ConfigError(f"not a case of armadico falsify: {error}") from None


class Setting(Struct, frozen=True):
    """What one search keeps fixed."""

    robot: str
    world: str
    seed: int
    lasts: float
    people: int

    def case(self, at: Sequence[float]) -> Case:
        """The case at a point of the unit cube. Places without room are moved to the nearest."""
        world, profile = load_world(self.world), load_profile(self.robot)
        numbers = iter(at)
        room = profile.body.circle_m + ROOM_M
        start = (*_free(world, next(numbers), next(numbers), room), tau * next(numbers) - pi)
        v_max, w_max = profile.limits.v_max, profile.limits.w_max
        commands = tuple(
            (v_max * (2.0 * next(numbers) - 1.0), w_max * (2.0 * next(numbers) - 1.0) ** 3)
            for _ in range(PHASES)
        )
        towards = GAIN * next(numbers)
        delay, dropout = DELAY_S * next(numbers), DROPOUT * next(numbers)
        people = []
        for _ in range(self.people):
            place = _free(world, next(numbers), next(numbers), PERSON_M + ROOM_M)
            speed = WALKS_M_S[0] + (WALKS_M_S[1] - WALKS_M_S[0]) * next(numbers)
            if hypot(place[0] - start[0], place[1] - start[1]) > room + PERSON_M + ROOM_M:
                people.append((*place, speed))
        return Case(
            self.robot,
            self.world,
            self.seed,
            self.lasts,
            start,
            commands,
            towards,
            delay,
            dropout,
            tuple(people),
        )


def setting(robot: str, worlds: Sequence[str], seed: int, lasts: float) -> Setting:
    """The setting of a seed: a world, and how many people are in it."""
    rng = Random(f"falsify/{seed}")
    return Setting(robot, rng.choice(worlds), seed, lasts, rng.randint(0, PEOPLE))


def _free(world: World, x: float, y: float, room: float) -> tuple[float, float]:
    """A place with room, near to shares of the world's width and height.

    Raises ConfigError if there is none.
    """
    x1, y1, x2, y2 = hull(world.walls)
    at = x1 + x * (x2 - x1), y1 + y * (y2 - y1)
    for place in _rings(at, hypot(x2 - x1, y2 - y1)):
        if world.inside(*place) and world.clearance(*place) >= room:
            return place
    raise ConfigError(f"world {world.name!r} has no place with {room:.2f} m of room")


def _rings(at: tuple[float, float], far: float) -> Iterator[tuple[float, float]]:
    """Places around one, the nearest first."""
    yield at
    for ring in range(1, int(far / RING_M) + 1):
        for k in range(6 * ring):
            angle = tau * k / (6 * ring)
            yield at[0] + RING_M * ring * cos(angle), at[1] + RING_M * ring * sin(angle)
