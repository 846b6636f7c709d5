"""The laser agent: a local map of what is around the robot, by its laser (thesis 3.4.2)."""

from __future__ import annotations

from typing import Any, ClassVar

from armadico.agents.methods.near import Look
from armadico.agents.methods.settings import ScanSettings
from armadico.agents.perception import perception
from armadico.agents.perception.perception import Perception
from armadico.agents.perception.scan_map import ScanMap
from armadico.core import agent
from armadico.core.agent import ERROR, INFO
from armadico.core.messages import Message, Point
from armadico.mobile.messages import Scan

TELL = 0.02
"""With a smaller share of rays that tell anything a laser is blind: covered, or broken."""

SAY_S = 10.0
"""It says so at most so often."""


class Parameters(perception.Parameters, frozen=True, kw_only=True):
    """What the map keeps, and for how long."""

    map: ScanSettings = ScanSettings()


class LaserAgent(Perception):
    """Takes the scans into its map, and publishes what is near.

    The map's walls are expected only where the laser cannot tell: out of its sight, hidden, or
    where its rays found nothing, for what is dark or of glass it does not see. What it sees is
    where it sees it, however the pose is off.
    """

    name = "laser"
    hears: ClassVar[tuple[type[Message], ...]] = (Scan, *Perception.hears)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        p: Parameters = Parameters() if parameters is None else parameters
        self._map = ScanMap(p.map)
        super().__init__(identity, p, self._map)
        self._blind = False
        self._said_at = float("-inf")

    def on_scan(self, scan: Scan) -> None:
        """Take the scan in, and publish where the obstacles are."""
        seen, walls = self._map, self._near_walls()
        rays = scan.rays
        try:
            tell = seen.update(scan)
        except ValueError:
            tell = 0
        if tell < max(1.0, TELL * rays):
            self._cannot_see(f"of {rays} rays {tell} tell anything: nobody drives blind")
            return
        if self._blind:
            self._blind = False
            self.log("the laser sees again", INFO)
        if walls is not None:
            walls.see(seen.probe)
        believed = () if walls is None else walls.points(seen.outline)
        looks = seen.probe([(o.x, o.y) for o in believed])
        told = (Look.SEEN, Look.THROUGH)
        self._expect(o for o, look in zip(believed, looks, strict=True) if look not in told)
        if seen.outline is not None:
            self._publish_near(scan.cycle, (Point(o.x, o.y) for o in seen.heard()))

    def _cannot_see(self, why: str) -> None:
        """Publish nothing: stale obstacles are no free way."""
        if not self._blind or self.now - self._said_at >= SAY_S:
            self._said_at = self.now
            self.log(f"the laser: {why}", ERROR)
        self._blind = True
