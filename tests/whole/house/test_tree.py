"""Nothing in the tree is specific to one machine, dependencies are locked, licences allow use."""

from __future__ import annotations

import re
from importlib.metadata import metadata
from pathlib import Path

import pytest

from armadico.core.discovery import ROBOTS, installed
from tests.whole.house.tree import ROOT, project

LOCKS = sorted((ROOT / "requirements").glob("*.txt"))


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
