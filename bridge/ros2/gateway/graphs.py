"""The pose graph of a map as markers, as slam_toolbox publishes its own."""

from __future__ import annotations

from typing import Final

from armadico.bridge.ros2 import types
from armadico.config.map_graphs import Graph

WIDTH_M: Final = 0.03  # of lines
KEY_SCANS: Final = types.ColorRGBA(0.16, 0.43, 0.78)
LOOPS: Final = types.ColorRGBA(0.16, 0.63, 0.31)
LOOPS_OFF: Final = types.ColorRGBA(0.82, 0.24, 0.20)


def markers(graph: Graph, header: types.Header) -> types.MarkerArray:
    """The key scans as a line, loops and those switched off as lines of two colours."""
    points = [types.Point(x, y) for x, y in graph.places.tolist()]
    kinds = (
        ("key_scans", types.LINE_STRIP, KEY_SCANS, points),
        ("loops", types.LINE_LIST, LOOPS, [points[k] for k in graph.loops.ravel()]),
        ("loops_off", types.LINE_LIST, LOOPS_OFF, [points[k] for k in graph.off.ravel()]),
    )
    return types.MarkerArray(
        [
            types.Marker(
                header,
                name,
                type=kind,
                action=types.ADD if len(ends) > 1 else types.DELETE,  # RViz refuses empty lines
                scale=types.Vector3(WIDTH_M),
                color=colour,
                points=ends,
            )
            for name, kind, colour, ends in kinds
        ]
    )
