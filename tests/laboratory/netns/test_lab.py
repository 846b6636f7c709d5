"""The lab of docs/security.md: three computers with keys, and a stranger who floods the port."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from armadico.core.messages import Ack
from armadico.mesh.door import VIEWER
from armadico_tools.attacks.lab import DESK, FLOODS, LAB, ROBOT, Lab, flooding, killed
from armadico_tools.attacks.pauses import Drive

pytestmark = [pytest.mark.live, pytest.mark.long]

WORST = FLOODS[-1]


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with Lab(tmp_path) as made:
        made.set_up()
        yield made


def test_three_computers_with_keys_drive_and_heal_while_a_stranger_floods_the_port(
    lab: Lab,
) -> None:
    for host in (ROBOT, LAB):
        lab.up(host)
    lab.wait_for_keys()
    with lab.client(VIEWER) as client:
        drive = Drive()
        client.listen(Ack, then=drive.update)
        names = {"robot", "encoder", "goto", "avoid", "interface"}
        lab.until(client, lambda: {n for n, _ in client.alive} >= names, "the society")
        assert "stopped" in lab.call(DESK, "armadico", "stop")
        assert "free" in lab.call(DESK, "armadico", "resume")
        with flooding(lab, WORST):
            for host, agent in ((ROBOT, "encoder"), (LAB, "goto")):
                after = killed(client, drive, WORST.name, host, agent)
                assert after.back is not None, f"{agent} is back"
            assert "stopped" in lab.call(DESK, "armadico", "stop")
