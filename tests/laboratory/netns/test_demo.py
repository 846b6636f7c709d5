"""The demo over network namespaces, and trials that need hosts."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from armadico.core.judgement import Answer
from armadico.mesh.link_faults import LinkFaults
from armadico_tools.hosts.compose import demo
from tests.laboratory.netns.hosts import NamespaceHosts
from tests.programs import Start, starter

pytestmark = pytest.mark.live

SOON = 240.0  # a bound on a hang; five hosts on a busy machine need more than a minute


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Start]:
    """Start `armadico` with these words; it keeps what it keeps in the test's own folder."""
    with starter(env=os.environ | {"TMPDIR": str(tmp_path)}) as start:
        yield start


def left_behind(folder: Path) -> list[psutil.Process]:
    """Processes that inherited the test's folder, once those that end have had time to."""
    found = [p for p in psutil.process_iter() if str(folder) in _tmpdir(p)]
    return psutil.wait_procs(found, 10.0)[1]


def _tmpdir(process: psutil.Process) -> str:
    try:
        return str(process.environ().get("TMPDIR", ""))
    except psutil.Error:
        return ""


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_host_that_drives_is_killed_another_takes_over_and_it_comes_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mcap")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    lines: list[str] = []
    with NamespaceHosts("sc4", LinkFaults(delay=0.002, jitter=0.001), tmp_path) as hosts:
        judgement = demo(hosts, "sc4", lines.append)
        out = "\n".join([*lines, str(judgement)])
        assert judgement.answer is Answer.YES, f"{out}\n{hosts.last_lines()}"
    story = [
        "goto drives",
        "whose goto drives, is killed",
        "is started again",
        "sc4: reached",
        " is back",
        "Longest time without an obeyed command",
    ]
    said = iter(lines)
    assert all(any(text in line for line in said) for text in story), out
    assert not left_behind(tmp_path)


@pytest.mark.long
def test_a_holder_cut_off_is_replaced_and_its_host_rejoins(run: Start, tmp_path: Path) -> None:
    words = ("--live", "--kind", "holder-cut-off", "--trials", "1", "--json")
    process = run("faults", *words, "--out", str(tmp_path / "out"))
    out, errors = process.communicate(timeout=SOON)
    found = json.loads(out)
    assert not found["violations"], errors
    assert not found["failed"]
    assert {line["figure"] for line in found["lines"]} == {
        "next obeyed",
        "longest silence",
        "rejoined",
    }
    assert not left_behind(tmp_path)
