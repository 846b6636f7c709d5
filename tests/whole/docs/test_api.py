"""The page on Python, run as it stands: its runs first, then its guest in a society that is up."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.mesh.topology import NAMESPACE_VARIABLE
from tests.whole.docs.blocks import Block, blocks
from tests.whole.docs.shell import Shell
from tests.whole.docs.test_tutorial import SOCIETY, do
from tests.whole.docs.watcher import watching

NAMESPACE = "api-test"

SHOWN = [block for block in blocks() if block.document == "docs/api.md"]
GUESTS = [block for block in SHOWN if "armadico.connect" in block.text]


def execute(blocks: list[Block]) -> dict[str, Any]:
    """Run blocks one after another, as a notebook would; what they leave."""
    names: dict[str, Any] = {}
    for block in blocks:
        before = "\n" * (block.line - 1)  # so that a traceback has the page's line
        exec(compile(before + block.text, block.document, "exec"), names)
    return names


@pytest.fixture
def shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Shell]:
    with Shell(tmp_path, NAMESPACE) as made:
        monkeypatch.setenv(RUNTIME_VARIABLE, made.sockets)
        monkeypatch.setenv(NAMESPACE_VARIABLE, NAMESPACE)
        monkeypatch.chdir(tmp_path)
        yield made


@pytest.mark.long
def test_the_runs_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names = execute([block for block in SHOWN if block not in GUESTS])
    assert (tmp_path / "sc4.png").read_bytes().startswith(b"\x89PNG")
    assert names["done"].holders


@pytest.mark.long
@pytest.mark.live
def test_the_guest_of_the_page(shell: Shell) -> None:
    do(shell, "society")
    with watching(shell) as watcher:
        watcher.everybody(SOCIETY)
    names = execute([SHOWN[0], *GUESTS])
    assert len(names["claims"]) >= 5
    assert not names["plan"].refusal
