"""What `armadico goto` prints while the robot is under way."""

from __future__ import annotations

from contextlib import ExitStack
from itertools import count

import pytest

from armadico.cli import goto


def test_a_robot_that_is_stopped_for_minutes_does_not_fill_the_screen(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seconds = count()
    monkeypatch.setattr(goto.time, "monotonic", lambda: float(next(seconds)))
    with ExitStack() as stack:
        show = goto._shower(stack, 3.0)
        for _ in range(60):
            show(2.0, "stopped by a person")
        show(1.9, "0.30 m/s")
        show(1.8, "0.30 m/s")
        show(1.7, "0.30 m/s")
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["2.00 m to go, stopped by a person"] * 2
    assert [line[:4] for line in lines[2:]] == ["1.90", "1.70"]


def test_a_goal_that_failed_has_its_reason_also_without_a_timeout() -> None:
    assert goto._unreached("cancelled by ann", None) == "it failed, cancelled by ann"
    assert "not there after 5 s" in goto._unreached(None, 5.0)
