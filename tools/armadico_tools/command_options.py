"""Options that the laboratory's commands share, and how they run a series."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from armadico.cli import options
from armadico.cli.parsing import at_least, flag, option

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class Series:
    """How a series of runs is run and printed."""

    jobs: int | None = option(
        "run J processes (default: one per core)", metavar="J", must=at_least(1)
    )
    json: bool = flag("print the results as JSON")

    @property
    def processes(self) -> int:
        return self.jobs or os.cpu_count() or 1


def over(
    function: Callable[[T], R],
    tasks: Sequence[T],
    processes: int,
    label: str,
    done: Callable[[T, R], None],
) -> bool:
    """Apply a function to tasks in processes. Returns False after Ctrl-C, or if one was killed."""
    from concurrent.futures import BrokenExecutor

    from armadico.cli import pool

    count = 0

    def counted(task: T, result: R) -> None:
        nonlocal count
        done(task, result)
        count += 1

    try:
        pool.over(function, tasks, processes, label, counted)
    except (KeyboardInterrupt, BrokenExecutor) as error:
        why = "a process was killed" if isinstance(error, BrokenExecutor) else "interrupted"
        options.report(f"{why} after {count} of {len(tasks)} {label}")
        return False
    return True
