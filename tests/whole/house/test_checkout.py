"""The tree is the package: a checkout imports as it is installed, and nothing comes before it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from armadico.launch.processes import Process
from tests.whole.house.tree import FOLDERS, ROOT, package_files, sources

EVIL = "raise SystemExit('what lies in the current folder was imported')\n"
HOSTILE = ("armadico/__init__.py", "json.py", "selectors.py", "socket.py", "cbor2.py")

WORKERS = """
from armadico.cli.pool import over
if __name__ == "__main__":
    print(over(abs, [-1, -2], 2, "workers"))
"""


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder has packages that go by the names of ours and of others."""
    for name in HOSTILE:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(EVIL, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return tmp_path


def test_every_source_is_in_the_package_once() -> None:
    found = Counter(path for _, path in package_files() if path.suffix == ".py")
    there = {path for folder in FOLDERS for path in sources(folder)}
    assert set(found) == there
    assert set(found.values()) == {1}


def test_a_bare_checkout_imports_as_it_is_installed() -> None:
    call = "import armadico.agents.driving.goto as it; print(it.__name__, it.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", call],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == [
        "armadico.agents.driving.goto",
        str(ROOT / "armadico/agents/driving/goto.py"),
    ]


@pytest.mark.usefixtures("hostile")
@pytest.mark.parametrize("tied", [False, True])
def test_a_process_imports_nothing_from_the_current_folder(tmp_path: Path, tied: bool) -> None:
    process = Process("version", ["--version"], tmp_path / "log", tied=tied)
    assert process.popen.wait(30) == 0, process.last_lines()
    assert process.last_lines().startswith("    armadico ")


def test_workers_import_nothing_from_the_current_folder(hostile: Path) -> None:
    script = hostile / "bin" / "script.py"  # as commands are installed: apart, and without -P
    script.parent.mkdir()
    script.write_text(WORKERS, encoding="utf-8")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.stdout == "[1, 2]\n", done.stderr
