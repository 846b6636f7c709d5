"""Every agent decides what it decided in the recording that is shipped.

A difference that is meant: `python -m tests.laboratory.recorded`, and the commit says what is
decided otherwise, and why.
"""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mcap")

from armadico.watch.recordings import Past
from armadico.watch.replay import Outcome, replayed
from tests.laboratory.recorded import SHIPPED, make


def replay(path: Path) -> list[Outcome]:
    past = Past(path, pytest.fail)
    past.check()
    return [replayed(journal) for journal in past.journals()]


def test_every_agent_decides_what_it_did() -> None:
    outcomes = replay(SHIPPED)
    assert {o.name for o in outcomes} >= {"robot", "encoder", "sonar", "goto", "avoid", "gothrough"}
    assert sum(outcome.name == "goto" for outcome in outcomes) == 2  # it was killed, and came back
    for outcome in outcomes:
        assert outcome.equal, f"{outcome.instance}: {outcome.refusal or outcome.difference}"
        assert not outcome.end


def test_what_is_made_anew_is_replayed_too(tmp_path: Path) -> None:
    make(tmp_path / "again.mcap")
    assert all(outcome.equal and outcome.outputs for outcome in replay(tmp_path / "again.mcap"))
