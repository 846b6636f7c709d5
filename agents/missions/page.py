"""Missions on the control page: order a shipped one, cancel one, and the board (sans-IO)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from armadico.agents.interface.messages import MissionCancel, MissionOrder
from armadico.agents.missions.mission_file import Mission, load_mission
from armadico.config.shipped import names
from armadico.core.messages import Name
from armadico.observe import described
from armadico.observe.page_part import Part
from armadico.observe.page_requests import Asked, Number, RequestError, bits


class Order(Asked, frozen=True, tag="order"):
    """Order a shipped mission."""

    mission: Name


class Cancel(Asked, frozen=True, tag="cancel"):
    mission: Number


class Missions(Part):
    """Orders and cancels missions as other clients do."""

    requests = (Order, Cancel)
    queries = (MissionOrder, MissionCancel)

    @property
    def fixed(self) -> Mapping[str, Any]:
        """The missions that can be ordered."""
        return {"missions": [{"name": m.name, "title": m.title} for m in _shipped().values()]}

    def request(self, browser: str, request: Order | Cancel, t: float) -> None:  # noqa: ARG002
        """Send the request to the interface agent."""
        if isinstance(request, Cancel):
            cancel = MissionCancel(bits(request.mission), browser)
            self.desk.query(browser, request.id, cancel, lambda _: "cancelled")
            return
        mission = _shipped().get(request.mission)
        if mission is None:
            raise RequestError(f"there is no mission {request.mission!r}")
        order = mission.order(None, browser)
        self.desk.query(browser, request.id, order, lambda _: f"{mission.name} is ordered")

    def show(self, parts: dict[str, Any], t: float) -> None:  # noqa: ARG002
        parts["board"] = [described.errand(each) for each in self.view.missions]


@cache
def _shipped() -> dict[str, Mission]:
    """Return the missions that come with Armadico, by name."""
    return {mission.name: mission for mission in map(load_mission, names("missions"))}
