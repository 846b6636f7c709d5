"""What happened while a map was made, and why the map may be wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from armadico.agents.methods.slices import Sliced
from armadico.agents.slam.consistency import (
    ConsistencyParameters,
    Contradiction,
    Deviation,
    contradictions,
    most_uncertain,
)
from armadico.agents.slam.key_map import KeyMap
from armadico.agents.slam.states import Proof

CHECKED_SCANS: Final = 50
"""The map is checked again when it has grown by so many key scans,"""

CHECKED_SHARE: Final = 0.5
"""and by this share."""


@dataclass
class Evidence:
    """Events that were counted, and the results of the newest check."""

    weak: int = 0  # key scans that fitted badly
    rejected: int = 0  # scans that could not be used
    carried: list[int] = field(default_factory=list)  # key scans before which the robot was carried
    leaps: list[int] = field(default_factory=list)  # key scans before which the odometry jumped,
    leaps_unmatched: int = 0  # of these, without a good match
    relocations: int = 0  # times that the place of a part was found
    proof: Proof | None = None  # of the place of the newest of these parts
    contradicted: bool = False  # later scans looked through walls of the map at such a place
    contradictions: list[Contradiction] = field(default_factory=list)  # as checked last
    deviation: Deviation | None = None  # of the place that is known least, likewise
    checked: tuple[int, int] = 0, 0  # key scans and revision of the newest check

    def due(self, scans: KeyMap) -> bool:
        """Whether the map has grown, or was found doubtful and has moved since."""
        (count, revision), now = self.checked, len(scans)
        grown = now - count >= max(CHECKED_SCANS, CHECKED_SHARE * count)
        return grown or (bool(self.contradictions) and scans.revision > revision)

    def checking(
        self, scans: KeyMap, parts: int, origin: tuple[float, float], p: ConsistencyParameters
    ) -> Sliced[None]:
        """Hold all scans of each part against its walls; find the place that is known least."""
        poses, part = scans.poses, scans.part
        way, clouds, edges = list(scans.way), list(scans.clouds), list(scans.graph.edges)
        weights, self.checked, found = scans.graph.weights, (len(poses), scans.revision), []
        for label in np.unique(part).tolist():
            of = np.flatnonzero(part == label).tolist()
            which = [way[k] for k in of], [clouds[k] for k in of]
            found += yield from contradictions(poses[of], *which, origin, p)
        self.contradictions = sorted(found, key=lambda one: -one.length)
        self.deviation = None
        if parts == 1 and len(poses):
            self.deviation = yield from most_uncertain(poses, way, edges, weights)

    def reasons(self, scans: KeyMap, parts: int, most: ConsistencyParameters) -> str:
        """Why a map of so many parts may be wrong; empty if nothing speaks against it."""
        reasons = []
        if parts > 1:
            carried = f" (the robot was carried {len(self.carried)} times)" if self.carried else ""
            reasons.append(f"the places of its {parts} parts to each other are unknown{carried}")
        if self.contradicted:
            reasons.append("what is seen contradicts the place that was found on the map")
        reasons += _contradicted(self.contradictions)
        worst = self.deviation
        if worst is not None and worst.metres > most.deviation and worst.chain > most.chain:
            metres, way, chain = worst
            reasons.append(
                f"the place that was reached after {way:.0f} m is known to +-{metres:.0f} m only,"
                f" by the surest way of {chain:.0f} m from the start: loops are missing"
            )
        if self.leaps_unmatched:
            reasons.append(
                f"the odometry jumped {len(self.leaps)} times, {self.leaps_unmatched} times where"
                " scans did not tell the motion"
            )
        if (off := scans.loops_off) * 2 > len(scans.loops):
            reasons.append(f"{off} of {len(scans.loops)} loops contradict the others")
        if self.weak * 10 > len(scans):
            reasons.append(f"{self.weak} of {len(scans)} key scans fit badly")
        return "; ".join(reasons)


def _contradicted(places: Sequence[Contradiction]) -> list[str]:
    """The reason that they are, if there are any."""
    if not places:
        return []
    x, y, length, _ = places[0]
    more = f" and at {len(places) - 1} more places" if len(places) > 1 else ""
    where = f"at ({x:.1f}, {y:.1f}) over {length:.0f} m{more}"
    return [f"it contradicts itself: scans look through walls that others saw closed, {where}"]
