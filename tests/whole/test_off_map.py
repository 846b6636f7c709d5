"""A robot with a laser drives out of its map, and comes back."""

from __future__ import annotations

from math import hypot, pi
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.config.scenarios import scenario_from
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import (
    Correction,
    MissionRequest,
    MissionState,
    MissionStatus,
    Pose,
    Truth,
    Waypoint,
)
from tests.robot.scans import map_of
from tests.slam.floors import CORRIDOR, ROOM

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]


def test_it_comes_back_to_its_map_with_the_pose_that_it_has_in_truth(tmp_path: Path) -> None:
    """Only localization has the map of the room alone."""
    floor = map_of(tmp_path / "floor.map", [*ROOM, *CORRIDOR])
    room = map_of(tmp_path / "room.map", ROOM)
    options = Options(seed=3, sets=(f"localization.world={room}",))
    begins = scenario_from(floor, (1.5, 2.3, 0.0), (18.0, 2.3, pi), "jackal")
    scenario = replace(begins, sensors="real", goal=None)
    truth: list[Truth] = []
    poses: list[Pose] = []
    off: list[bool] = []
    errors: list[float] = []
    status: list[MissionStatus] = []
    with Rehearsal(prepared(scenario, options), options) as run:

        def on_message(_key: str, message: object, _now: float) -> None:
            match message:
                case Truth():
                    truth.append(message)
                case Pose():
                    poses.append(message)
                    if truth:
                        errors.append(hypot(message.x - truth[-1].x, message.y - truth[-1].y))
                case Correction():
                    off.append(message.off_map)
                case MissionStatus():
                    status.append(message)

        run.mesh.watch(on_message, Truth, Pose, Correction, MissionStatus, namespace=run.namespace)
        run.client.listen(MissionStatus)
        run.start()

        def go(goal: Waypoint) -> MissionState:
            reply = run.client.request_mission(MissionRequest(goal, (), planned=False))
            done = (MissionState.REACHED, MissionState.FAILED)
            run.client.wait_for(
                lambda: (
                    bool(status)
                    and status[-1].mission == reply.mission
                    and status[-1].state in done
                ),
                240.0,
            )
            return status[-1].state

        assert go(Waypoint(18.0, 2.3, pi)) is MissionState.REACHED
        assert off[-1]
        assert errors[-1] < 0.3
        assert go(Waypoint(2.5, 2.3, pi)) is MissionState.REACHED
    assert not off[-1]
    assert errors[-1] < 0.1
    assert max(errors) < 0.5
