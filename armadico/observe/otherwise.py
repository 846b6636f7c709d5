"""What would have been decided otherwise, as a picture: both utilities, both speeds, both paths.

The other path is what the speeds that were ordered otherwise would have made of the one that was
driven, moment by moment. The loop is open: nobody sees there what the robot would have seen.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import nan
from typing import Any

from msgspec import msgpack

from armadico.core import journal as j
from armadico.core.messages import Action, BidRecord, RobotState
from armadico.core.resources import WHEELS
from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import Pose
from armadico.observe.recordings import Row
from armadico.observe.replay import Replay

MOST_S = 0.5
"""Poses that are further apart are no motion."""

Cycle = tuple[int, int]
"""Epoch and number."""

Traced = tuple[float, float]
"""A time, s since the recording began, and a value; NaN: there is none."""


@dataclass
class Wanted:
    """What one agent wanted of the wheels, and ordered, then and now."""

    name: str
    utilities_then: list[Traced] = field(default_factory=list)
    utilities_now: list[Traced] = field(default_factory=list)
    speeds_then: list[Traced] = field(default_factory=list)  # wanted ones, m/s
    speeds_now: list[Traced] = field(default_factory=list)
    ordered: dict[Cycle, tuple[Sequence[float], Sequence[float]]] = field(default_factory=dict)
    """By cycle the speeds that it ordered then and now (m/s, rad/s), where it did both."""


@dataclass
class Seen:
    """What a recording says of one robot."""

    began: float  # when it begins, s since 1970
    poses: list[tuple[float, Cycle, Pose2]] = field(default_factory=list)
    bids: dict[str, list[tuple[float, BidRecord]]] = field(default_factory=dict)  # by instance
    at: dict[Cycle, float] = field(default_factory=dict)  # when a cycle of the robot's began

    @classmethod
    def of(cls, rows: Iterable[Row], namespace: str, began: float) -> Seen:
        """From the messages of a recording. Raises MessageError."""
        seen = cls(began)
        for row in rows:
            if row.namespace == namespace and row.schema in _SHOWN:
                seen.take(row)
        return seen

    def take(self, row: Row) -> None:
        t, message = row.t / 1e9 - self.began, row.message
        if isinstance(message, RobotState):
            self.at.setdefault(_cycle(message.cycle), t)
        elif isinstance(message, Pose):
            self.poses.append((t, _cycle(message.cycle), (message.x, message.y, message.theta)))
        elif isinstance(message, BidRecord) and message.resource == WHEELS.name:
            self.bids.setdefault(row.key.split("/")[2], []).append((t, message))


_SHOWN = frozenset(f"armadico.{kind.__name__}" for kind in (RobotState, Pose, BidRecord))


def wanted(replay: Replay, seen: Seen) -> Wanted:
    """Go through a replay, beside what a recording says of it."""
    found = Wanted(replay.journal.name)
    for t, bid in seen.bids.get(replay.journal.instance, ()):
        at = seen.at.get(_cycle(bid.cycle), t)  # asked for later, it is of that cycle
        found.utilities_then.append((at, _utility(bid)))
        found.speeds_then.append((at, _speed(bid.wanted)))
    for moment in replay.moments():
        at = replay.began + moment.at - seen.began
        for bid in moment.bids:
            if bid.resource == WHEELS.name:
                found.utilities_now.append((at, _utility(bid)))
                found.speeds_now.append((at, _speed(bid.wanted)))
        then, now = dict(_orders(moment.then)), dict(_orders(moment.now))
        found.ordered |= {c: (then[c], now[c]) for c in then.keys() & now.keys()}
    for traced in (found.utilities_then, found.speeds_then):
        traced.sort(key=lambda item: item[0])
    return found


def other_path(seen: Seen, of: Sequence[Wanted]) -> list[Pose2]:
    """Where what was ordered otherwise would have led, roughly; poses in m, m and rad."""
    if not seen.poses:
        return []
    ordered = {cycle: both for one in of for cycle, both in one.ordered.items()}
    path = [seen.poses[0][2]]
    for (t0, cycle, before), (t1, _, after) in pairwise(seen.poses):
        dx, dy, turn = relative(before, after)
        dt = t1 - t0
        if cycle in ordered and 0.0 < dt < MOST_S:
            then, now = ordered[cycle]
            dx += (now[0] - then[0]) * dt
            turn += (now[1] - then[1]) * dt
        path.append(compose(path[-1], (dx, dy, turn)))
    return path


def _orders(outputs: bytes | None) -> Iterator[tuple[Cycle, Sequence[float]]]:
    """The speeds that outputs of a journal order, by cycle."""
    items: list[Any] = msgpack.decode(outputs) if outputs else []
    for item in items:
        match item:
            case [j.PUBLISH, str(key), [_, [epoch, number], _, [_, _] as action, *_]]:
                if key.startswith("robot/cmd/"):
                    yield (epoch, number), action


def _cycle(cycle: Any) -> Cycle:
    return cycle.epoch, cycle.number


def _utility(bid: BidRecord) -> float:
    return nan if bid.utility is None else bid.utility


def _speed(action: Action) -> float:
    return nan if isinstance(action, bytes) or not action else action[0]
