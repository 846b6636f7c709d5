"""Who may import whom: data goes one way, and each line knows its room."""

from __future__ import annotations

import pytest

from tests.whole.house.tree import imports, modules, project, within

SOCKETS = ("socket", "threading", "subprocess", "time", "asyncio", "selectors", "serial", "zenoh")
DRAWING = ("matplotlib", "rerun", "rich", "PIL")

RULES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    # these modules, why, never import these
    (
        "armadico",
        "the framework knows no robot and no capability",
        ("armadico.agents", "armadico.bridge", "armadico_tools"),
    ),
    ("armadico.agents", "agents hold no sockets, threads or clocks", SOCKETS),
    ("armadico.agents", "agents draw nothing", DRAWING),
    (
        "armadico.agents",
        "agents know the mesh and the robot by messages only",
        (
            *("armadico.bridge", "armadico_tools", "armadico.cli", "armadico.mesh"),
            *("armadico.runtime", "armadico.observe", "armadico.launch"),
        ),
    ),
    (
        "armadico.bridge",
        "the robot knows no behaviour, and nobody who looks at it",
        (
            *("armadico.agents", "armadico_tools", "armadico.mesh", "armadico.runtime"),
            *("armadico.observe", "armadico.gateways", "armadico.launch", "armadico.cli"),
        ),
    ),
    (
        "armadico.bridge.robot",
        "the robot agent is an agent: it gets bytes and the time",
        (*SOCKETS, "armadico.bridge.simulator", "armadico.mesh", "armadico.runtime"),
    ),
    (
        "armadico.bridge.p2os",
        "the codec is the robot's and the simulator's, and knows neither",
        (
            *("armadico.bridge.simulator", "armadico.bridge.robot", "armadico.bridge.ros2"),
            "armadico.core.agent",
        ),
    ),
    (
        "armadico.bridge.ros2",
        "the codec is the robot's and the simulator's, and knows neither",
        ("armadico.bridge.simulator", "armadico.bridge.robot", "armadico.bridge.p2os"),
    ),
    (
        "armadico.core",
        "the core knows no pose",
        ("armadico.mobile", "armadico.config", "armadico.mesh", "armadico.runtime"),
    ),
    ("armadico.mobile", "what moves is below what runs it", ("armadico.config", "armadico.mesh")),
)

RUNS = {
    *("command", "explore_command", "run", "local_fleet", "attached_fleet", "view"),
    "page",
    *("up", "down", "supervisor", "virtual_host", "mcp_answers", "mcp_lines", "mcp_server"),
}
"""The modules of a wing that are no agent and no method: its commands, runs and views."""

APART: dict[str, tuple[str, ...]] = {
    # The surface, which looks names up where they are defined; what shows a society to ROS 2 has
    # its words from the bridge, and a command starts a simulator.
    # The contract of robots is about the bridge.
    "armadico": (
        *(
            "armadico",
            "armadico.bridge.ros2.gateway",
            "armadico.bridge.ros2.command",
            "armadico.cli.sim",
        ),
        "armadico.contracts.robots",
    ),
    "armadico.agents": tuple(
        name
        for name in modules()
        if within(name, "armadico.agents") and name.rpartition(".")[2] in RUNS
    ),
}
"""What a rule is not about."""

SANS_IO = (
    *(
        "core.agent",
        "core.coordination",
        "core.exchange",
        "core.cycles",
        "core.fuzzy",
        "mobile.geometry",
        "core.mailbox",
        "observe.measures",
    ),
    *(
        "core.messages",
        "mobile.messages",
        "mobile.resources",
        "mobile.behaviour",
        "mobile.motion",
        "core.resources",
        "mobile.route",
        "mobile.safety",
        "core.services",
        "mobile.swept_path",
        "launch.society",
        "mesh.virtual",
        "mesh.virtual_clock",
        "mesh.virtual_device",
        "mesh.virtual_liveliness",
        "mesh.virtual_network",
        "mesh.virtual_node",
        "mesh.virtual_place",
        "mesh.virtual_queries",
        "mesh.virtual_star",
        "launch.virtual",
    ),
    *(
        "core.membership",
        "observe.diagnosis",
        "observe.findings",
        "observe.standing",
        "observe.view",
        "core.restart_policy",
    ),
)
"""Of the framework: bytes or messages and the time in, bytes or messages out."""

