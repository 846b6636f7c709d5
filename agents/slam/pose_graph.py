"""A pose graph in the plane, optimised by Gauss-Newton on SE(2).

Loop edges have a redescending kernel, dynamic covariance scaling (DCS; Agarwal et al., 2013): an
edge that contradicts the others loses its weight. A kernel that only grows more slowly (Huber) or
that keeps some pull (Cauchy) lets false loops fold the map.

The normal equations are solved without a sparse library. Poses are ordered by their distance in
edges from an end of the graph (Cuthill and McKee, 1969). An edge joins poses of the same or of
neighbouring levels, so the matrix is banded and is factorised block by block.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.methods.parameters import Count, Positive
from armadico.agents.methods.poses import Floats, relative, wrapped
from armadico.agents.methods.slices import Sliced, finished

Indices = NDArray[np.intp]

BLOCK: Final = 12
"""Neighbouring levels are merged until a block has so many poses: small blocks cost calls."""

LARGEST: Final = 24
"""A level of more poses is split into blocks of so many, since a block is solved in one slice."""

EDGE_WORK, POSE_WORK, FLOPS = 500, 1500, 40
"""Work of an edge that is linearised and of a pose that is ordered, in look-ups (`slices`), and
the floating-point operations of one look-up."""


EXPECTED_ROUNDS: Final = 4
"""Rounds in which loops that are expected count fully."""


class Kernel(Enum):
    """How the weight of a loop edge falls with its error."""

    NONE = "none"
    DCS = "dcs"

    def weight(self, chi2: Floats, scale: float) -> Floats:
        """The weight of edges with a squared error, in standard deviations."""
        if self is Kernel.NONE:
            return np.ones_like(chi2)
        return np.minimum(1.0, 2.0 * scale / (scale + chi2)) ** 2


class GraphParameters(Struct, frozen=True, kw_only=True):
    """How a graph is optimised."""

    loss: Kernel = Kernel.DCS  # ceres_loss_function
    loss_scale: Positive = 5.0  # in squared standard deviations
    rounds: Count = 20  # max_num_iterations
    damping: Positive = 1e-6
    step: Positive = 1e-4  # a smaller step ends it, m and rad
    gain: Positive = 1e-5  # a smaller relative gain ends it


class Edge(NamedTuple):
    """The pose of one node in the frame of another, as measured."""

    start: int
    end: int
    pose: Floats  # (3,)
    information: Floats  # (3, 3) in the frame of the start
    loop: bool = False


@dataclass
class PoseGraph:
    """Edges between numbered poses; the poses themselves belong to the caller."""

    parameters: GraphParameters = field(default_factory=GraphParameters)
    edges: list[Edge] = field(default_factory=list)
    weights: Floats = field(default_factory=lambda: np.zeros(0))
    """Of the edges after the newest optimisation: 1 counts, near 0 is switched off."""

    def add(self, edge: Edge) -> None:
        """Add an edge."""
        self.edges.append(edge)

    def optimise(self, poses: Floats, expected: Collection[int] = ()) -> Floats:
        """The poses (n, 3) that fit the edges best; the first one stays.

        Raises ValueError for an edge to a pose that there is not, or if the graph is not connected.
        """
        return finished(self.optimising(poses, expected))

    def optimising(self, poses: Floats, expected: Collection[int] = ()) -> Sliced[Floats]:
        """Do `optimise` in slices; edges may be added meanwhile.

        Args:
            poses: (n, 3) to begin with.
            expected: Loop edges, by number, whose error the chain between their ends explains.
                They count fully in the first rounds, as do those that were on before. Else the
                kernel would switch them off before the chain gives way.
        """
        p, count = self.parameters, len(poses)
        found = np.array(poses, dtype=np.float64)
        if not self.edges or count < 2:
            self.weights = np.ones(len(self.edges))
            return found
        terms = _Terms.of(self.edges)
        if max(terms.start.max(), terms.end.max()) >= count:
            raise ValueError(f"an edge to a pose beyond the {count} that there are")
        order = _Order.of(count, terms)
        yield POSE_WORK * count
        before = np.inf
        robust, trusting = terms.loop.copy(), EXPECTED_ROUNDS if expected else 0
        robust[list(expected)] = False
        robust[np.flatnonzero(self.weights > 0.5)] = False  # or a false loop would win over these
        for turn in range(p.rounds):
            errors = terms.errors(found)
            chi2 = terms.chi2(errors)
            doubtful = robust if turn < trusting else terms.loop
            weights = np.where(doubtful, p.loss.weight(chi2, p.loss_scale), 1.0)
            cost = float((weights * chi2).sum())
            linear = terms.linearised(found, errors, weights)
            yield EDGE_WORK * len(terms.start)
            step = yield from order.solve(terms, linear, p.damping)
            found[1:] += step[1:]
            found[:, 2] = wrapped(found[:, 2])
            small = np.abs(step).max() < p.step or abs(before - cost) < p.gain * max(1.0, cost)
            if small and turn >= trusting:
                break
            before = cost
        chi2 = terms.chi2(terms.errors(found))
        self.weights = np.where(terms.loop, p.loss.weight(chi2, p.loss_scale), 1.0)
        return found


class _Linear(NamedTuple):
    """The normal equations as blocks of edges: (m, 3, 3) and the gradient (n, 3)."""

    start_start: Floats
    start_end: Floats
    end_end: Floats
    gradient: Floats


class _Terms(NamedTuple):
    """Edges as arrays."""

    start: Indices
    end: Indices
    measured: Floats
    information: Floats
    loop: NDArray[np.bool_]

    @classmethod
    def of(cls, edges: list[Edge]) -> _Terms:
        return cls(
            np.array([edge.start for edge in edges], dtype=np.intp),
            np.array([edge.end for edge in edges], dtype=np.intp),
            np.array([edge.pose for edge in edges]),
            np.array([edge.information for edge in edges]),
            np.array([edge.loop for edge in edges]),
        )

    def errors(self, poses: Floats) -> Floats:
        step = relative(poses[self.start], poses[self.end])
        off = step - self.measured
        off[:, 2] = wrapped(off[:, 2])
        return np.asarray(off, dtype=np.float64)

    def chi2(self, errors: Floats) -> Floats:
        found: Floats = np.einsum("ni,nij,nj->n", errors, self.information, errors)
        return found

    def linearised(self, poses: Floats, errors: Floats, weights: Floats) -> _Linear:
        count = len(self.start)
        step = relative(poses[self.start], poses[self.end])
        heading = poses[self.start, 2]
        c, s = np.cos(heading), np.sin(heading)
        a, b = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
        a[:, 0, 0], a[:, 0, 1], a[:, 0, 2] = -c, -s, step[:, 1]
        a[:, 1, 0], a[:, 1, 1], a[:, 1, 2] = s, -c, -step[:, 0]
        a[:, 2, 2] = -1.0
        b[:, 0, 0], b[:, 0, 1], b[:, 1, 0], b[:, 1, 1] = c, s, -s, c
        b[:, 2, 2] = 1.0
        information = self.information * weights[:, None, None]
        aw, bw = np.swapaxes(a, 1, 2) @ information, np.swapaxes(b, 1, 2) @ information
        gradient = np.zeros((len(poses), 3))
        np.add.at(gradient, self.start, np.einsum("nij,nj->ni", aw, errors))
        np.add.at(gradient, self.end, np.einsum("nij,nj->ni", bw, errors))
        return _Linear(aw @ a, aw @ b, bw @ b, gradient)


@dataclass(frozen=True)
class _Order:
    """The poses but the first one in levels of a breadth-first search, merged to blocks."""

    block: Indices  # (n,) of each pose; -1: fixed
    place: Indices  # (n,) in its block
    sizes: list[int]

    @classmethod
    def of(cls, count: int, terms: _Terms) -> _Order:
        """Raises ValueError if a pose is connected with none."""
        beside = _neighbours(count, terms)
        free = np.ones(count, dtype=np.bool_)
        free[0] = False
        block = np.full(count, -1, dtype=np.intp)
        place = np.zeros(count, dtype=np.intp)
        sizes: list[int] = []
        seen = ~free
        for pose in range(1, count):
            if seen[pose]:
                continue
            # Two searches: the farthest pose of the first one is an end of the graph.
            levels = _levels(pose, beside, seen.copy())
            levels = _levels(int(levels[-1][0]), beside, seen)
            opened = -1
            for level in levels:
                for begin in range(0, len(level), LARGEST):
                    part = level[begin : begin + LARGEST]
                    if opened < 0 or sizes[opened] >= BLOCK:
                        sizes.append(0)
                        opened = len(sizes) - 1
                    block[part] = opened
                    place[part] = sizes[opened] + np.arange(len(part))
                    sizes[opened] += len(part)
        return cls(block, place, sizes)

    def solve(self, terms: _Terms, linear: _Linear, damping: float) -> Sliced[Floats]:
        """The step (n, 3) of Gauss-Newton. Raises ValueError if a pose is not determined."""
        sizes, first = self.sizes, np.concatenate([[0], np.cumsum(self.sizes)])
        count = len(sizes)
        diagonal = [np.zeros((size, size, 3, 3)) for size in sizes]
        beside: list[dict[int, Floats]] = [{} for _ in sizes]
        i, j = self.block[terms.start], self.block[terms.end]
        p, q = self.place[terms.start], self.place[terms.end]
        for own, at, part in ((i, p, linear.start_start), (j, q, linear.end_end)):
            for k, edges in _grouped(own):
                np.add.at(diagonal[k], (at[edges], at[edges]), part[edges])
        flipped = np.swapaxes(linear.start_end, 1, 2)
        free = (i >= 0) & (j >= 0)
        for k, edges in _grouped(np.where(free & (i == j), i, -1)):
            np.add.at(diagonal[k], (p[edges], q[edges]), linear.start_end[edges])
            np.add.at(diagonal[k], (q[edges], p[edges]), flipped[edges])
        for low, high, row, column, part in (
            (i, j, p, q, linear.start_end),
            (j, i, q, p, flipped),
        ):
            for pair, edges in _grouped(np.where(free & (low < high), low * count + high, -1)):
                k, other = divmod(pair, count)
                shape = (sizes[k], sizes[other], 3, 3)
                into = beside[k].setdefault(other, np.zeros(shape))
                np.add.at(into, (row[edges], column[edges]), part[edges])
        yield EDGE_WORK * len(i)
        free_poses = np.flatnonzero(self.block >= 0)
        right = np.zeros((first[-1], 3))
        rows = first[self.block[free_poses]] + self.place[free_poses]
        right[rows] = -linear.gradient[free_poses]
        solved = yield from _banded(
            [_flat(part) + damping * np.eye(3 * len(part)) for part in diagonal],
            [{other: _flat(part) for other, part in row.items()} for row in beside],
            [right[a:b].ravel() for a, b in pairwise(first)],
        )
        step = np.zeros_like(linear.gradient)
        step[free_poses] = np.concatenate(solved).reshape(-1, 3)[rows]
        return step


def _neighbours(count: int, terms: _Terms) -> list[Indices]:
    """The poses that each pose has an edge to, in ascending order."""
    ends = np.concatenate([terms.start, terms.end])
    others = np.concatenate([terms.end, terms.start])
    order = np.lexsort((others, ends))
    cuts = np.searchsorted(ends[order], np.arange(1, count))
    return np.split(others[order], cuts)


def _levels(root: int, beside: list[Indices], seen: NDArray[np.bool_]) -> list[Indices]:
    """Poses by their distance from a root; marks them as seen."""
    seen[root] = True
    levels = [np.array([root], dtype=np.intp)]
    while True:
        near = np.unique(np.concatenate([beside[pose] for pose in levels[-1].tolist()]))
        near = near[~seen[near]]
        if not len(near):
            return levels
        seen[near] = True
        levels.append(near)


def _grouped(blocks: Indices) -> list[tuple[int, Indices]]:
    """The edges of each block that is not negative."""
    order = np.argsort(blocks, kind="stable")
    kinds, begins = np.unique(blocks[order], return_index=True)
    parts = np.split(order, begins[1:])
    return [(int(k), part) for k, part in zip(kinds, parts, strict=True) if k >= 0]


def _flat(blocks: Floats) -> Floats:
    """(a, b, 3, 3) as (3 a, 3 b)."""
    a, b = blocks.shape[:2]
    return np.asarray(blocks.transpose(0, 2, 1, 3).reshape(3 * a, 3 * b))


def _banded(
    diagonal: list[Floats], beside: list[dict[int, Floats]], right: list[Floats]
) -> Sliced[list[Floats]]:
    """Solve a symmetric system of blocks. Raises ValueError if it is singular.

    `beside` has the blocks right of each one on the diagonal, by their columns. All three lists are
    used up.
    """
    eliminated: list[tuple[list[int], Floats, Floats]] = []  # of each block: S^-1 B and S^-1 r
    for k, schur in enumerate(diagonal):
        others = sorted(beside[k])
        coupled = [beside[k][other] for other in others]
        try:
            both: Floats = np.asarray(
                np.linalg.solve(schur, np.column_stack([*coupled, right[k]])), dtype=np.float64
            )
        except np.linalg.LinAlgError:
            raise ValueError("the graph is not connected") from None
        to_next, own = both[:, :-1], both[:, -1]
        eliminated.append((others, to_next, own))
        yield len(schur) ** 2 * (len(schur) + 2 * both.shape[1]) // FLOPS
        ends = np.cumsum([0, *(block.shape[1] for block in coupled)]).tolist()
        columns = [to_next[:, a:b] for a, b in pairwise(ends)]
        for at, (other, block) in enumerate(zip(others, coupled, strict=True)):
            diagonal[other] = diagonal[other] - block.T @ columns[at]
            right[other] = right[other] - block.T @ own
            for beyond, column in zip(others[at + 1 :], columns[at + 1 :], strict=True):
                change = block.T @ column
                known = beside[other].get(beyond)
                beside[other][beyond] = -change if known is None else known - change
            if len(others) > 1:
                yield 2 * block.size * (ends[-1] - ends[at]) // FLOPS
        beside[k] = {}
    solved: list[Floats] = [np.zeros(0)] * len(diagonal)
    for k in range(len(diagonal) - 1, -1, -1):
        others, to_next, own = eliminated[k]
        later = [solved[other] for other in others]
        solved[k] = own - to_next @ np.concatenate(later) if later else own
    return solved
