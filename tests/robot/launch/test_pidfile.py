"""Who has a share up: by a lock, whatever the file says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from armadico.launch.pidfile import PidFile, Share, TakenError, shares
from armadico.mesh.sockets import RUNTIME_VARIABLE

HOLDER = """
import sys
from armadico.launch.pidfile import PidFile, Share
with PidFile("robot1", "lab1") as file:
    file.write(Share(4711, "lab1", "robot1", ("goto",), "logs"))
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RUNTIME_VARIABLE, str(tmp_path))


def share(host: str = "lab1", namespace: str = "robot1") -> Share:
    return Share(1, host, namespace, ("goto", "avoid"), "somewhere")


def test_what_a_killed_process_left_is_nobodys() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        assert [found.pid for found in shares("robot1")] == [4711]
    finally:
        process.kill()
        process.communicate()
    assert list(shares("robot1")) == []
    with PidFile("robot1", "lab1") as file:
        file.write(share())
        assert list(shares("robot1")) == [share()]


@pytest.mark.parametrize("text", ["", "{", "[]", '{"pid": 1}', "\x00"])
def test_a_file_that_says_nothing_sensible_names_nobody(text: str) -> None:
    with PidFile("robot1", "lab1") as file:
        file.path.write_text(text)
        assert list(shares("robot1")) == []
        with pytest.raises(TakenError) as caught, PidFile("robot1", "lab1"):
            pass
        assert caught.value.share is None
