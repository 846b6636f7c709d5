"""The pose graph of a map in a message for observers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.config.map_graphs import graph_of, message_of
from armadico.core.messages import decode, encode
from armadico.mobile.messages import MapGraph

LARGEST = 40_000  # bytes

places = st.floats(-300.0, 300.0)
poses = st.lists(st.tuples(places, places, st.floats(-7.0, 7.0)), min_size=1, max_size=30)


@given(poses, st.data())
@settings(max_examples=60)
def test_key_scans_and_loops_come_back(scans: list[tuple[float, ...]], data: st.DataObject) -> None:
    scan = st.integers(0, len(scans) - 1)
    loops = data.draw(st.lists(st.tuples(scan, scan, st.booleans()), max_size=30))
    message = message_of(4, scans, [one[:2] for one in loops], [one[2] for one in loops], "why")
    back = decode(encode(message), MapGraph)
    graph = graph_of(back)
    assert graph.places == pytest.approx(np.array(scans)[:, :2], abs=0.006)
    assert [*map(tuple, graph.loops.tolist())] == [one[:2] for one in loops if not one[2]]
    assert [*map(tuple, graph.off.tolist())] == [one[:2] for one in loops if one[2]]
    assert (back.revision, back.uncertain) == (4, "why")
    assert (back.key_scans, back.loops_found, back.loops_off) == (
        len(scans),
        len(loops),
        len(graph.off),
    )


@pytest.mark.parametrize("count", [3000, 3001, 20_000])
def test_a_large_graph_is_thinned(count: int) -> None:
    way = np.arange(count) * 0.3
    ends = np.arange(0, count - 50)
    loops = np.column_stack([ends, ends + 50])
    message = message_of(1, np.column_stack([way, way, way]), loops, ends % 2 == 0, "x" * 2000)
    assert len(encode(message)) < LARGEST
    assert (message.key_scans, message.loops_found) == (count, count - 50)
    graph = graph_of(message)
    lengths = np.diff(graph.places[graph.off][..., 0], axis=1)
    assert lengths == pytest.approx(15.0, abs=0.3 * -(-count // 3000) + 0.2)
    assert len(graph.off) >= 500


def test_bytes_that_are_no_graph_are_refused() -> None:
    message = message_of(1, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], [(0, 1)], [False])
    for wrong in ({"packed": b"7 bytes"}, {"loops": b"abc"}, {"off": bytes([0, 0, 2, 0])}):
        with pytest.raises(ValueError, match=r"bytes|loop"):
            graph_of(replace(message, **wrong))
