"""Options that the laboratory's commands share, and how they run a series."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from armadico.cli import options
from armadico.cli.options import UsageError

T = TypeVar("T")
R = TypeVar("R")


def add_jobs(made: argparse.ArgumentParser) -> None:
    """--jobs: the number of processes."""
    made.add_argument(
        "--jobs", type=int, metavar="J", help="run J processes (default: one per core)"
    )


def add_out(made: argparse.ArgumentParser, folder: str, what: str) -> None:
    made.add_argument(
        "--out",
        type=Path,
        default=Path(folder),
        metavar="DIR",
        help=f"write {what} into DIR (default: {folder})",
    )


def add_json(made: argparse.ArgumentParser) -> None:
    made.add_argument("--json", action="store_true", help="print the results as JSON")


def at_least(args: argparse.Namespace, **least: int) -> None:
    """Raises UsageError for a number below its bound."""
    for name, bound in least.items():
        value = getattr(args, name)
        if value is not None and value < bound:
            raise UsageError(f"--{name} must be at least {bound} (got {value})")


def over(
    function: Callable[[T], R],
    tasks: Sequence[T],
    args: argparse.Namespace,
    label: str,
    done: Callable[[T, R], None],
) -> bool:
    """Apply a function to tasks in `--jobs` processes. Returns False after Ctrl-C."""
    from armadico.cli import pool

    count = 0

    def counted(task: T, result: R) -> None:
        nonlocal count
        done(task, result)
        count += 1

    try:
        pool.over(function, tasks, args.jobs or os.cpu_count() or 1, label, counted)
    except KeyboardInterrupt:
        options.report(f"interrupted after {count} of {len(tasks)} {label}")
        return False
    return True
