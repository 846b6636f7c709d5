"""Ask first, on the control page: what would happen on the way to a place that was clicked on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from math import hypot
from typing import TYPE_CHECKING, Final, cast

from armadico.core.messages import Real
from armadico.launch.client import heading_to
from armadico.observe.jsons import Json, JsonObject
from armadico.observe.page_part import Part
from armadico.observe.page_requests import Asked, Turned

if TYPE_CHECKING:
    from armadico.mesh.base import Mesh
    from armadico.mesh.zenoh import ZenohMesh
    from armadico.rehearsal.answer import Rehearsed

APART_M: Final = 0.1
"""Points of a path that is drawn are so far apart at least."""


class Rehearse(Asked, frozen=True, tag="rehearse"):
    """What would happen on the way to a place, as of `Goto`; nothing moves."""

    x: Real
    y: Real
    theta: Turned | None = None


class AskFirst(Part):
    """Rehearses a goal, and shows the paths of the samples."""

    requests = (Rehearse,)

    @property
    def fixed(self) -> Mapping[str, Json]:
        return {"rehearses": True}

    def request(self, browser: str, request: Rehearse, t: float) -> None:  # noqa: ARG002
        theta = request.theta
        if theta is None:
            theta = heading_to(request.x, request.y, self.view.pose)
        self.desk.work(browser, request.id, partial(told, (request.x, request.y, theta)))


def told(goal: tuple[float, float, float], mesh: Mesh) -> tuple[str, Json]:
    """Rehearse a goal (m, m, rad); return a sentence, and what the page draws.

    Raises ConfigError if it cannot be rehearsed.
    """
    from armadico.rehearsal.fork import Errand
    from armadico.rehearsal.rehearse import rehearsed

    found = rehearsed(cast("ZenohMesh", mesh), Errand(goal=goal))  # as all meshes of pages
    return found.lines[0], shown(found)


def shown(found: Rehearsed) -> JsonObject:
    """The answer, and of each sample how it ended, its path, and what was put on it, x, y in m."""
    paths: list[Json] = [
        {
            "end": run.end,
            "points": _thinned(run.path),
            "put": None if run.put is None else [*run.put],
        }
        for run in found.runs
    ]
    return {"answer": str(found.judgement.answer), "paths": paths}


def _thinned(path: Iterable[tuple[float, float, float]]) -> Json:
    """The x and y of a path of t, x, y, without points that are near the one before."""
    kept: list[Json] = []
    at: tuple[float, float] | None = None
    for _, x, y in path:
        if at is None or hypot(x - at[0], y - at[1]) >= APART_M:
            at = x, y
            kept.append([round(x, 2), round(y, 2)])
    return kept
