"""The pose graph against known solutions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.agents.methods.poses import Floats, compose, relative, wrapped
from armadico.agents.slam.pose_graph import Edge, GraphParameters, Kernel, PoseGraph

SURE = np.diag([1e4, 1e4, 1e5])


def circle(count: int, rounds: int = 2) -> Floats:
    turn = np.linspace(0.0, 2.0 * np.pi * rounds, count)
    return np.column_stack([5.0 * np.cos(turn), 5.0 * np.sin(turn), wrapped(turn + 0.5 * np.pi)])


def chained(graph: PoseGraph, truth: Floats, rng: np.random.Generator, noise: float) -> Floats:
    """Edges in a row with noise, and the poses by these alone."""
    poses = [truth[0]]
    for k in range(1, len(truth)):
        step = relative(truth[k - 1], truth[k]) + noise * rng.standard_normal(3) * (1, 1, 0.3)
        graph.add(Edge(k - 1, k, step, SURE))
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def dense_step(graph: PoseGraph, poses: Floats) -> Floats:
    """One step of Gauss-Newton by numerical differentiation and least squares."""
    roots = [np.linalg.cholesky(edge.information).T for edge in graph.edges]

    def residual(flat: Floats) -> Floats:
        at = np.vstack([poses[:1], flat.reshape(-1, 3)])
        rows = []
        for edge, root in zip(graph.edges, roots, strict=True):
            off = relative(at[edge.start], at[edge.end]) - edge.pose
            off[2] = wrapped(off[2])
            rows.append(root @ off)
        return np.concatenate(rows)

    flat = poses[1:].ravel()
    base = residual(flat)
    jacobian = np.empty((len(base), len(flat)))
    for k in range(len(flat)):
        moved = flat.copy()
        moved[k] += 1e-6
        jacobian[:, k] = (residual(moved) - base) / 1e-6
    solved: Floats = np.linalg.lstsq(jacobian, -base, rcond=None)[0].reshape(-1, 3)
    return solved


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(3, 60), loops=st.integers(0, 40))
def test_a_step_is_that_of_least_squares_on_any_graph(seed: int, count: int, loops: int) -> None:
    rng = np.random.default_rng(seed)
    graph = PoseGraph(GraphParameters(loss=Kernel.NONE, rounds=1, damping=0.0))
    truth = np.column_stack([rng.uniform(-5, 5, (count, 2)), rng.uniform(-3, 3, count)])
    poses = chained(graph, truth, rng, 0.05)
    for _ in range(loops):
        a, b = rng.choice(count, 2, replace=False).tolist()
        graph.add(Edge(a, b, relative(truth[a], truth[b]), SURE, loop=True))
    moved = graph.optimise(poses) - poses
    moved[:, 2] = wrapped(moved[:, 2])
    assert np.allclose(moved[0], 0.0)
    expected = dense_step(graph, poses)
    scale = max(1.0, float(np.abs(expected).max()))
    expected[:, 2] = wrapped(expected[:, 2])
    assert np.abs(wrapped(moved[1:] - expected)).max() < 1e-3 * scale


def ringed(loss: Kernel, false: int) -> tuple[float, PoseGraph]:
    """How far a ring with true and false loops is off, m."""
    rng, truth = np.random.default_rng(2), circle(200, 4)
    graph = PoseGraph(GraphParameters(loss=loss))
    poses = chained(graph, truth, rng, 0.01)
    for k in range(50, 200, 2):
        pose = relative(truth[k - 50], truth[k]) + 0.02 * rng.standard_normal(3) * (1, 1, 0.3)
        graph.add(Edge(k - 50, k, pose, 0.25 * SURE, loop=True))
    for k in rng.choice(150, false, replace=False).tolist():
        wrong = relative(truth[k], truth[k + 50]) + np.array([3.0, 0.0, 0.0])
        graph.add(Edge(k, k + 50, wrong, 0.25 * SURE, loop=True))
    found = graph.optimise(poses)
    return float(np.hypot(*(found - truth)[:, :2].T).max()), graph


def test_dcs_switches_false_loops_off() -> None:
    off, graph = ringed(Kernel.DCS, 15)
    assert off < 0.15
    assert (graph.weights[-15:] < 0.1).all()
    assert np.mean(graph.weights[:-15] > 0.5) > 0.9
    assert ringed(Kernel.NONE, 15)[0] > 4.0 * off


def test_an_empty_graph_and_an_edge_to_nowhere() -> None:
    graph = PoseGraph()
    assert graph.optimise(np.zeros((1, 3))).tolist() == [[0.0, 0.0, 0.0]]
    graph.add(Edge(0, 5, np.zeros(3), np.eye(3)))
    with pytest.raises(ValueError, match="beyond"):
        graph.optimise(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="not connected"):
        PoseGraph(GraphParameters(damping=0.0), [graph.edges[0]._replace(end=1)]).optimise(
            np.zeros((3, 3))
        )


def test_a_loop_that_an_uncertain_chain_explains_counts_and_a_false_one_is_still_switched_off() -> (
    None
):
    truth, unsure = circle(81, rounds=1), np.diag([10.0**2, 10.0**2, 100.0**2])
    graph, poses = PoseGraph(), [truth[0]]
    for k in range(1, 81):
        step = relative(truth[k - 1], truth[k]) + np.array([0.05 if k < 40 else 0.0, 0.0, 0.0])
        graph.add(Edge(k - 1, k, step, unsure))
        poses.append(compose(poses[-1], step))
    graph.add(Edge(0, 80, relative(truth[0], truth[80]), SURE, loop=True))
    start = np.array(poses)
    graph.optimise(start)
    assert graph.weights[80] < 0.01
    found = graph.optimise(start, expected=[80])
    assert graph.weights[80] > 0.99
    for k in range(5, 30):
        graph.add(Edge(k, k + 50, relative(truth[k], truth[k + 50]), SURE, loop=True))
    found = graph.optimise(found)
    wrong = relative(truth[20], truth[70] + np.array([1.0, 0.0, 0.0]))
    graph.add(Edge(20, 70, wrong, SURE, loop=True))
    graph.optimise(found, expected=[len(graph.edges) - 1])
    assert graph.weights[-1] < 0.01
    assert graph.weights[80:-1].min() > 0.9
