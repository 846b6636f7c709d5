"""`armadico mcp`: what comes on its standard input, and whom it starts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from armadico.cli.mcp import Helper, reading
from armadico.launch import processes
from armadico.observe.mcp.lines import LONGEST

SOON = 30.0


def _lines(*pieces: bytes) -> list[bytes]:
    """What becomes of what is written, piece by piece, until its end."""
    there, here = os.pipe()
    lines = reading(there)
    for piece in pieces:
        with os.fdopen(os.dup(here), "wb", buffering=0) as file:
            file.write(piece)
    os.close(here)
    found = [*iter(lambda: lines.get(timeout=SOON), b"")]
    os.close(there)
    return found


def test_a_line_may_come_in_pieces_and_the_last_one_without_an_end() -> None:
    assert _lines(b"on", b"e\ntwo\n", b"\n  \n", b"three") == [b"one", b"two", b"three"]


@pytest.mark.parametrize("end", [b"\nnext\n", b""])
def test_of_a_line_that_is_too_long_no_more_is_kept_than_shows_that(end: bytes) -> None:
    found = _lines(b"a\n", *[b"x" * 40_000] * 5, end)
    assert found[0] == b"a"
    assert len(found[1]) == LONGEST + 1
    assert found[2:] == ([b"next"] if end else [])


def test_who_leaves_while_somebody_may_still_write_is_not_aborted_for_that() -> None:
    program = "from armadico.cli.mcp import reading; print(reading(0).get())"
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as popen:
        assert popen.stdin is not None
        popen.stdin.write(b"hello\n")
        popen.stdin.flush()
        assert popen.wait(SOON) == 0
        assert popen.stdout is not None
        assert popen.stdout.read() == b"b'hello'\n"
        assert popen.stderr is not None
        assert popen.stderr.read() == b""


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
