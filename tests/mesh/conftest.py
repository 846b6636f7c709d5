"""Private loopback endpoints and real processes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from armadico.mesh.ports import private_endpoints
from armadico.mesh.topology import ENDPOINTS_VARIABLE, topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.runtime.client import Client
from tests.programs import starter

TOY = Path(__file__).parent / "toy_process.py"
NAMESPACE = "test"

Spawn = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def endpoints() -> str:
    return private_endpoints()


@pytest.fixture
def join(endpoints: str) -> Iterator[Callable[..., ZenohMesh]]:
    """Join the mesh of this test, as often as wanted."""
    with ExitStack() as stack:

        def make(namespace: str = NAMESPACE) -> ZenohMesh:
            where = topology(environ={ENDPOINTS_VARIABLE: endpoints})
            return stack.enter_context(ZenohMesh(namespace, where))

        yield make


@pytest.fixture
def client(join: Callable[..., ZenohMesh]) -> Client:
    return Client(join())


@pytest.fixture
def spawn(endpoints: str) -> Iterator[Spawn]:
    """Start toy agents as processes on the mesh of this test."""
    env = os.environ | {ENDPOINTS_VARIABLE: endpoints}
    with starter([sys.executable, str(TOY)], env, stdout=None) as begin:

        def start(kind: str = "calm") -> subprocess.Popen[str]:
            return begin(kind, NAMESPACE)

        yield start
