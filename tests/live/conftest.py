"""A mesh of each test's own: ports, namespace and a folder for the logs."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from armadico.config.scenarios import Scenario
from armadico.mesh.ports import private_endpoints
from armadico.mesh.topology import ENDPOINTS_VARIABLE
from tests.live.society import LINE, Observer, Society, launcher_of, mesh_of

NAMESPACE = f"live-test-{os.getpid()}"

Start = Callable[..., Society]


@pytest.fixture(autouse=True)
def apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Inherited by every process that the test starts."""
    monkeypatch.setenv(ENDPOINTS_VARIABLE, private_endpoints())
    monkeypatch.setenv("ARMADICO_NAMESPACE", NAMESPACE)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


@pytest.fixture
def start(apart: None) -> Iterator[Start]:
    """Start a society that drives; it is taken down after the test."""
    with ExitStack() as stack:

        def make(scenario: Scenario = LINE) -> Society:
            mesh = stack.enter_context(mesh_of(NAMESPACE))
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
    with mesh_of(NAMESPACE) as mesh:
        yield Observer(mesh)
