"""A mesh of each test's own: sockets, namespace and a folder for the logs."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from armadico.config.scenarios import Scenario
from armadico.mesh.sockets import RUNTIME_VARIABLE
from tests.robot.society import Observer, mesh_of
from tests.runtime_folder import fresh_folder
from tests.whole.live.society import LINE, Society, launcher_of, observers_mesh

NAMESPACE = f"live-test-{os.getpid()}"

Start = Callable[..., Society]


@pytest.fixture(autouse=True)
def apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Inherited by every process that the test starts."""
    monkeypatch.setenv(RUNTIME_VARIABLE, fresh_folder())
    monkeypatch.setenv("ARMADICO_NAMESPACE", NAMESPACE)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


@pytest.fixture
def start(apart: None) -> Iterator[Start]:
    """Start a society that drives; it is taken down after the test."""
    with ExitStack() as stack:

        def make(scenario: Scenario = LINE) -> Society:
            mesh = stack.enter_context(observers_mesh(NAMESPACE))
            launcher = stack.enter_context(
                launcher_of(stack.enter_context(mesh_of(NAMESPACE)), scenario)
            )
            society = Society(mesh, launcher, scenario)
            society.drive()
            return society

        yield make


@pytest.fixture
def observer(apart: None) -> Iterator[Observer]:
    """Somebody who watches a run that another process launched."""
    with observers_mesh(NAMESPACE) as mesh:
        yield Observer(mesh)
