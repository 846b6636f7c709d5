"""What is left of a launcher that was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from armadico.launch.processes import Process, orphans
from armadico.mesh.sockets import RUNTIME_VARIABLE

SOON = 20.0
NAMESPACE = f"orphans-{os.getpid()}"


@pytest.mark.parametrize("tied", [False, True])
def test_one_that_hangs_when_its_launcher_is_killed_is_found(
    tmp_path: Path, tied: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that was tied to its launcher leaves by itself, but for one that cannot."""
    words = ["agent", "goto", "--namespace", NAMESPACE]
    script = (
        "import os, sys, time; from pathlib import Path;"
        " from armadico.launch.processes import Process;"
        f" print(Process('goto', {words!r}, Path('log'), tied={tied}).popen.pid, flush=True);"
        " time.sleep(1e6)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], cwd=tmp_path, stdout=subprocess.PIPE
    ) as launcher:
        assert launcher.stdout is not None
        orphan = psutil.Process(int(launcher.stdout.readline()))
        orphan.suspend()
        while orphan.status() != psutil.STATUS_STOPPED:
            os.sched_yield()  # until then it may be within exec, without words or environment
        launcher.send_signal(signal.SIGKILL)
    try:
        assert [(name, found.pid) for name, found in orphans(NAMESPACE)] == [("goto", orphan.pid)]
        monkeypatch.setenv(RUNTIME_VARIABLE, str(tmp_path))
        assert orphans(NAMESPACE) == [], "it is of a society with another folder of sockets"
    finally:
        orphan.kill()
        psutil.wait_procs([orphan], timeout=SOON)


def test_a_process_is_started_whatever_has_become_of_its_log(tmp_path: Path) -> None:
    cleaned, taken = tmp_path / "gone" / "goto.log", tmp_path / "folder.log"
    taken.mkdir()
    for log in (cleaned, taken):
        process = Process("goto", ["--version"], log)
        assert process.popen.wait(SOON) == 0
        assert process.last_lines()
    assert "armadico" in cleaned.read_text()