PAGE_SANS_IO = ("model", "own", "part", "requests", "guard")

P2OS_SANS_IO = ("session", "packets", "commands", "status", "configuration", "handshake")

ROS2_SANS_IO = ("cdr", "graph", "types", "zenoh_names")

ZENOH = {"armadico.mesh.zenoh", "armadico.bridge.ros2.rmw_zenoh"}
"""The mesh's, and that of robots whose ROS 2 speaks it: neither knows of the other."""


def of(package: str) -> list[str]:
    """The modules that a rule is about: sub-packages with rules of their own are not."""
    parts = ("armadico.agents", "armadico.bridge", "armadico_tools")
    others = [part for part in parts if part != package and within(part, package)]
    apart = APART.get(package, ())
    return [
        name
        for name in modules()
        if within(name, package)
        and name not in apart
        and not any(within(name, other) for other in (*others, *apart) if other != package)
    ]


def test_an_import_within_a_function_or_for_type_checking_counts() -> None:
    assert "armadico.runtime.process" in imports("armadico.cli.agent")
    assert "armadico.core.agent" in imports("armadico.core.discovery")


@pytest.mark.parametrize(("package", "why", "never"), RULES)
def test_what_is_never_imported(package: str, why: str, never: tuple[str, ...]) -> None:
    names = of(package)
    assert names, f"{package} has modules"
    broken = [
        f"{name} imports {imported}"
        for name in names
        for imported in imports(name)
        if any(within(imported, other) for other in never)
    ]
    assert not broken, why


def agents() -> set[str]:
    """The modules with an agent, by the entry points."""
    points = project()["project"]["entry-points"]["armadico.agents"].values()
    found = {point.partition(":")[0] for point in points}
    return {name for name in found if within(name, "armadico.agents")}


def test_agents_never_import_each_other() -> None:
    assert len(agents()) >= 7
    broken = [f"{name} imports {i}" for name in agents() for i in imports(name) & agents()]
    assert not broken


def test_methods_know_no_agent() -> None:
    methods = of("armadico.agents.methods")
    assert methods
    assert not [name for name in methods if imports(name) & agents()]


WINGS = {name.split(".")[2] for name in modules() if name.startswith("armadico.agents.")}
WINGS -= {"methods"}

REACHES: dict[str, set[str]] = {
    "assistant": {"missions"},
}
"""Which wing needs which other one; every other wing may go alone."""


@pytest.mark.parametrize("wing", sorted(WINGS))
def test_a_wing_needs_no_other_wing(wing: str) -> None:
    names = [n for n in modules() if within(n, f"armadico.agents.{wing}")]
    assert names, wing
    found = {
        i.split(".")[2]
        for name in names
        for i in imports(name)
        if i.startswith("armadico.agents.") and i.split(".")[2] not in (wing, "methods")
    }
    assert found == REACHES.get(wing, set())


def test_who_knows_zenoh_and_the_floors_that_it_is_measured_against() -> None:
    users = {name for name in modules() if any(within(i, "zenoh") for i in imports(name))}
    assert users >= ZENOH
    assert all(name.startswith("armadico_tools.bench") for name in users - ZENOH)


@pytest.mark.parametrize(
    "module",
    [f"armadico.{n}" for n in SANS_IO]
    + [f"armadico.watch.page.{n}" for n in PAGE_SANS_IO]
    + [f"armadico.bridge.p2os.{n}" for n in P2OS_SANS_IO]
    + [f"armadico.bridge.ros2.{n}" for n in ROS2_SANS_IO],
)
def test_what_decides_holds_no_socket_thread_or_clock(module: str) -> None:
    broken = {i for i in imports(module) if any(within(i, other) for other in SOCKETS)}
    assert not broken
