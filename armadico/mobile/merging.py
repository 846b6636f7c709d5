"""Trajectory merging, an exchange: the robot drives on to where the new path begins (3.3.2)."""

from __future__ import annotations

from dataclasses import dataclass

from msgspec.structs import replace

from armadico.core.exchange import AT_ONCE, EXCHANGES, Bid, Handover
from armadico.core.messages import Action, encode
from armadico.core.resources import Resource
from armadico.mobile.messages import WAYPOINTS, Way
from armadico.mobile.route import Route


class MergingExchange:
    """Trajectory merging (thesis 3.3.2, 3.6.1).

    A contender plans its path from a place on the driven path, some metres ahead. Up to there the
    loser's waypoints are driven, so the robot does not stop.
    """

    def begin(
        self,
        resource: Resource,
        loser: Action,
        loser_utility: float,  # noqa: ARG002
        bid: Bid,
        period: float,  # noqa: ARG002
    ) -> Handover:
        """Begin; a path that does not begin on the rest of the loser's is driven immediately."""
        wanted = bid.packed
        if not (isinstance(loser, bytes) and loser and isinstance(wanted, bytes)):
            return AT_ONCE
        before, way = resource.unpack(loser), resource.unpack(wanted)
        if not (isinstance(before, Way) and isinstance(way, Way)):
            return AT_ONCE
        driven = Route(before.waypoints, before.start, before.leg)
        common = driven.up_to(way.start.x, way.start.y)
        if not common or len(common) + len(way.waypoints) > WAYPOINTS:
            return AT_ONCE
        joined = replace(
            way,
            waypoints=(*common, *way.waypoints),
            start=driven.leg_start,
            leg=0,
            unseen=tuple(dict.fromkeys((*before.unseen, *way.unseen)))[:WAYPOINTS],
        )
        return _Merged(wanted, encode(joined))


@dataclass(frozen=True, slots=True)
class _Merged:
    """The path joined to the loser's, for as long as the winner's bid has the same path."""

    wanted: bytes
    joined: bytes

    def action(self, t: int, bid: Bid) -> Action:  # noqa: ARG002
        return self.joined if bid.packed == self.wanted else bid.packed


EXCHANGES["merging"] = MergingExchange()
