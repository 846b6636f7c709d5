"""How the views lie on the screen: legible from 1280 x 720 on, with rerun's own panels shut."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import rerun.blueprint as rrb

from armadico.config.worlds import World
from armadico.core.resources import WHEELS
from armadico.observe.dashboard import palette
from armadico.observe.dashboard.canvas import TIMELINE

WINDOW_S: Final = 40.0
"""What the curves show: so many seconds up to now,"""

LEGEND_S: Final = 10.0
"""and before them so many that the legend lies over."""

MARGIN: Final = 0.05
"""Of a world's size, around it."""

LOCAL_REACH_M: Final = 2.6
"""How far the local map is shown: the outermost ring is at 2.5 m."""

GRAPH_X: Final = (-130.0, 800.0)
GRAPH_Y: Final = (-260.0, 260.0)
"""The part of the graph that is shown first, in its own points."""

BATTERY_V: Final = (10.0, 14.0)
"""A Pioneer's lead accumulator, from what it should be charged at to full."""

UTILITY: Final = (-0.05, 1.05)

VIEWS: Final = (
    "Global map",
    "Who says what",
    "Who is there",
    "Log",
    "Local map",
    "Robot",
    "Battery (V)",
    "Utilities",
    "Holder of the wheels",
    "Holders",
    "Speed (m/s)",
    "Turning (rad/s)",
)
"""The names of the views of one robot."""


def blueprint(worlds: Mapping[str, World | None], *, graph: bool = False) -> rrb.Blueprint:
    """One page a namespace, or the only one; `graph`: with the graph before the global map."""
    pages = [_page(namespace, world, graph) for namespace, world in worlds.items()]
    return rrb.Blueprint(
        pages[0] if len(pages) == 1 else rrb.Tabs(*pages),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _page(namespace: str, world: World | None, graph: bool) -> rrb.Horizontal:
    root = f"/{namespace.strip('/')}"
    return rrb.Horizontal(
        _left(root, world, graph), _right(root), column_shares=[10, 9], name=namespace
    )


def _left(root: str, world: World | None, graph: bool) -> rrb.Vertical:
    return rrb.Vertical(
        rrb.Tabs(
            rrb.Spatial2DView(
                origin=f"{root}/map",
                name="Global map",
                visual_bounds=_bounds(world),
                background=palette.BACKGROUND,
            ),
            rrb.GraphView(
                origin=f"{root}/society/graph",
                name="Who says what",
                visual_bounds=rrb.VisualBounds2D(x_range=GRAPH_X, y_range=GRAPH_Y),
            ),
            active_tab=int(graph),
        ),
        rrb.Horizontal(
            rrb.Tabs(
                rrb.TextDocumentView(origin=f"{root}/society/table", name="Who is there"),
                rrb.TextLogView(origin=f"{root}/log", name="Log"),
                active_tab=0,
            ),
            _curves(f"{root}/battery", "Battery (V)", BATTERY_V, legend=False),
            column_shares=[5, 2],
        ),
        row_shares=[8, 5.4],
    )


def _right(root: str) -> rrb.Vertical:
    reach = [-LOCAL_REACH_M, LOCAL_REACH_M]
    local = rrb.VisualBounds2D(x_range=reach, y_range=reach)
    return rrb.Vertical(
        rrb.Horizontal(
            rrb.Spatial2DView(
                origin=f"{root}/local",
                name="Local map",
                visual_bounds=local,
                background=palette.BACKGROUND,
            ),
            rrb.TextDocumentView(origin=f"{root}/status", name="Robot"),
            column_shares=[5, 4],
        ),
        _curves(f"{root}/utility", "Utilities", UTILITY),
        rrb.Tabs(  # at 1280 x 720 there is room for one lane: the wheels have it
            _lanes(f"{root}/holders/{WHEELS.name}", "Holder of the wheels"),
            _lanes(f"{root}/holders", "Holders"),
            active_tab=0,
        ),
        rrb.Horizontal(
            _curves(f"{root}/speed/v", "Speed (m/s)"),
            _curves(f"{root}/speed/w", "Turning (rad/s)", legend=False),
        ),
        row_shares=[8.1, 4.9, 3.2, 4.3],
    )


def _curves(
    origin: str, name: str, span: tuple[float, float] | None = None, *, legend: bool = True
) -> rrb.TimeSeriesView:
    """Curves over the window, and the legend beside it."""
    return rrb.TimeSeriesView(
        origin=origin,
        name=name,
        axis_y=None if span is None else rrb.ScalarAxis(range=span),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
        time_ranges=_window(),
    )


def _lanes(origin: str, name: str) -> rrb.StateTimelineView:
    """A lane for each resource under a path, with its holders over the window."""
    return rrb.StateTimelineView(origin=origin, name=name, time_ranges=_window())


def _window() -> rrb.VisibleTimeRange:
    start = rrb.TimeRangeBoundary.cursor_relative(seconds=-WINDOW_S - LEGEND_S)
    return rrb.VisibleTimeRange(TIMELINE, start=start, end=rrb.TimeRangeBoundary.cursor_relative())


def _bounds(world: World | None) -> rrb.VisualBounds2D | None:
    """The world, y up, and a margin; without a world the view finds its own."""
    if world is None:
        return None
    x1, y1, x2, y2 = world.bounds
    margin = MARGIN * max(x2 - x1, y2 - y1) + 0.1
    return rrb.VisualBounds2D(
        x_range=[x1 - margin, x2 + margin], y_range=[-y2 - margin, -y1 + margin]
    )
