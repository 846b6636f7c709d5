"""The states of SLAM: how the next scan is placed, and what else changes from scan to scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import inf
from typing import NamedTuple

import numpy as np

from armadico.agents.methods.poses import Floats
from armadico.agents.methods.scan_matching import PointCloud
from armadico.agents.slam.relocation import Recognised, Relocator


class Mode(Enum):
    """How the next scan is placed."""

    UNPLACED = "no scan has a place: the next one begins a part of the map"
    MAPPING = "key scans are added to the newest part of the map"
    FIXED = "scans are placed on the map, which stays as it is"
    LOST = "as FIXED, without a place: key scans are added to a temporary part, to find it"


class Event(Enum):
    """What a mode changes by."""

    ADDS = "a scan that may become a key scan of the map; the first scan always may"
    ADDS_NOT = "a scan by which the map must not change"
    LEFT = "several such scans in a row fit badly"
    OUTGROWN = "the temporary part has as many key scans as it may have"
    FOUND = "the place of the temporary part on the map was found"


class Step(Enum):
    """The action of a transition."""

    BEGIN = "begin a part with the scan"
    ADD = "match the scan on the map near it, and add it to the same part"
    MATCH = "match the scan on the map, and add nothing"
    DROP = "drop the temporary part"


TRANSITIONS: Mapping[tuple[Mode, Event], tuple[Mode, Step]] = {
    (Mode.UNPLACED, Event.ADDS): (Mode.MAPPING, Step.BEGIN),
    (Mode.UNPLACED, Event.ADDS_NOT): (Mode.LOST, Step.BEGIN),
    (Mode.MAPPING, Event.ADDS): (Mode.MAPPING, Step.ADD),
    (Mode.MAPPING, Event.ADDS_NOT): (Mode.FIXED, Step.MATCH),
    (Mode.FIXED, Event.ADDS): (Mode.MAPPING, Step.ADD),
    (Mode.FIXED, Event.ADDS_NOT): (Mode.FIXED, Step.MATCH),
    (Mode.FIXED, Event.LEFT): (Mode.LOST, Step.BEGIN),
    (Mode.LOST, Event.ADDS): (Mode.MAPPING, Step.ADD),  # the temporary part is one of the map
    (Mode.LOST, Event.ADDS_NOT): (Mode.LOST, Step.ADD),
    (Mode.LOST, Event.OUTGROWN): (Mode.UNPLACED, Step.DROP),
    (Mode.LOST, Event.FOUND): (Mode.FIXED, Step.DROP),
    (Mode.MAPPING, Event.FOUND): (Mode.FIXED, Step.DROP),  # sought while it was LOST
    (Mode.FIXED, Event.FOUND): (Mode.FIXED, Step.DROP),
}
"""All changes of the mode."""


@dataclass
class Odometer:
    """The newest scan's odometry."""

    t: float = -inf  # s
    at: Floats | None = None
    leapt: bool = False  # it jumped since the newest scan that was matched


@dataclass
class Placed:
    """The newest scan that was matched; made anew when a part of the map begins."""

    at: Floats  # the odometry then
    origin: tuple[float, float] = (0.0, 0.0)  # of the scanner
    loop_way: float = 0.0  # m driven at the newest loop, or where the part begins
    on: tuple[int, Floats] | None = None  # a key scan and the place on it; None: it is the newest
    covariance: Floats = field(default_factory=lambda: np.zeros((3, 3)))  # since the newest loop
    near: Floats = field(default_factory=lambda: np.zeros((3, 3)))  # on the map near it
    inliers: float = 1.0
    bad: int = 0  # newest scans on a fixed map that fitted badly


@dataclass
class Part:
    """The newest part of the map; made anew when one begins, and when the robot was carried."""

    begin: int = 0  # first key scan of the local map
    continues: bool = False  # whether key scans before that, which are near, are of it, too
    doubtful: list[int] = field(default_factory=list)  # newest ones without a match before these
    in_world: dict[int, PointCloud] = field(default_factory=dict)  # their clouds, where poses are
    relocators: dict[int, Relocator] = field(default_factory=dict)  # by part on which it is sought


@dataclass
class Backlog:
    """What the back end has done, and has to do."""

    searched: int = 0  # key scans for which loops were searched
    optimised: int = 0  # key scans at the newest optimisation
    new_loops: int = 0  # since then
    expected: list[int] = field(default_factory=list)  # edges of these that the chain explains
    moving: bool = False  # whether one of these moves the pose


@dataclass
class Proof:
    """The comparison of a part with the map that it was joined to."""

    first: int  # key scan of the part
    until: int  # key scan
    against: int = 0  # newest key scans that look through walls of the map


class Joined(NamedTuple):
    """A part of the map whose place was found."""

    label: int
    to: int  # the part that it becomes one with
    newest: Recognised
    cloud: PointCloud  # of that key scan: whether the part is still there
    temporary: bool  # it is dropped, since the map takes no more scans


class Moved(NamedTuple):
    """Optimised poses, for `Slam.adopt`."""

    poses: Floats
    joined: Joined | None = None

    def parts(self, present: int) -> tuple[tuple[int, ...], int]:
        """The parts that are one with the present one afterwards, and its number then."""
        if self.joined is None or self.joined.label != present:
            return (present,), present
        to = self.joined.to
        return ((to,) if self.joined.temporary else (present, to)), to
