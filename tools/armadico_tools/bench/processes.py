"""Processes to be measured, on a mesh of their own; nothing is left running.

Not even if the benchmark is killed: agents are tied to it, the floor ends with its standard input.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.mesh.ports import private_endpoints
from armadico.mesh.topology import ENDPOINTS_VARIABLE, topology

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.launch.local import Launcher
    from armadico.launch.society import Options
    from armadico.mesh.zenoh import ZenohMesh

FLOOR: Final = Path(__file__).with_name("floor.py")
LEAVE_S: Final = 3.0
"""What a process may take to leave before it is killed."""

Spawn = Callable[[Sequence[str]], subprocess.Popen[bytes]]


def namespace() -> str:
    """A robot that nobody else has."""
    return f"bench-{os.getpid()}"


@contextmanager
def private_mesh() -> Iterator[ZenohMesh]:
    """A mesh that no other society is on; processes started meanwhile find it."""
    from armadico.mesh.zenoh import ZenohMesh  # noqa: PLC0415 - not for the cheap figures

    before = os.environ.get(ENDPOINTS_VARIABLE)
    os.environ[ENDPOINTS_VARIABLE] = private_endpoints()
    try:
        with ZenohMesh(namespace(), topology()) as mesh:
            yield mesh
    finally:
        if before is None:
            del os.environ[ENDPOINTS_VARIABLE]
        else:
            os.environ[ENDPOINTS_VARIABLE] = before


def society(scenario: Scenario, options: Options, mesh: ZenohMesh) -> Launcher:
    """A whole society that does not outlive its benchmark."""
    from armadico.launch.local import Launcher  # noqa: PLC0415 - not for the cheap figures

    return Launcher(scenario, options, mesh, namespace(), tied=True)


@contextmanager
def processes() -> Iterator[Spawn]:
    """Start processes; they are gone at the end, however it comes."""
    with ExitStack() as stack:

        def spawn(command: Sequence[str]) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is ours; we end them
            )
            stack.callback(end, process)
            return process

        yield spawn


def end(process: subprocess.Popen[bytes]) -> None:
    """Have a process leave, or kill it."""
    process.terminate()
    try:
        process.wait(LEAVE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()


def floor(*arguments: str) -> list[str]:
    """The command line of a process of the floor's."""
    return [sys.executable, "-P", str(FLOOR), *arguments]


def await_ready(process: subprocess.Popen[bytes]) -> None:
    """Wait for a floor process's word. Raises RuntimeError if it ends without one."""
    assert process.stdout is not None, "it was asked for"
    if process.stdout.readline().strip() != b"ready":
        raise RuntimeError(f"the floor did not start: {process.args!r}")
