"""`armadico mcp`: whom it starts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from armadico.cli.mcp import Helper
from armadico.launch import processes


def test_one_that_did_not_answer_is_ended_before_another_is_started(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    alive: list[object] = []

    class Process:
        def __init__(self, *_: Any, **__: Any) -> None:
            self.popen = object()
            alive.append(self.popen)

    monkeypatch.setattr(processes, "Process", Process)
    monkeypatch.setattr(processes, "end", alive.remove)
    with Helper(["--namespace", "robot1"]) as helper:
        for _ in range(3):
            helper.start()
            assert len(alive) == 1
    assert not alive


def test_its_folder_goes_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with Helper([]):
        assert [*tmp_path.iterdir()]
    assert not [*tmp_path.iterdir()]
