"""SLAM while the robot drives: the map moves by a metre under way, and the society goes along."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import cos, hypot, pi, sin
from pathlib import Path
from random import Random
from typing import NamedTuple

import pytest
from msgspec.structs import replace

from armadico.bridge.simulator.encoders import Odometry
from armadico.config.profile import load_profile
from armadico.config.scenarios import exploring, load_scenario, scenario_from, with_slam
from armadico.core.messages import Command
from armadico.core.resources import WHEELS
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import (
    Correction,
    MapMoved,
    MissionRequest,
    MissionState,
    MissionStatus,
    OccupancyGrid,
    Pose,
    Truth,
    Waypoint,
)
from armadico.runtime.errors import MissionRefusedError

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

LONG, HIGH, WIDE = 16.0, 12.0, 2.4
MIDDLE = WIDE / 2
STARTS, ENDS = (2.0, MIDDLE, 0.0), (6.0, MIDDLE, 0.0)
BOXES = (
    *((1.0, 0.0, 0.5, 0.3), (2.6, 0.0, 0.3, 0.35), (4.0, 0.0, 0.7, 0.25)),
    *((3.2, WIDE - 0.3, 0.4, 0.3), (5.2, WIDE - 0.35, 0.3, 0.35), (5.6, 0.0, 0.3, 0.3)),
    *((0.0, 1.2, 0.3, 0.5), (0.0, 3.0, 0.25, 0.4)),
)
"""x, y, width and height: only here a scan of 4 m tells the place along the corridor."""


def ring(folder: Path) -> Path:
    """A map of a bare corridor in a ring, with boxes at its start."""
    inner = (WIDE, WIDE, LONG - 2 * WIDE, HIGH - 2 * WIDE)
    lines = []
    for x, y, w, h in ((0.0, 0.0, LONG, HIGH), inner, *BOXES):
        corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)]
        lines += [(*a, *b) for a, b in pairwise(corners)]
    head = ["2D-Map", "LineMinPos: 0 0", f"LineMaxPos: {LONG * 1000:.0f} {HIGH * 1000:.0f}"]
    body = [" ".join(f"{1000 * value:.0f}" for value in line) for line in lines]
    path = folder / "ring.map"
    path.write_text("\n".join([*head, f"NumLines: {len(lines)}", "LINES", *body, "DATA", ""]))
    return path


@pytest.fixture
def slippery(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wheels that slip by 6 % on the first two sides, and by 12 % at random everywhere."""
    rng, rolls = Random(1), Odometry.move
    patch = {"left": 0.0, "scale": 1.0}

    def move(self: Odometry, left_m: float, right_m: float) -> None:
        patch["left"] -= abs(left_m + right_m) / 2
        if patch["left"] <= 0.0:
            patch["left"] += 0.4
            patch["scale"] = 1.0 + rng.gauss(0.0, 0.12)
        outward = cos(self.theta) > 0.7 or sin(self.theta) > 0.7
        scale = patch["scale"] + (0.06 if outward else 0.0)
        rolls(self, left_m * scale, right_m * scale)

    monkeypatch.setattr(Odometry, "move", move)


class Round(NamedTuple):
    """What was seen of a round through the ring."""

    truth: list[Truth]
    poses: list[Pose]
    corrections: dict[int, Correction]  # by cycle
    grids: list[tuple[int, OccupancyGrid]]  # with the cycle
    changes: list[tuple[int, MapMoved]]
    speeds: list[tuple[int, float, float]]  # commanded in a cycle: m/s, rad/s
    state: MissionState


