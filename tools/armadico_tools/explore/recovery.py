"""Worlds that never recover, and the longest recovery of the others, in the graph of all worlds.

An edge is a cycle without a fault. So all that follows from a world without faults is in the graph,
and a loop in it is a run that lasts forever.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

SELDOM: Final = 3
"""Eventually no contender is obeyed in at most one of so many cycles, though one could be."""


class Never(Exception):  # noqa: N818 - a result, not a failure
    """Worlds that follow each other forever without recovery."""

    def __init__(self, loop: list[int]) -> None:
        super().__init__(f"{len(loop)} worlds forever")
        self.loop = loop


class Graph:
    """Worlds by number, and the worlds that follow each without a fault."""

    def __init__(self, following: Sequence[Sequence[int]]) -> None:
        self._following = following

    def longest(self, bad: Sequence[bool]) -> int:
        """The most bad worlds one after the other. Raises Never if there is no end to them."""
        left = [0] * len(bad)
        for group in self._groups(bad):
            one = group[0]
            if len(group) > 1 or one in self._following[one]:
                raise Never(self._round(one, set(group)))
            left[one] = 1 + max((left[n] for n in self._following[one]), default=0)
        return max(left, default=0)

    def settles_within(self, among: Sequence[bool], bad: Sequence[bool]) -> int:
        """Most cycles until no bad world follows. Raises Never if one always may."""
        groups = self._groups(among)
        left = [0] * len(among)
        for group in groups:  # successors come first
            members = set(group)
            beyond = max(
                (left[n] for one in group for n in self._following[one] if n not in members),
                default=0,
            )
            loops = len(group) > 1 or group[0] in self._following[group[0]]
            if loops and any(bad[one] for one in group):
                raise Never(self._round(next(one for one in group if bad[one]), members))
            for one in group:
                left[one] = beyond + 1 if beyond or bad[one] else 0
        return max(left, default=0)

    def mostly_good(self, bad: Sequence[bool], among: int) -> None:
        """Raises Never if worlds follow each other forever and more than one in `among` is bad."""
        for group in self._groups([True] * len(bad)):
            if len(group) > 1 and any(bad[one] for one in group):
                gain = {one: among - 1 if bad[one] else -1 for one in group}
                loop = self._gaining(gain)
                if loop:
                    raise Never(loop)

    def _gaining(self, gain: Mapping[int, int]) -> list[int]:
        """A loop with a positive sum; empty if there is none (Bellman, Ford)."""
        best = dict.fromkeys(gain, 0)
        parent: dict[int, int] = {}
        changed = list(gain)
        while changed:
            later: dict[int, None] = {}
            for one in changed:
                for other in self._following[one]:
                    if other in gain and best[one] + gain[other] > best[other]:
                        best[other] = best[one] + gain[other]
                        parent[other] = one
                        later[other] = None
            changed = list(later)
            loop = _loop_of(parent, changed)
            if loop:
                return loop
        return []

    def _round(self, start: int, members: set[int]) -> list[int]:
        """The shortest way from a world back to itself."""
        parent: dict[int, int] = {}
        layer = [start]
        while layer:
            later: list[int] = []
            for one in layer:
                for other in self._following[one]:
                    if other == start:
                        loop = [one]
                        while loop[-1] != start:
                            loop.append(parent[loop[-1]])
                        return loop[::-1]
                    if other in members and other not in parent:
                        parent[other] = one
                        later.append(other)
            layer = later
        raise AssertionError("not a loop")

    def _groups(self, among: Sequence[bool]) -> list[list[int]]:
        """Strongly connected worlds, successors first (Tarjan, without recursion)."""
        following = self._following
        index = [0] * len(among)
        low = [0] * len(among)
        on_stack = bytearray(len(among))
        stack: list[int] = []
        groups: list[list[int]] = []
        count = 0
        for root in range(len(among)):
            if not among[root] or index[root]:
                continue
            path = [(root, 0)]
            while path:
                one, at = path.pop()
                if at == 0:
                    count += 1
                    index[one] = low[one] = count
                    stack.append(one)
                    on_stack[one] = 1
                out = following[one]
                while at < len(out):
                    other = out[at]
                    at += 1
                    if not among[other]:
                        continue
                    if not index[other]:
                        path += [(one, at), (other, 0)]
                        break
                    if on_stack[other]:
                        low[one] = min(low[one], index[other])
                else:
                    if low[one] == index[one]:
                        group: list[int] = []
                        while not group or group[-1] != one:
                            group.append(stack.pop())
                            on_stack[group[-1]] = 0
                        groups.append(group)
                    if path:
                        low[path[-1][0]] = min(low[path[-1][0]], low[one])
        return groups


def _loop_of(parent: Mapping[int, int], among: Iterable[int]) -> list[int]:
    """A loop among the ancestors of some worlds; empty if there is none."""
    seen: dict[int, int] = {}
    for start in among:
        one: int | None = start
        while one is not None and one not in seen:
            seen[one] = start
            one = parent.get(one)
        if one is not None and seen[one] == start:
            loop = [one]
            while parent[loop[-1]] != one:
                loop.append(parent[loop[-1]])
            return loop[::-1]
    return []
