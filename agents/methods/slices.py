"""Work that takes longer than a cycle, in slices that are bounded by work, not by time.

A slice yields how much work it was, so that the same messages give the same slices on any computer.
The unit is one look-up of a point in a field, about 5 ns on the computer of the documents' figures.
Other costs were measured in this unit.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")

Sliced = Generator[int, None, T]


def finished(work: Sliced[T]) -> T:
    """Do all slices; the result."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            found: T = end.value
            return found