def driven(folder: Path) -> Round:
    """Drive round the ring; the last goal lies beyond the place where the loop closes."""
    parameters = folder / "set.toml"
    parameters.write_text("[slam]\nmax_range = 4.0\n")
    options = Options(seed=1, parameters=str(parameters))
    begins = scenario_from(ring(folder), STARTS, ENDS, "jackal")
    agents = with_slam(begins.agents)
    changed = replace(begins, plan="frontiers", sensors="real", agents=agents, goal=None)
    seen = Round([], [], {}, [], [], [], MissionState.NONE)
    status: list[MissionStatus] = []
    with Rehearsal(prepared(changed, options), options) as run:

        def on_message(_key: str, message: object, _now: float) -> None:
            now = seen.poses[-1].cycle.number if seen.poses else 0
            match message:
                case Truth():
                    seen.truth.append(message)
                case Pose():
                    seen.poses.append(message)
                case Correction():
                    seen.corrections[message.cycle.number] = message
                case OccupancyGrid():
                    seen.grids.append((now, message))
                case MapMoved():
                    seen.changes.append((now, message))
                case MissionStatus():
                    status.append(message)
                case Command() if message.resource == WHEELS.name and message.action:
                    v, w = WHEELS.unpack(message.action)
                    seen.speeds.append((message.cycle.number, v, w))

        kinds = (Truth, Pose, Correction, OccupancyGrid, MapMoved, MissionStatus, Command)
        run.mesh.watch(on_message, *kinds, namespace=run.namespace)
        run.client.listen(MissionStatus)
        run.start()

        def on_map(x: float, y: float, theta: float) -> Waypoint:
            """A true pose where the robot's map has it now, as a person would point at it."""
            pose, true = seen.poses[-1], seen.truth[-1]
            here: Pose2 = pose.x, pose.y, pose.theta
            return Waypoint(*compose(here, relative((true.x, true.y, true.theta), (x, y, theta))))

        def go(goal: Waypoint, *through: Waypoint) -> MissionState:
            reply = run.client.request_mission(MissionRequest(goal, through, planned=False))
            run.client.wait_for(
                lambda: (
                    bool(status)
                    and status[-1].mission == reply.mission
                    and status[-1].state in (MissionState.REACHED, MissionState.FAILED)
                ),
                120.0,
            )
            return status[-1].state

        right, top = LONG - MIDDLE, HIGH - MIDDLE
        for x, y, theta in (
            *((LONG / 2, MIDDLE, 0.0), (right, MIDDLE, pi / 2), (right, HIGH / 2, pi / 2)),
            *((right, top, pi), (LONG / 2, top, pi), (MIDDLE, top, -pi / 2)),
            (MIDDLE, HIGH / 2, -pi / 2),
        ):
            assert go(on_map(x, y, theta)) is MissionState.REACHED
        return seen._replace(state=go(Waypoint(*ENDS), on_map(MIDDLE, MIDDLE, 0.0)))


def accelerations(seen: Round) -> Iterator[tuple[int, float, float]]:
    """Of the commands of following cycles: the cycle, m/s^2, rad/s^2."""
    for (before, v, w), (cycle, to_v, to_w) in pairwise(seen.speeds):
        if cycle == before + 1:
            yield cycle, (to_v - v) / 0.1, (to_w - w) / 0.1


@pytest.mark.usefixtures("slippery")
def test_a_loop_that_closes_by_a_metre_while_the_robot_drives_is_no_bump(tmp_path: Path) -> None:
    seen = driven(tmp_path)
    begun, change = seen.changes[0], seen.changes[1]
    assert (begun[1].revision, begun[1].places) == (1, ())
    moved = max(hypot(at.to_x - at.x, at.to_y - at.y) for at in change[1].places)
    assert moved > 0.8
    # One revision in a cycle, and the pose goes along in the next.
    cycle = change[0]
    assert seen.corrections[cycle].revision == change[1].revision
    assert seen.corrections[cycle - 1].revision == begun[1].revision
    assert [grid.revision for at, grid in seen.grids if at == cycle] == [change[1].revision]
    poses = {pose.cycle.number: pose for pose in seen.poses}
    assert [poses[cycle + k].revision for k in (0, 1)] == [1, 2]
    leap = hypot(poses[cycle + 1].x - poses[cycle].x, poses[cycle + 1].y - poses[cycle].y)
    assert leap > 0.8
    # No jolt: the commands stay within the profile's limits.
    limits = load_profile("jackal").limits
    near = [each for each in accelerations(seen) if cycle - 3 <= each[0] <= cycle + 20]
    assert max(v for _, v, _ in near) <= limits.v_accel + 1e-6
    assert min(v for _, v, _ in near) >= -limits.v_decel - 1e-6
    assert max(abs(w) for _, _, w in near) <= limits.w_accel + 1e-6
    assert any(v > 0.1 for at, v, _ in seen.speeds if cycle <= at <= cycle + 2), "it drives"
    assert seen.state is MissionState.REACHED
    ends = seen.truth[-1]
    assert hypot(ends.x - ENDS[0], ends.y - ENDS[1]) < 0.15
    assert ends.collisions == 0


def test_in_the_society_that_explored_a_goal_in_another_room_is_driven_to() -> None:
    options = Options(seed=1)
    scenario = exploring(prepared(load_scenario("house"), options, profile="jackal"))
    truth: list[Truth] = []
    with Rehearsal(scenario, options) as run:
        run.mesh.watch(lambda _, message, __: truth.append(message), Truth)
        assert run.run().reached
        for x, y in ((12.6, 1.2), (2.0, 2.0)):
            assert run.client.goto(x, y).wait(200.0)
            assert hypot(truth[-1].x - x, truth[-1].y - y) < 0.2
        assert truth[-1].collisions == 0
        for x, y, why in ((30.0, 30.0, "not known yet"), (0.0, 0.0, "inside a wall")):
            with pytest.raises(MissionRefusedError, match=why):
                run.client.goto(x, y)
