"""The layout of the views: legible from 1280 x 720 on, with rerun's own panels closed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import rerun.blueprint as rrb

from armadico.config.worlds import World
from armadico.watch.dashboard import palette
from armadico.watch.dashboard.canvas import TIMELINE

WINDOW_S: Final = 50.0  # period of the curves up to now; the legend covers the first ten seconds
MARGIN: Final = 0.05  # around a world, as a share of its size
LOCAL_REACH_M: Final = 2.6  # of the local map's view: the outermost ring is at 2.5 m
UTILITY: Final = (-0.05, 1.05)
VIEWS: Final = ("Global map", "Local map", "Utilities")  # names of the views of one robot


def blueprint(worlds: Mapping[str, World | None]) -> rrb.Blueprint:
    """A tab for each namespace, or the views of a single one."""
    pages = [_page(namespace, world) for namespace, world in worlds.items()]
    return rrb.Blueprint(
        pages[0] if len(pages) == 1 else rrb.Tabs(*pages),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _page(namespace: str, world: World | None) -> rrb.Horizontal:
    root = f"/{namespace.strip('/')}"
    reach = [-LOCAL_REACH_M, LOCAL_REACH_M]
    now = rrb.TimeRangeBoundary.cursor_relative
    window = rrb.VisibleTimeRange(TIMELINE, start=now(seconds=-WINDOW_S), end=now())
    whole, local, utilities = VIEWS
    return rrb.Horizontal(
        rrb.Spatial2DView(
            origin=f"{root}/map",
            name=whole,
            visual_bounds=_bounds(world),
            background=palette.BACKGROUND,
        ),
        rrb.Vertical(
            rrb.Spatial2DView(
                origin=f"{root}/local",
                name=local,
                visual_bounds=rrb.VisualBounds2D(x_range=reach, y_range=reach),
                background=palette.BACKGROUND,
            ),
            rrb.TimeSeriesView(
                origin=f"{root}/utility",
                name=utilities,
                axis_y=rrb.ScalarAxis(range=UTILITY),
                plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
                time_ranges=window,
            ),
            row_shares=[9, 7],
        ),
        column_shares=[11, 8],
        name=namespace,
    )


def _bounds(world: World | None) -> rrb.VisualBounds2D | None:
    """The world and a margin, with y up; None without a world, so that the view chooses."""
    if world is None:
        return None
    x1, y1, x2, y2 = world.bounds
    margin = MARGIN * max(x2 - x1, y2 - y1) + 0.1
    return rrb.VisualBounds2D(
        x_range=[x1 - margin, x2 + margin], y_range=[-y2 - margin, -y1 + margin]
    )
