"""A recording of protocol 2 (`armadico run sc1 --virtual --seed 3 --record`) is still read.

Of the journals it has goto's alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec import msgpack

from armadico.core.journal import PUBLISH
from armadico.core.judgement import UNKNOWN_EXIT
from armadico.core.messages import OLDEST
from armadico.watch.commands import audit, export, replay, why
from armadico.watch.recordings import Past
from armadico.watch.replay import Life

RECORDED = Path(__file__).parents[1] / "recordings" / "protocol-2.mcap"

Capture = pytest.CaptureFixture[str]


def run(main: Callable[[list[str]], int], capsys: Capture, *words: str, code: int = 0) -> str:
    assert main([str(RECORDED), *words]) == code
    return capsys.readouterr().out


def test_it_is_audited_and_does_not_pass_as_its_keys_name_no_publisher(capsys: Capture) -> None:
    judged = json.loads(run(audit.main, capsys, "--json", code=UNKNOWN_EXIT))
    assert judged["answer"] == "unknown"
    assert "yes" not in {each["answer"] for each in judged["promises"]}
    assert [why.split(",")[0] for why in judged["unread"]] == ["recorded with protocol 2"]


def test_why_names_the_agent_that_drove(capsys: Capture) -> None:
    assert "goto on virtual drives" in run(why.main, capsys)


def test_its_claims_are_exported(capsys: Capture, tmp_path: Path) -> None:
    run(export.main, capsys, "--to", "csv", "--out", str(tmp_path))
    (claims,) = tmp_path.rglob("*utility*")
    assert "goto-" in claims.read_text(encoding="utf-8")


def test_an_agent_is_replayed_with_the_protocol_that_it_was_recorded_with(capsys: Capture) -> None:
    found = Past(RECORDED, pytest.fail).journals()
    (life,) = [Life(journal) for journal in found if journal.head is not None]
    outputs = [msgpack.decode(moment.now) for moment in life.moments() if moment.now]
    keys = {item[1] for each in outputs for item in each if item[0] == PUBLISH}
    assert (life.end, life.raised) == ("", "")
    assert life.agent.kernel.card().speaks == OLDEST
    assert {key for key in keys if "utility" in key} == {"resource/wheels/utility"}
    words = ("--agent", "goto", "--set", "v_max=0.2", "--json")  # so its decisions may differ
    (row,) = json.loads(run(replay.main, capsys, *words))["agents"]
    assert (row["refusal"], row["outputs"] > 100) == ("", True)
