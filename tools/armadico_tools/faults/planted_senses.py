"""Planted defects of what the robot senses, of its map, and of the reflex that uses both.

Unlike most of `planted`, they change what is used in the process itself, not only what it
publishes. So the robot drives by what it publishes, and no two messages contradict each other.
"""

from __future__ import annotations

from math import inf, radians
from typing import Any, Final

import numpy as np
from msgspec.structs import replace

from armadico.config.worlds import Segment
from armadico.mobile.geometry import Pose2, compose
from armadico.mobile.messages import Correction, Echo, Scan, Sonar
from armadico.mobile.scans import bearings_of, packed, ranges_of
from armadico_tools.faults.planting import Defect, Late, publishes, wrap

DEAF: Final = 2
DEAF_RAD: Final = radians(20)
"""So many sonars are deaf, and the rays of a laser within this of straight ahead."""

SONAR_CYCLES, SCAN_CYCLES = 4, 3
"""So many cycles late are the readings of a sonar, and of a laser."""

RATE: Final = 0.5
TURNED_RAD: Final = radians(5)
SHIFTED_M: Final = 0.3


def _reads(robot: Any, sonar: Any, scan: Any) -> None:
    """Change what the robot agent reads."""
    readings = robot._readings

    def update(method: Any, *given: Any) -> None:
        method(*given)
        if readings.sonar is not None:
            readings.sonar = sonar(readings.sonar)
        if readings.scan is not None:
            readings.scan = scan(readings.scan)

    wrap(readings, "update", update)


def without(scan: Scan, hidden: Any) -> Scan:
    """A scan whose rays at hidden bearings, by a function of them all, read nothing."""
    ranges = np.where(hidden(bearings_of(scan)), inf, ranges_of(scan))
    return replace(scan, packed=packed(ranges, 0.0, scan.reach))


def _is_deaf(robot: Any) -> None:
    ring = robot.profile.sonar
    places = () if ring is None else sorted(abs(each.place[2]) for each in ring.sonars)
    ahead = places[min(DEAF, len(places)) - 1] if places else 0.0

    def heard(sonar: Sonar) -> Sonar:
        echoes = (
            replace(each, range=None) if abs(each.bearing) <= ahead else each
            for each in sonar.echoes
        )
        return replace(sonar, echoes=tuple(echoes))

    def hidden(bearings: Any) -> Any:
        return np.abs((bearings + np.pi) % (2.0 * np.pi) - np.pi) < DEAF_RAD

    _reads(robot, heard, lambda scan: without(scan, hidden))


def _reads_late(robot: Any) -> None:
    sonars, scans = Late[Sonar](SONAR_CYCLES), Late[Scan](SCAN_CYCLES)

    _reads(
        robot,
        lambda sonar: replace(sonars.of(sonar), cycle=sonar.cycle),
        lambda scan: replace(scans.of(scan), cycle=scan.cycle),
    )


def _turns_less(robot: Any) -> None:
    def report(method: Any, reported: Any) -> None:
        method(replace(reported, w=RATE * reported.w))

    wrap(robot, "_report", report)


def without_reflex(robot: Any) -> None:
    """Let every command through."""
    robot.p = replace(robot.p, reflex=False)


def _half_reflex(robot: Any) -> None:
    def update(method: Any, echoes: Any, pose: Any, measured: Any, now: Any, *others: Any) -> None:
        scan, driven = others
        left: tuple[Echo, ...] = tuple(each for each in echoes if each.bearing > 0.0)
        if scan is not None:
            scan = without(scan, lambda bearings: np.sin(bearings) < 0.0)
        method(left, pose, measured, now, scan, driven)

    wrap(robot._reflex, "update", update)


def _stale_reflex(robot: Any) -> None:
    reflex = robot._reflex

    def update(method: Any, *given: Any) -> None:
        view = reflex._view
        method(*given)
        reflex._view = view

    wrap(reflex, "update", update)


def _forgetful_reflex(robot: Any) -> None:
    seen = robot._reflex._seen

    def update(method: Any, *given: Any) -> None:
        seen._echoed, seen._scanned = seen._echoed[:0], seen._scanned[:0]
        method(*given)

    wrap(seen, "update", update)


def _turns_map(localization: Any) -> None:
    """As if its map were turned about the world's origin."""

    def change(found: Correction) -> Correction:
        turned: Pose2 = compose((0.0, 0.0, TURNED_RAD), (found.x, found.y, found.theta))
        return replace(found, x=turned[0], y=turned[1], theta=turned[2])

    publishes(localization, Correction, change)


def _shifts_walls(planner: Any) -> None:
    world = planner._world
    if world is None:
        return

    def moved(wall: Segment) -> Segment:
        x1, y1, x2, y2 = wall
        return x1 + SHIFTED_M, y1 + SHIFTED_M, x2 + SHIFTED_M, y2 + SHIFTED_M

    planner._world = replace(world, walls=tuple(map(moved, world.walls)))


SENSES: Final = {
    "deaf": Defect("the sensors straight ahead read nothing", {"robot": _is_deaf}),
    "late-readings": Defect(
        f"readings are {SONAR_CYCLES} cycles old (a laser's {SCAN_CYCLES})", {"robot": _reads_late}
    ),
    "half-turn": Defect(f"turns are measured at {RATE:g} times their rate", {"robot": _turns_less}),
    "reflex-off": Defect("the reflex lets all through", {"robot": without_reflex}),
    "reflex-half": Defect("the reflex uses the left's readings only", {"robot": _half_reflex}),
    "reflex-stale": Defect("the reflex keeps to its first view", {"robot": _stale_reflex}),
    "reflex-forgets": Defect(
        "the reflex knows the newest readings only", {"robot": _forgetful_reflex}
    ),
    "turned-map": Defect("the map of the localization is turned", {"localization": _turns_map}),
    "shifted-walls": Defect(
        f"the planner's walls are shifted by {SHIFTED_M:g} m", {"path-planning": _shifts_walls}
    ),
}
