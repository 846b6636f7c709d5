"""Table 3.1 of the thesis against the classes: each service that it lists has a message here.

The table is what the directory facilitator knew; here the cards of those that are alive say it. The
thesis has no tables 3.2 to 3.4: what its figures 3.11 to 3.23 say of competition is checked below.
"""

from __future__ import annotations

import pytest

from armadico.core.agent import Agent
from armadico.core.discovery import agent_class
from armadico.core.kernel import subscriptions
from armadico.core.messages import Claim, Command, Message, RobotState
from armadico.core.resources import WHEELS, Resource
from armadico.mobile.messages import Origin, Pose, Sonar, Trajectory
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.resources import PLANNER, TRAJECTORY

WHERE: dict[str, tuple[type[Message], tuple[str, ...]]] = {
    "relative_coordinates": (RobotState, ("x", "y")),
    "relative_heading": (RobotState, ("theta",)),
    "sonar_heading": (Sonar, ("echoes",)),
    "sonar_readings": (Sonar, ("echoes",)),
    "battery_reading": (RobotState, ("battery_v",)),
    "current_linear_speed": (RobotState, ("v",)),
    "current_angular_speed": (RobotState, ("w",)),
    "absolute_coordinates": (Pose, ("x", "y")),
    "absolute_heading": (Pose, ("theta",)),
    "initial_coordinates": (Origin, ("x", "y")),
    "initial_heading": (Origin, ("theta",)),
    "front_closest_obstacle": (Obstacles, ("front",)),
    "closest_obstacle": (Obstacles, ("closest",)),
    "side_closest_obstacles": (Obstacles, ("left", "right")),
    "desired_speeds": (Command, ("action",)),
    "utility": (Claim, ("utility",)),
    "desired_coordinates": (Trajectory, ("waypoints",)),
    "desired_heading": (Trajectory, ("waypoints",)),
}
"""Each service's message here, and its fields; distance and heading of a point come as one."""

SPEEDS = ("current_linear_speed", "current_angular_speed")
TRAJECTORY_POINTS = ("desired_coordinates", "desired_heading")
ABSOLUTE = ("absolute_coordinates", "absolute_heading")
RELATIVE = ("relative_coordinates", "relative_heading")
SONAR = ("sonar_heading", "sonar_readings")
DRIVES = ("desired_speeds", "utility")

PROVIDED = {
    "robot": (*RELATIVE, *SONAR, "battery_reading", *SPEEDS),
    "encoder": ABSOLUTE,
    "sonar": ("front_closest_obstacle", "closest_obstacle", "side_closest_obstacles"),
    "goto": DRIVES,
    "avoid": DRIVES,
}
REQUESTED = {
    "robot": ("desired_speeds",),
    "encoder": (*RELATIVE, "initial_coordinates", "initial_heading"),
    "sonar": (*SONAR, *ABSOLUTE),
    "goto": (*TRAJECTORY_POINTS, *ABSOLUTE),
    "avoid": ("front_closest_obstacle", "closest_obstacle", *TRAJECTORY_POINTS, *ABSOLUTE, *SPEEDS),
}
ONE_AT_A_TIME = {"robot": True, "encoder": False, "sonar": False}
"""The column *mutex*: whether one other agent at a time may use it. Goto and avoid are resources of
the trajectory in the thesis; here the trajectory is one, with an owner."""


def provided(kind: type[Agent]) -> set[type[Message]]:
    return {*kind.provides} | ({Command, Claim} if kind.competes_for else set())


def requested(kind: type[Agent]) -> set[type[Message]]:
    return {subscription.message for subscription in subscriptions(kind)}


@pytest.mark.parametrize("service", sorted(WHERE))
def test_what_a_service_says_is_in_a_message(service: str) -> None:
    message, fields = WHERE[service]
    assert set(fields) <= {*message.__struct_fields__}


@pytest.mark.parametrize("name", sorted(PROVIDED))
def test_an_agent_provides_what_the_table_says(name: str) -> None:
    assert {WHERE[service][0] for service in PROVIDED[name]} <= provided(agent_class(name))


@pytest.mark.parametrize("name", sorted(REQUESTED))
def test_an_agent_requests_what_the_table_says(name: str) -> None:
    assert {WHERE[service][0] for service in REQUESTED[name]} <= requested(agent_class(name))


@pytest.mark.parametrize(("name", "shared"), sorted(ONE_AT_A_TIME.items()))
def test_only_who_is_used_by_one_at_a_time_owns_a_resource(name: str, shared: bool) -> None:
    assert bool(agent_class(name).owns) is shared


@pytest.mark.parametrize(
    ("name", "resources"),
    [
        ("goto", {WHEELS}),  # figure 3.11
        ("avoid", {WHEELS}),  # 3.15
        ("gothrough", {WHEELS}),  # 3.17
        ("localization", set()),  # 3.22
        ("path-planning", set()),  # 3.21
        ("encoder", set()),  # 3.7
        ("sonar", set()),  # 3.9
        ("robot", set()),  # 3.24
        ("interface", set()),  # 3.28
    ],
)
def test_an_agent_competes_for_what_its_figure_says(name: str, resources: set[Resource]) -> None:
    assert {*agent_class(name).competes_for} == resources


@pytest.mark.parametrize(
    ("name", "owned"),
    [("robot", WHEELS), ("path-planning", PLANNER), ("interface", TRAJECTORY)],
)
def test_each_circle_of_figure_3_29_is_a_resource_with_an_owner(name: str, owned: Resource) -> None:
    assert owned in agent_class(name).owns
