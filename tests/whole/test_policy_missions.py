"""A mission of several tasks that a program orders keeps the policy on all of its paths."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.agents.missions.messages import Board
from armadico.config.scenarios import load_scenario
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Trajectory, Truth
from armadico.watch.assistant.assistant import Assistant
from armadico.watch.assistant.keeper import Parameters
from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from tests.driven import Driven
from tests.watch.test_assistant import Counter

ORDER = AssistantRequest("mission", '{"name": "surveillance"}', "model")


class Ordered(Driven):
    """The world of the mission, an assistant with a policy, and the order of a program."""

    def __init__(self, policy: str, folder: Path) -> None:
        options = Options(seed=3, sensors="ideal")
        scenario = prepared(load_scenario("surveillance"), options)
        super().__init__(Rehearsal(scenario, options), Truth, Trajectory, Board)
        (path := folder / "policy.toml").write_text(policy)
        self.run.add(Assistant, Parameters(policy=str(path), world=scenario.world))
        self.run.start()
        self.let_pass(3.0)
        self.replies: list[AssistantReply] = []
        self.mesh.query(ORDER, self.replies.append, 40.0)  # type: ignore[arg-type]


def test_its_speed_is_capped_on_the_way(tmp_path: Path) -> None:
    ordered = Ordered("[default]\nv_max = 0.2\n", tmp_path)
    ordered.let_pass(25.0)
    assert ordered.replies[0].mission
    driven = [each for each in ordered.of(Trajectory) if each.waypoints]
    assert driven
    assert all(each.terms is not None and each.terms.v_max == 0.2 for each in driven)
    speeds = [abs(each.v) for each in ordered.of(Truth)]
    assert 0.15 < max(speeds) < 0.21


def test_it_is_cancelled_where_a_path_leaves_the_area(tmp_path: Path) -> None:
    ordered = Ordered('[default]\nrooms = ["R1"]\n', tmp_path)
    ordered.let_pass(8.0)
    (mission,) = ordered.last(Board).missions
    assert mission.state.value == "cancelled"
    moved = [abs(each.v) for each in ordered.of(Truth)]
    assert moved[-1] == 0.0


def test_a_mission_with_a_task_that_cannot_be_limited_is_refused(tmp_path: Path) -> None:
    (path := tmp_path / "policy.toml").write_text("[default]\nv_max = 0.3\n")
    refusal = Counter(policy=str(path)).refusal("mission", name="rounds")
    assert "and dock cannot be limited" in refusal


@pytest.mark.parametrize(
    ("policy", "refused"),
    [("v_max = 0.3", False), ('forbidden = ["mission"]', True), ("goals_an_hour = 0", True)],
)
def test_a_mission_is_a_goal_of_the_policy(policy: str, refused: bool, tmp_path: Path) -> None:
    (path := tmp_path / "policy.toml").write_text(f"[default]\n{policy}\n")
    counter = Counter(policy=str(path))
    reply = counter.request("mission", name="surveillance")
    assert (reply is not None and "policy" in reply.refusal) == refused
    assert bool(counter.queries) != refused
