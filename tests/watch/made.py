"""Recordings of virtual runs, and copies that lack something."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from armadico.core.messages import BidHistory, Card, encode
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.observe.watching import Presence, Received
from armadico.watch.recorder import Recording
from armadico.watch.recordings import rows
from armadico.watch.virtual_recording import BEGUN, Recorded
from tests.watch.observed import LINE


@contextmanager
def recorded(path: Path, run: Rehearsal | None = None) -> Iterator[Rehearsal]:
    """A society that is not started yet, and recorded to a file."""
    run = run or Rehearsal(LINE, Options(seed=4))
    with Recorded(run.mesh, path, run.namespace):
        yield run


def copied(recording: Path, to: Path, keep: Callable[[str, float], bool]) -> Path:
    """Write a recording with the messages to keep, by key and time, s; return its file."""
    kept = Recording(to)
    for row in rows(recording, pytest.fail):
        if keep(row.key, row.t / 1e9 - BEGUN) and (message := row.received) is not None:
            on_query = isinstance(message, Card | BidHistory)
            kept.add(Received(row.namespace, row.key, encode(message), row.t, on_query))
    kept.close()
    return to


def of_two_robots(path: Path) -> Path:
    """A recording of two robots."""
    kept = Recording(path)
    for name in ("robot1", "robot2"):
        kept.add(Presence(name, "goto", f"goto-{name}", True, 10**9))
    kept.close()
    return path
