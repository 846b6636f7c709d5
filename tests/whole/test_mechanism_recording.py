"""A recording knows which mechanism decided who drives."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("mcap")

from tests.programs import call


@pytest.mark.long
def test_why_and_audit_of_a_recording_name_the_mechanism(tmp_path: Path) -> None:
    path = str(tmp_path / "run.mcap")
    words = ("run", "sc4", "--virtual", "--sensors", "ideal", "--for", "5", "--no-plot")
    call(*words, "--coordination", "aura", "--record", path)
    found = json.loads(call("why", path, "--json").stdout)
    assert found["mechanisms"] == ["aura"]
    assert any("by award the driving agent changed" in each for each in found["sentences"])
    assert not any("nothing to decide" in each for each in found["sentences"])
    alone = ("--without", "avoid", "--without", "gothrough")
    call(*words, *alone, "--coordination", "auction", "--record", path.replace("run", "alone"))
    told = call("why", path.replace("run", "alone")).stdout
    assert "auction had nothing to decide: no two agents wanted wheels" in told
    notes = json.loads(call("audit", path, "--json").stdout)["notes"]
    assert any("aura" in note for note in notes)
