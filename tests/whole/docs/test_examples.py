"""The scripts in `examples/`, run as they stand, but for how many seeds and how long."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import armadico
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.mesh.topology import NAMESPACE_VARIABLE
from tests.runtime_folder import fresh_folder
from tests.whole.docs.blocks import ROOT
from tests.whole.docs.shell import Shell
from tests.whole.docs.test_tutorial import SOCIETY, do, shell  # noqa: F401 - a fixture
from tests.whole.docs.watcher import watching

EXAMPLES = ROOT / "examples"
SAYS = {
    "three_lines.py": "reached; 3",
    "wanderer.py": "{'wanderer': 100.0}",
    "experiment.py": "abrupt",
    "planner.py": "take-photo(2.0): photo in R21",
}
"""What each of those under a virtual clock prints."""

LESS = {"range(10)": "range(2)", "limit=60.0": "limit=20.0"}

GUEST = "watch_and_stop.py"


def run(name: str, folder: Path, **more: str) -> str:
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    for there, less in LESS.items():
        text = text.replace(there, less)
    done = subprocess.run(
        [sys.executable, "-c", text],
        cwd=folder,
        env=os.environ | more,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.long
@pytest.mark.parametrize("name", SAYS)
def test_an_example_under_a_virtual_clock(name: str, tmp_path: Path) -> None:
    assert SAYS[name] in run(name, tmp_path)


def test_the_guest_alone_says_what_to_start_first(tmp_path: Path) -> None:
    text = (EXAMPLES / GUEST).read_text(encoding="utf-8").replace("timeout=5.0", "timeout=0.1")
    done = subprocess.run(
        [sys.executable, "-c", text],
        cwd=tmp_path,
        env=os.environ | {RUNTIME_VARIABLE: fresh_folder()},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 1
    assert "armadico run sc4" in done.stderr


@pytest.mark.long
@pytest.mark.live
def test_the_guest_sees_the_robot_drive_and_stops_it(shell: Shell) -> None:  # noqa: F811
    do(shell, "society")
    with watching(shell) as watcher:
        watcher.everybody(SOCIETY)
    where = {RUNTIME_VARIABLE: shell.sockets, NAMESPACE_VARIABLE: shell.namespace}
    with pytest.MonkeyPatch.context() as patched:
        for name, value in where.items():
            patched.setenv(name, value)
        with armadico.connect() as guest:
            here = guest.latest(armadico.Pose, timeout=30.0)
            guest.goto(here.x + 4.0, here.y, 0.0, direct=True)
            said = run(GUEST, shell.folder, **where)
    assert "goto" in said
    assert said.endswith("m, by a guest\n")
