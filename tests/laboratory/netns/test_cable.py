"""A cable that is out for a while in the middle of a mission: it is done all the same."""

from __future__ import annotations

import json
import subprocess
from threading import Event

import pytest

from tests.laboratory.netns.test_monitor import SOON, Bed, bed

__all__ = ["bed"]  # a fixture

pytestmark = pytest.mark.live

GOAL = ("--goal", "6", "0", "0")


@pytest.mark.long(but=("3.0",))
@pytest.mark.parametrize("seconds", [3.0, 10.0])
def test_the_goal_is_reached_though_a_host_is_cut_off_on_the_way(bed: Bed, seconds: float) -> None:
    """For 10 s the other host runs its agents meanwhile."""
    for host in ("robot", "lab"):
        bed.up(host)
    words = ["run", str(bed.scenario), *GOAL, "--attach", "--json", "--no-plot"]
    run = bed.bed.popen(
        "robot",
        ["armadico", *words, *bed.bed.joining("robot")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert run.stderr is not None
    lines = []
    while "goto drives" not in (line := run.stderr.readline()):
        lines.append(line)
        assert line, lines
    bed.plug("lab", False)
    Event().wait(seconds)
    bed.plug("lab", True)
    out, errors = run.communicate(timeout=2 * SOON)
    logs = {host: bed.bed.last_lines(host, 12) for host in bed.ups}
    assert run.returncode == 0, f"{errors}\n{logs}"
    assert json.loads(out)["reached"]
    assert all(process.poll() is None for process in bed.ups.values()), logs
