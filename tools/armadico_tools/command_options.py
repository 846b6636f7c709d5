"""What the laboratory's commands share: options of a series, how it begins and is interrupted."""

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
    """How many processes share the work."""
    made.add_argument(
        "--jobs", type=int, metavar="J", help="so many processes (default: one a core)"
    )


def add_out(made: argparse.ArgumentParser, folder: str, what: str) -> None:
    made.add_argument(
        "--out",
        type=Path,
        default=Path(folder),
        metavar="DIR",
        help=f"where {what} (default: {folder})",
    )


def add_json(made: argparse.ArgumentParser) -> None:
    """--json: the results, for programs."""
    made.add_argument("--json", action="store_true", help="what came of it as JSON on stdout")


def at_least(args: argparse.Namespace, **least: int) -> None:
    """Raises UsageError for a number that is given and smaller."""
    for name, bound in least.items():
        value = getattr(args, name)
        if value is not None and value < bound:
            raise UsageError(f"--{name} {value}: at least {bound}")


def over(
    function: Callable[[T], R],
    tasks: Sequence[T],
    args: argparse.Namespace,
    label: str,
    done: Callable[[T, R], None],
) -> bool:
    """A function over tasks, by as many processes as were asked for; False on Ctrl-C."""
    from armadico.cli import pool

    count = 0

    def counted(task: T, result: R) -> None:
        nonlocal count
        done(task, result)
        count += 1

    try:
        pool.over(function, tasks, args.jobs or os.cpu_count() or 1, label, counted)
    except KeyboardInterrupt:
        options.say(f"interrupted after {count} of {len(tasks)} {label}")
        return False
    return True
