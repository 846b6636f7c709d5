"""People know where the robot stands, and say so with a goal (thesis 5.2.5)."""

from __future__ import annotations

from math import hypot
from typing import Any

from msgspec.structs import replace

from armadico.config.scenarios import load_scenario
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import MissionReply, MissionRequest, Pose, Truth, Waypoint

GOAL, HERE = Waypoint(12.6, 1.2, -1.57), Waypoint(2.2, 3.0, 1.57)


def test_a_kidnapped_robot_is_localized_by_an_initial_pose() -> None:
    run = Rehearsal(replace(load_scenario("house"), goal=None), Options(seed=3))
    said: dict[type, Any] = {}
    run.mesh.watch(lambda _k, message, _t: said.update({type(message): message}), Pose, Truth)
    run.start()
    run.robot.plant.set_pose(HERE.x, HERE.y, HERE.theta)
    run.mesh.run(run.mesh.now + 2.0)
    assert hypot(said[Pose].x - HERE.x, said[Pose].y - HERE.y) > 1.0
    reply = run.client.query(MissionRequest(GOAL, start=HERE), 20.0)
    assert isinstance(reply, MissionReply)
    assert reply.refusal == ""
    run.mesh.run(run.mesh.now + 15.0)
    pose, true = said[Pose], said[Truth]
    assert hypot(true.x - HERE.x, true.y - HERE.y) > 2.0, "it drives"
    assert hypot(pose.x - true.x, pose.y - true.y) < 0.15
    assert true.collisions == 0
