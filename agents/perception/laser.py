"""The laser agent: a local map of the robot's surroundings, from its laser (thesis 3.4.2)."""

from __future__ import annotations

from typing import ClassVar

from armadico.agents.methods.near import RayResult
from armadico.agents.methods.settings import ScanSettings
from armadico.agents.perception import perception
from armadico.agents.perception.perception import Perception
from armadico.agents.perception.scan_map import ScanMap
from armadico.core import agent
from armadico.core.agent import ERROR, INFO
from armadico.core.messages import Message, Point
from armadico.mobile.messages import Scan

LEAST_VALID = 0.02
"""Least share of valid rays: with fewer the laser is covered or broken."""

REPORT_S = 10.0
"""Least time between two reports of that."""


class Parameters(perception.Parameters, frozen=True, kw_only=True):
    """What the map keeps of a scan, and for how long."""

    map: ScanSettings = ScanSettings()


class LaserAgent(Perception):
    """Adds the scans to its map, and publishes the obstacles that are near.

    The map's walls are expected only where the laser has no information: out of its sight, hidden,
    or without a return, since it does not see dark or glass surfaces. What it sees is where it sees
    it, however wrong the pose is.
    """

    name = "laser"
    receives: ClassVar[tuple[type[Message], ...]] = (Scan, *Perception.receives)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        p: Parameters = Parameters() if parameters is None else parameters
        self._map = ScanMap(p.map)
        super().__init__(identity, p, self._map)
        self._blind = False
        self._reported_at = float("-inf")

    def on_scan(self, scan: Scan) -> None:
        seen, walls = self._map, self._near_walls()
        rays = scan.rays
        try:
            valid = seen.update(scan)
        except ValueError:
            valid = 0
        if valid < max(1.0, LEAST_VALID * rays):
            self._report_blind(f"{valid} of {rays} rays are valid: no obstacles are published")
            return
        if self._blind:
            self._blind = False
            self.log("the laser works again", INFO)
        if walls is not None:
            walls.see(seen.probe)
        accepted = () if walls is None else walls.points(seen.outline)
        results = seen.probe([(o.x, o.y) for o in accepted])
        known = (RayResult.SEEN, RayResult.THROUGH)
        self._expect(o for o, look in zip(accepted, results, strict=True) if look not in known)
        if seen.outline is not None:
            self._publish_near(scan.cycle, (Point(o.x, o.y) for o in seen.sensed()))

    def _report_blind(self, why: str) -> None:
        """Report the fault. Publish nothing: stale obstacles do not show free space."""
        if not self._blind or self.now - self._reported_at >= REPORT_S:
            self._reported_at = self.now
            self.log(f"the laser: {why}", ERROR)
        self._blind = True
