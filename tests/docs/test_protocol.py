"""The protocol page is enough for a program that has nothing of ours."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.docs.blocks import files
from tests.docs.shell import Shell
from tests.docs.watcher import watching

PAGE = "docs/protocol.md"
NAMESPACE = "protocol-test"
ROBOT = "armadico-agent encoder &\narmadico sim sc1 &\narmadico-agent robot &\n"


def test_the_program_on_the_page_knows_nothing_of_ours() -> None:
    names = {
        name
        for node in ast.walk(ast.parse(files(PAGE)["stranger.py"]))
        if isinstance(node, ast.Import)
        for name in (alias.name for alias in node.names)
    }
    assert names == {"json", "queue", "sys", "cbor2", "zenoh"}


@pytest.mark.live
def test_the_program_on_the_page_hears_the_robot_and_stops_it(tmp_path: Path) -> None:
    with Shell(tmp_path, NAMESPACE) as shell, watching(shell) as watcher:
        shell.write(files(PAGE))
        assert shell.run(ROBOT).returncode == 0
        watcher.everybody({"encoder", "robot"})
        where = shell.endpoints.replace(",", " ")
        done = shell.run(f"python stranger.py {NAMESPACE} {where}")
        assert done.returncode == 0, done.stdout
        assert "heading 0.00 rad" in done.stdout
        assert "stopped by stranger" in done.stdout
        assert shell.run("armadico resume").returncode == 0
