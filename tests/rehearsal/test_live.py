"""A society of real processes is asked first, and is only observed."""

from __future__ import annotations

import json

import pytest

from armadico.launch.client import connect
from armadico.mobile.messages import MissionState, MissionStatus, Pose
from tests.programs import call, starter
from tests.runtime_folder import fresh_folder

SOON_S = 100.0


@pytest.mark.live
def test_running_society_is_asked_and_does_not_move(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", fresh_folder())
    with starter() as start:
        start("up", "sc4")
        with connect() as guest:
            guest.listen(Pose, MissionStatus)
            assert guest.wait_for(lambda: guest.latest(MissionStatus) is not None, SOON_S)
            before = guest.latest(Pose)
            words = ("goto", "3.2", "1.6", "--samples", "1", "--within", "90", "--json")
            done = call("rehearse", *words, within=SOON_S)
            said = json.loads(done.stdout)
            assert (said["answer"], said["of"], done.returncode) == ("yes", 1, 0), said
            guest.wait_for(lambda: None, 0.5)
            after, status = guest.latest(Pose), guest.latest(MissionStatus)
            assert isinstance(before, Pose)
            assert isinstance(after, Pose)
            assert abs(after.x - before.x) < 0.1
            assert abs(after.y - before.y) < 0.1
            assert isinstance(status, MissionStatus)
            assert status.state is MissionState.NONE
