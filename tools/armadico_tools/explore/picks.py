"""Alternatives, and which one occurs: picked by a search, or by a script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

Step = Mapping[str, str]
"""The alternatives picked in one cycle, by name; those not listed take their default."""


class Picker(Protocol):
    """Picks alternatives."""

    def pick(self, what: str, ways: Sequence[str], cost: int) -> str:
        """One of the ways; the first is the default, any other costs `cost`."""


class Enumerator:
    """Explores every combination of alternatives in one cycle, up to a total cost.

    The cycle is run again and again, each time with the next picks. Which alternatives exist
    depends on earlier picks, so the tree is discovered during the walk.
    """

    def __init__(self, budget: int) -> None:
        self.budget = budget
        self.cost = 0
        self._prefix: list[int] = []
        self._path: list[tuple[str, Sequence[str], int]] = []
        self._names: dict[str, int] = {}

    def begin(self) -> None:
        """Start another run of the cycle."""
        self._path = []
        self._names = {}
        self.cost = 0

    def pick(self, what: str, ways: Sequence[str], cost: int) -> str:
        """The pick of this run; beyond its prefix, the default."""
        if len(ways) < 2:
            return ways[0]
        again = self._names.get(what, 0)
        self._names[what] = again + 1
        if self.cost + cost > self.budget:
            return ways[0]
        if again:
            what = f"{what} ({again + 1})"
        at = len(self._path)
        way = self._prefix[at] if at < len(self._prefix) else 0
        self._path.append((what, ways, way))
        if way:
            self.cost += cost
        return ways[way]

    @property
    def step(self) -> tuple[tuple[str, str], ...]:
        """The picks of this run other than the defaults."""
        return tuple((what, ways[way]) for what, ways, way in self._path if way)

    def advance(self) -> bool:
        """Prepare the next run. Returns False if there is none."""
        path = self._path
        while path:
            _, ways, way = path[-1]
            if way + 1 < len(ways):
                self._prefix = [taken for _, _, taken in path[:-1]] + [way + 1]
                return True
            path.pop()
        return False


class Script:
    """Picks what `step` has. `done` raises ValueError if one of them never came up."""

    def __init__(self, step: Step) -> None:
        self._step = dict(step)
        self._names: dict[str, int] = {}

    def pick(self, what: str, ways: Sequence[str], cost: int) -> str:  # noqa: ARG002
        """The script's pick, else the default."""
        if len(ways) < 2:
            return ways[0]
        again = self._names.get(what, 0)
        self._names[what] = again + 1
        if again:
            what = f"{what} ({again + 1})"
        way = self._step.pop(what, ways[0])
        if way not in ways:
            raise ValueError(f"{what}: {way!r} is none of {', '.join(ways)}")
        return way

    def done(self) -> None:
        """End the cycle. A draw that other rules do not need is ignored."""
        left = {what: way for what, way in self._step.items() if not what.startswith("draw of")}
        if left:
            raise ValueError(f"nothing of the kind was under way: {left}")
