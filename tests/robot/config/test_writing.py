"""Files that are replaced."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from armadico.config.writing import write_files


def test_what_replaces_a_file_is_on_the_disk_before_it_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    replace, fsync = Path.replace, os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (done.append("fsync"), fsync(fd)))
    monkeypatch.setattr(Path, "replace", lambda *a: (done.append("replace"), replace(*a)))
    write_files({tmp_path / "map.yaml": b"new"})
    assert done == ["fsync", "replace", "fsync"]
    assert (tmp_path / "map.yaml").read_bytes() == b"new"
