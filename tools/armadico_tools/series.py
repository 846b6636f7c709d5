"""How a series of runs is run: kept results are read, the others are made and kept.

Each result is stored as soon as it is known, so a series that was interrupted continues. Every
hundredth run is made twice; if the results differ, neither is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import closing
from typing import Final, TypeVar

import msgspec

from armadico.cli import options, pool
from armadico.cli.options import FailedError
from armadico.cli.pool import Pool
from armadico_tools.results import Kept

T = TypeVar("T")
R = TypeVar("R")

AGAIN: Final = 100
"""Each run of this number is made twice."""

LONGEST: Final = 300
"""Characters of a result that are shown where two differ."""


class NotRepeatableError(FailedError):
    """The same run gave two results."""


def nothing(_task: object, _result: object) -> None:
    """Do nothing with a result."""


def run(
    function: Callable[[T], R],
    tasks: Sequence[T],
    where: int | Pool,
    label: str,
    done: Callable[[T, R], None] = nothing,
    *,
    repeatable: bool = True,
) -> list[R]:
    """The results in the order of the tasks; `done` is called with each as soon as it is known.

    Raises NotRepeatableError, BrokenExecutor if processes are lost, and what the function raises.
    """
    again = range(AGAIN - 1, len(tasks), AGAIN) if repeatable else range(0)
    twice = [*tasks, *(tasks[at] for at in again)]
    found: dict[int, R] = {}
    with closing(pool.each(function, twice, where, label)) as results:
        for index, result in results:
            at = index if index < len(tasks) else again[index - len(tasks)]
            if at not in found:
                found[at] = result
                if at in again:
                    continue  # until it is known again
            elif not same(found[at], result):
                raise NotRepeatableError(
                    f"{function.__qualname__} of {_shown(tasks[at])} gave two results:"
                    f" {_shown(found[at])} and {_shown(result)}; neither is kept"
                )
            done(tasks[at], result)
    return [found[at] for at in range(len(tasks))]


def same(one: object, other: object) -> bool:
    """Whether two results are the same, to the last digit."""
    try:
        return msgspec.json.encode(one) == msgspec.json.encode(other)
    except (TypeError, ValueError):
        return one == other


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def over(
    function: Callable[[T], R],
    tasks: Sequence[T],
    where: int | Pool,
    label: str,
    done: Callable[[T, R], None],
) -> bool:
    """As `run`. Returns False after Ctrl-C, or if processes are lost."""
    count = 0

    def counted(task: T, result: R) -> None:
        nonlocal count
        done(task, result)
        count += 1

    try:
        run(function, tasks, where, label, counted)
    except (KeyboardInterrupt, BrokenExecutor) as error:
        why = "interrupted" if isinstance(error, KeyboardInterrupt) else lost(error)
        options.report(f"{why} after {count} of {len(tasks)} {label}")
        return False
    return True


def lost(error: BrokenExecutor) -> str:
    """Why processes were lost, in a few words."""
    from concurrent.futures.process import BrokenProcessPool

    return "a process was killed" if isinstance(error, BrokenProcessPool) else str(error)


def known(
    store: Kept[R], tasks: Sequence[T], of: Callable[[T], str]
) -> tuple[dict[int, R], list[int]]:
    """The stored results by the index of their task, and the indices of the other tasks."""
    found = store.read(list(map(of, tasks)))
    return found, [at for at in range(len(tasks)) if at not in found]
