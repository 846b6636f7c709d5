"""The file of a SLAM graph: the same bytes, what is refused, and its way over the mesh."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import cache
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armadico.agents.methods.poses import Floats, compose, relative
from armadico.agents.slam.agent import Parameters, SlamAgent
from armadico.config import graph_file, graph_parts, grid_map
from armadico.config.graph_file import SavedGraph
from armadico.config.grid_map import FREE, OCCUPIED
from armadico.core.agent import Identity, Question
from armadico.core.config_errors import ConfigError
from armadico.core.messages import LARGEST_PAYLOAD, Message, encode
from armadico.core.outgoing import Answer
from armadico.mobile.messages import (
    Correction,
    MapGraphPart,
    MapGraphRequest,
    MapLoadReply,
    MapLoadRequest,
    MapRequest,
    OccupancyGrid,
)
from armadico.mobile.scans import ranges_of
from tests.robot.robots import with_laser
from tests.slam.test_agent import PATH, Robot, own_odometry, place


def driven(count: int = 90) -> Robot:
    """A robot that has mapped a part of the ring."""
    robot = Robot()
    robot.drive(PATH[:count], own_odometry(PATH[:count]))
    return robot


def asked(agent: SlamAgent, request: Message) -> Message:
    """The answer of an agent."""
    agent.kernel.on_query(request, Question(7), agent.now)
    (answer,) = (one for one in agent.kernel.outbox if isinstance(one, Answer))
    agent.kernel.outbox = []
    return answer.message


def graph_of(agent: SlamAgent) -> bytes:
    """Its graph, part by part."""

    def ask(request: MapGraphRequest) -> MapGraphPart:
        part = asked(agent, request)
        assert isinstance(part, MapGraphPart)
        assert len(encode(part)) <= LARGEST_PAYLOAD
        return part

    data = graph_parts.read(ask)
    assert data is not None
    return data


@cache
def mapped_by() -> Robot:
    """A robot whose map is saved."""
    return driven()


@cache
def saved_graph() -> SavedGraph:
    """Its graph."""
    return graph_file.decode(graph_of(mapped_by().agent), "the graph")


@cache
def saved_file() -> bytes:
    """The file of that."""
    return graph_file.encode(saved_graph())


def test_what_is_read_is_what_was_saved_and_small() -> None:
    again = graph_file.decode(saved_file(), "a.graph.npz")
    assert graph_file.encode(again) == saved_file() == graph_file.encode(saved_graph())
    slam = mapped_by().agent._slam
    assert np.array_equal(again.poses, slam.map.poses)
    assert len(again.ends) == len(slam.map.graph.edges)
    assert np.array_equal(again.ends[again.loops, 1], [loop.end for loop in slam.map.loops])
    kept, drawn = mapped_by().agent._drawn[5].scan, again.scans[5].scan
    off = np.abs(ranges_of(kept) - ranges_of(drawn))
    assert np.nanmax(off) <= 0.0025 + 1e-9
    assert len(saved_file()) < 1000 * len(slam.map.poses)


def test_the_map_is_drawn_of_it() -> None:
    cells, own = saved_graph().drawn(), mapped_by().agent._picture.mapper.cells()
    assert cells.area(FREE) == pytest.approx(own.area(FREE), rel=0.03)
    assert cells.area(OCCUPIED) == pytest.approx(own.area(OCCUPIED), rel=0.1)


def changed(**arrays: Any) -> bytes:
    """The file with other arrays; None: without it."""
    with np.load(BytesIO(saved_file())) as archive:
        found = {name: archive[name] for name in archive} | arrays
    file = BytesIO()
    np.savez(file, **{name: value for name, value in found.items() if value is not None})
    return file.getvalue()


def nan(array: str) -> Callable[[], bytes]:
    def data() -> bytes:
        with np.load(BytesIO(saved_file())) as archive:
            bad = archive[array].copy()
        bad.flat[-1] = np.nan
        return changed(**{array: bad})

    return data


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (lambda: b"P5\n2 2\n255\n", "not the graph of a map"),
        (lambda: saved_file().replace(b"poses", b"roses"), "not the graph of a map"),
        (lambda: changed(way=None), "no array 'way'"),
        (lambda: changed(poses=saved_graph().poses[:, :2]), "array 'poses' is float64"),
        (lambda: changed(edge_ends=saved_graph().ends.astype("<u4") * 0), "to itself"),
        (lambda: changed(scan_rays=np.full(len(saved_graph().scans), 3000, "<u2")), "at most 2048"),
        (nan("poses"), "not finite"),
        (nan("scan_frame"), "not finite"),
    ],
)
def test_a_file_that_is_no_graph_is_refused_by_its_name(
    data: Callable[[], bytes], says: str, tmp_path: Path
) -> None:
    file = tmp_path / "flat.graph.npz"
    file.write_bytes(data())
    with pytest.raises(ConfigError, match=says) as refused:
        graph_file.read(file)
    assert str(refused.value).startswith(str(file))


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"flat\.graph\.npz: there is no such file"):
        graph_file.read(graph_file.beside(tmp_path / "flat.yaml"))


def test_a_graph_that_changes_while_it_is_read_is_read_anew() -> None:
    agent = driven(40).agent
    first = asked(agent, MapGraphRequest())
    assert isinstance(first, MapGraphPart)
    agent._slam.map.poses = agent._slam.map.poses + 1e-3
    second = asked(agent, MapGraphRequest())
    assert isinstance(second, MapGraphPart)
    late = asked(agent, MapGraphRequest(1, first.digest))
    assert isinstance(late, MapGraphPart)
    assert first.digest != second.digest == late.digest
    assert graph_file.decode(graph_of(agent), "it").poses[0, 0] == agent._slam.map.poses[0, 0]


def test_before_the_first_scan_there_is_no_graph() -> None:
    assert graph_of(SlamAgent(Identity("slam-1"), Parameters(profile=with_laser()))) == b""


def slowly(path: Floats, parts: int = 9) -> Floats:
    """The path in smaller steps: a search takes some dozens of cycles."""
    share = np.arange(parts)[:, None] / parts
    steps = [compose(a, share * relative(a, b)) for a, b in pairwise(path)]
    return np.concatenate(steps)


def loaded(robot: Robot, graph: SavedGraph) -> None:
    for request in graph_parts.parts_of(graph_file.encode(graph, compressed=False)):
        assert asked(robot.agent, request) == MapLoadReply()


@pytest.mark.long
@pytest.mark.parametrize("mapping", [True, False])
def test_a_running_agent_continues_a_loaded_map(mapping: bool) -> None:
    robot, path = Robot(Parameters(mapping=mapping)), slowly(PATH[100:125])
    odometry = own_odometry(path, 0.05)
    robot.drive(path[:4], odometry[:4])
    loaded(robot, saved_graph())
    *_, said = robot.drive(path[4:], odometry[4:])
    (last,) = (one for one in said if isinstance(one, Correction))
    assert robot.agent._slam.located
    assert np.hypot(*(place(last, odometry[-1]) - path[-1])[:2]) < 0.1
    count = len(saved_graph().poses)
    assert (len(robot.agent._slam.map.poses) > count) is mapping
    assert len(robot.agent._slam.map.poses) >= count
    grid = asked(robot.agent, MapRequest())
    assert isinstance(grid, OccupancyGrid)
    cells = grid_map.cells_of(grid)
    assert cells.area(FREE) > 0.95 * saved_graph().drawn().area(FREE), "the whole map"
    saved = graph_file.decode(graph_of(robot.agent), "it")
    assert saved.part.max() == 0


def test_parts_that_do_not_fit_are_refused_and_the_map_stays() -> None:
    robot = driven(30)
    poses = robot.agent._slam.map.poses
    data = b"x" * 70_000
    first, second = graph_parts.parts_of(data)
    for request, says in (
        (second, "expected part 0"),
        (MapLoadRequest(0, 10**6, 1, b""), "parts; expected at most"),
        (MapLoadRequest(0, 1, 5, b"y"), "do not fit"),
        (MapLoadRequest(0, 1, zlib.crc32(b"y"), b"y"), "not the graph of a map"),
    ):
        reply = asked(robot.agent, request)
        assert isinstance(reply, MapLoadReply)
        assert says in reply.refusal
    assert asked(robot.agent, first) == MapLoadReply()
    robot.cycle(PATH[30], own_odometry(PATH[:31])[30])
    assert np.array_equal(robot.agent._slam.map.poses[:5], poses[:5])
