"""A short soak: agents are killed while the robot drives and certificates are renewed."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico_tools.attacks.soak import soak

pytestmark = [pytest.mark.live, pytest.mark.long]


def test_killed_agents_are_back_and_no_link_is_lost(tmp_path: Path) -> None:
    lines: list[str] = []
    found = soak(tmp_path, 0.75, keys=True, certificate_s=36.0, report=lines.append)
    assert found.holds, lines
    assert not found.lost, lines
    assert found.kills.total() > 0
    assert found.descriptors.keys() == {"robot agent", "porter"}
