"""Work over many processes: none of them outlives who handed it out."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import psutil
import pytest

from tests.programs import SOON, starter

WORK = """
import os, threading

def work(number):
    with open(f"{number}.pid", "w") as file:
        file.write(str(os.getpid()) + "\\n")
    os.write(1, b"at work\\n")  # at once: print writes the end of the line by itself
    threading.Event().wait()
"""


@pytest.mark.long(but=("killed", "interrupted"))
@pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux tells a process of its parent's end"
)
@pytest.mark.parametrize(
    "how",
    [signal.SIGTERM, signal.SIGKILL, signal.SIGINT],
    ids=["terminated", "killed", "interrupted"],
)
def test_workers_end_with_whoever_handed_the_work_out(how: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "work_for_two.py").write_text(WORK)
    script = "from work_for_two import work\nfrom armadico.cli.pool import over\n"
    script += "over(work, [1, 2], 2, 'work')"
    with starter([sys.executable, "-c"], cwd=tmp_path) as start:
        parent = start(script)
        assert parent.stdout is not None
        assert [parent.stdout.readline() for _ in range(2)] == ["at work\n"] * 2
        pids = [int((tmp_path / f"{number}.pid").read_text()) for number in (1, 2)]
        workers = [psutil.Process(pid) for pid in pids]
        parent.send_signal(how)
        parent.wait(SOON)
        _, left = psutil.wait_procs(workers, timeout=SOON)
    assert not left
