"""Nothing in the tree is specific to one machine, dependencies are locked, licences allow use."""

from __future__ import annotations

import ast
import re
from importlib.metadata import metadata
from pathlib import Path

import pytest

from armadico.core.discovery import ROBOTS, installed
from tests.whole.house.tree import ROOT, project, text_files, tree

MACHINE = re.compile(r"/(?:work|root|home|Users|mnt)/\w")
LOCKS = sorted((ROOT / "requirements").glob("*.txt"))


def test_nothing_names_a_path_of_somebodys_machine() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {hit[0]}"
        for path in text_files()
        for hit in MACHINE.finditer(path.read_text(encoding="utf-8", errors="replace"))
    ]
    assert not found


def test_no_test_waits_by_sleeping() -> None:
    sleepers = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in (ROOT / "tests").rglob("test_*.py")
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call)
        and getattr(node.func, "attr", getattr(node.func, "id", "")) == "sleep"
        and ast.unparse(node.func) in {"time.sleep", "sleep"}
    ]
    assert not sleepers


def test_the_licence_is_there_and_is_the_one_that_is_claimed() -> None:
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "Apache License" in text
    assert "Version 2.0" in text
    assert project()["project"]["license"] == "Apache-2.0"
    assert project()["project"]["license-files"] == ["LICENSE"]


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.name)
def test_locks_have_hashes_and_no_addresses(lock: Path) -> None:
    text = lock.read_text(encoding="utf-8")
    parts = re.split(r"\n(?=[\w.-]+==)", text)
    assert len(parts) == len(locked(text)) > 0
    assert not [part.partition("==")[0] for part in parts if "--hash=sha256:" not in part]
    assert not re.search(r"https?:|^--", text, re.MULTILINE)


def test_every_dependency_is_locked() -> None:
    names = {name.partition("==")[0] for name in locked(LOCKS_TEXT["run.txt"])}
    wanted = {re.split(r"[<>=!~\[ ]", d)[0].lower() for d in project()["project"]["dependencies"]}
    assert wanted <= names


def test_whatever_robot_is_shipped_is_simulated_after_make_run() -> None:
    names = {name.partition("==")[0] for name in locked(LOCKS_TEXT["run.txt"])}
    for found in installed(ROBOTS).values():
        assert {*found.load().needs} <= names, found.name


def test_no_dependency_carries_the_gpl() -> None:
    for name in (line.partition("==")[0] for line in locked(LOCKS_TEXT["run.txt"])):
        about = metadata(name).json
        said = [str(about.get(key, ""))[:80] for key in ("license_expression", "license")]
        said += [c for c in about.get("classifier", []) if c.startswith("License")]
        assert any(said), f"{name} says nothing of its licence"
        assert not any(re.search(r"\bL?A?GPL|General Public License", s) for s in said), name


def locked(text: str) -> list[str]:
    """The pinned names of a lock file."""
    return re.findall(r"^[\w.-]+==[\w.]+", text, re.MULTILINE)


LOCKS_TEXT = {path.name: path.read_text(encoding="utf-8") for path in LOCKS}
