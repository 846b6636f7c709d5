"""What could go otherwise, and which way it goes: picked by a search, or by a script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

Step = Mapping[str, str]
"""What went otherwise than it does by itself in one cycle: what, and how."""


class Picker(Protocol):
    """Decides what may go one way or another."""

    def pick(self, what: str, ways: Sequence[str], cost: int) -> str:
        """One of the ways; the first is what happens by itself, any other costs as much."""


class Enumerator:
    """Goes through every way that one cycle can go, at most so dear altogether.

    The cycle is run again and again, each time with the next picks. What may be picked depends on
    what was picked before, so the tree is found while it is walked.
    """

    def __init__(self, budget: int) -> None:
        self.budget = budget
        self.cost = 0
        self._prefix: list[int] = []
        self._path: list[tuple[str, Sequence[str], int]] = []
        self._names: dict[str, int] = {}

    def begin(self) -> None:
        """Another run of the cycle."""
        self._path = []
        self._names = {}
        self.cost = 0

    def pick(self, what: str, ways: Sequence[str], cost: int) -> str:
        """As the picks of this run say; beyond them, what happens by itself."""
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
        """What was picked in this run."""
        return tuple((what, ways[way]) for what, ways, way in self._path if way)

    def advance(self) -> bool:
        """Go on to the next run; False when there is none."""
        path = self._path
        while path:
            _, ways, way = path[-1]
            if way + 1 < len(ways):
                self._prefix = [taken for _, _, taken in path[:-1]] + [way + 1]
                return True
            path.pop()
        return False


class Script:
    """Picks what `step` has. Raises ValueError, on `done`, if one of those was never picked."""

    def __init__(self, step: Step) -> None:
        self._step = dict(step)
        self._names: dict[str, int] = {}

    def pick(self, what: str, ways: Sequence[str], cost: int) -> str:  # noqa: ARG002
        """What the script has for it, else what happens by itself."""
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
        """The cycle is over. Who has nothing to draw for, by other rules, draws nothing."""
        left = {what: way for what, way in self._step.items() if not what.startswith("draw of")}
        if left:
            raise ValueError(f"nothing of the kind was under way: {left}")
