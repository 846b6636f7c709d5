"""Speeds, battery, and a page on how the run stands."""

from __future__ import annotations

from math import degrees
from typing import Any, Final

import rerun as rr

from armadico.core.messages import BatteryLevel, Claim, Command, RobotState
from armadico.core.resources import WHEELS
from armadico.observe.dashboard import palette
from armadico.observe.dashboard.canvas import Canvas
from armadico.observe.measures import speeds
from armadico.observe.view import View

AXES: Final = ("v", "w")
"""Forward speed, m/s, and turning speed, rad/s, ccw."""


class Gauges:
    """Draws the numbers of one robot."""

    def __init__(self, canvas: Canvas, namespace: str) -> None:
        self._canvas = canvas
        self._namespace = namespace
        for axis in AXES:
            for what, colour in palette.SPEEDS.items():
                canvas.curve(f"speed/{axis}/{what}", what, colour)
        canvas.curve("battery/volts", "battery", palette.BATTERY)
        canvas.curve("battery/rest", "at rest", palette.RESTED)

    def take_state(self, state: RobotState, t: float) -> None:
        self._speeds("measured", state.v, state.w, t)
        if self._canvas.due("battery", t):
            self._canvas.number("battery/volts", t, state.battery_v)

    def take_level(self, level: BatteryLevel, t: float) -> None:
        """The battery without its load, as the battery sensor agent has it."""
        self._canvas.number("battery/rest", t, level.volts)

    def draw(self, view: View, holder: str, t: float) -> None:
        if self._canvas.due("status", t):
            page = rr.TextDocument(self._page(view, holder, t), media_type=rr.MediaType.MARKDOWN)
            self._canvas.draw("status", t, page)

    def take_command(self, command: Command, t: float) -> None:
        """What was sent to the wheels, after blending."""
        if command.resource == WHEELS.name:
            self._speeds("commanded", *speeds(command), t)

    def take_claim(self, claim: Claim, t: float) -> None:
        """What the holder would have, before blending."""
        wanted = claim.wanted
        if claim.resource == WHEELS.name and len(wanted) == len(AXES):
            self._speeds("wanted", wanted[0], wanted[1], t)

    def _speeds(self, what: str, v: float, w: float, t: float) -> None:
        for axis, value in zip(AXES, (v, w), strict=True):
            if self._canvas.due(f"speed/{axis}/{what}", t):
                self._canvas.number(f"speed/{axis}/{what}", t, value)

    def _page(self, view: View, holder: str, t: float) -> str:
        """A table of two columns."""
        rows = "\n".join(f"| {name} | {value} |" for name, value in _rows(view, holder, t))
        return f"|  | **{self._namespace}** |\n|---|---|\n{rows}\n"


def _rows(view: View, holder: str, t: float) -> list[tuple[str, Any]]:
    state, mission, truth = view.state, view.mission, view.truth
    rows: list[tuple[str, Any]] = [("wheels", f"**{holder}**")]
    if mission is not None:
        rows += [
            ("mission", ", ".join(filter(None, [mission.state.value, mission.note]))),
            ("to go", f"{mission.to_go:.2f} m, leg {mission.leg + 1}"),
        ]
    if view.tasks:
        rows.append(("tasks", view.tasks))
    if state is not None:
        turning = f"{degrees(state.w):+.0f} deg/s"
        rows += [
            ("speed", f"{state.v:.2f} m/s, {turning}"),
            ("battery", view.battery),
            ("stop", f"**by {state.stop.who}**" if state.stop.stopped else "not set"),
        ]
        wrong = [*["motors off"] * (not state.motors), *["stalled"] * state.stalled]
        rows += [("note", f"**{word}**") for word in wrong]
        rows += [("line", state.line.told)] if state.line.told else []
    known = view.whereabouts(t)
    if known:
        rows.append(("pose", known if view.lost_since is None else f"**{known}**"))
    if truth is not None:
        clear = "-" if truth.clearance is None else f"{truth.clearance:.2f} m"
        rows.append(("clearance", f"{clear}, {truth.collisions} collisions"))
    return rows
