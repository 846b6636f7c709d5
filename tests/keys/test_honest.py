"""No honest society is hindered: the rights cover every message of whole societies."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from armadico.cli import main
from armadico.core.discovery import AGENTS, installed
from armadico.keys.rights import Does
from tests.keys.traffic import recorded

SOCIETIES = {
    "sc4": ("run sc4 --for 8", ()),
    "people": ("run floor-people --for 10", ()),
    "alarms and a charger": ("run surveillance --for 60", ("mission-planning",)),
    "slam": ("explore rooms-a --profile jackal --for 8", ("slam", "explore")),
    "fleet": ("run fleet --robots 2 --for 8", ("fleet",)),
}
"""Commands, and the agents that they need."""

OPTIONS = ("--virtual", *(("--no-plot",) if find_spec("armadico.watch") else ()))


@pytest.mark.long(but=("sc4", "people", "slam", "fleet"))
@pytest.mark.parametrize(("words", "needed"), SOCIETIES.values(), ids=SOCIETIES)
def test_the_rights_cover_whatever_a_society_sends(
    words: str, needed: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if lacking := {*needed} - installed(AGENTS).keys():
        pytest.skip(f"not installed: {', '.join(lacking)}")
    if "jackal" in words:
        pytest.importorskip("armadico.bridge.ros2")
    monkeypatch.chdir(tmp_path)
    with recorded() as traffic:
        main([*words.split(), *OPTIONS])
    kinds = {sent.does for sent in traffic.sent}
    assert kinds == {*Does} - {Does.DELETE, Does.WATCH, Does.LOOK}  # declared by every client
    assert not traffic.refused
