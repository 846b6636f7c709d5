"""No honest society is hindered: the rights cover every message of whole societies."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.cli import main
from armadico.keys.rights import Does
from tests.keys.traffic import recorded

SOCIETIES = {
    "sc4": "run sc4 --for 30",
    "people": "run floor-people --for 15",
    "alarms and a charger": "run surveillance --for 60",
    "slam": "explore rooms-a --profile jackal --for 20",
    "fleet": "run fleet --for 20",
}


@pytest.mark.parametrize("words", SOCIETIES.values(), ids=SOCIETIES)
def test_the_rights_cover_whatever_a_society_sends(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with recorded() as traffic:
        main([*words.split(), "--virtual", "--no-plot"])
    kinds = {sent.does for sent in traffic.sent}
    assert kinds == {*Does} - {Does.DELETE, Does.WATCH, Does.LOOK}  # declared by every client
    assert not traffic.refused
