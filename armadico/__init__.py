"""ARMADiCo: agents on one mesh drive one robot, and nobody is in charge.

The public names are imported from here. Only these are stable, and the interface for a kind of
robot (`armadico.bridge.kind`, `armadico.bridge.session`):

    from armadico import Behaviour, Bid, Obstacles, Pose      # an agent of one's own
    armadico.run("sc4", virtual=True, seed=7).measures         # a run, from Python
    with armadico.connect() as guest: guest.goto(2.0, 0.0, 0.0)

`import armadico` loads nothing: a name is imported from its module when it is first used.
"""

TYPE_CHECKING = False  # type checkers treat it as true by its name; importing `typing` is slow
if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.core.agent import Agent, DeviceAgent, Identity, Question
    from armadico.core.config_errors import ConfigError
    from armadico.core.errors import UnknownNameError
    from armadico.core.exchange import Bid
    from armadico.core.messages import (
        Ack,
        Ask,
        Ballot,
        BidHistory,
        BidRecord,
        Card,
        Claim,
        Command,
        Cycle,
        Description,
        Latched,
        Log,
        Message,
        MessageError,
        Parameter,
        ParametersReply,
        Point,
        RobotState,
        Stop,
    )
    from armadico.core.parameters import Parameters, Safety
    from armadico.core.resources import WHEELS, Resource
    from armadico.core.services import Kind, Service, register
    from armadico.launch.api import Holding, Run, run
    from armadico.launch.client import Client, Mission, connect
    from armadico.mesh.topology import MeshError, TopologyError
    from armadico.mobile.behaviour import Behaviour
    from armadico.mobile.messages import (
        Cell,
        Echo,
        LocalMap,
        MissionReply,
        MissionRequest,
        MissionState,
        MissionStatus,
        Origin,
        Plan,
        Planned,
        PlanRequest,
        PlanTask,
        Pose,
        Sonar,
        Trajectory,
        Truth,
        Waypoint,
    )
    from armadico.mobile.obstacles import Obstacles
    from armadico.mobile.resources import PLANNER
    from armadico.mobile.route import Route
    from armadico.observe.measures import Mark, Result
    from armadico.rehearsal.api import rehearse
    from armadico.runtime.errors import (
        AbsentError,
        AgentFailedError,
        MissionRefusedError,
        MissionReplacedError,
        ParameterError,
        RunFailedError,
        SocietyError,
        StopError,
    )

__all__ = [
    "PLANNER",
    "WHEELS",
    "AbsentError",
    "Ack",
    "Agent",
    "AgentFailedError",
    "Ask",
    "Ballot",
    "Behaviour",
    "Bid",
    "BidHistory",
    "BidRecord",
    "Card",
    "Cell",
    "Claim",
    "Client",
    "Command",
    "ConfigError",
    "Cycle",
    "Description",
    "DeviceAgent",
    "Echo",
    "Holding",
    "Identity",
    "Kind",
    "Latched",
    "LocalMap",
    "Log",
    "Mark",
    "MeshError",
    "Message",
    "MessageError",
    "Mission",
    "MissionRefusedError",
    "MissionReplacedError",
    "MissionReply",
    "MissionRequest",
    "MissionState",
    "MissionStatus",
    "Obstacles",
    "Origin",
    "Parameter",
    "ParameterError",
    "Parameters",
    "ParametersReply",
    "Plan",
    "PlanRequest",
    "PlanTask",
    "Planned",
    "Point",
    "Pose",
    "Question",
    "Resource",
    "Result",
    "RobotState",
    "Route",
    "Run",
    "RunFailedError",
    "Safety",
    "Scenario",
    "Service",
    "SocietyError",
    "Sonar",
    "Stop",
    "StopError",
    "TopologyError",
    "Trajectory",
    "Truth",
    "UnknownNameError",
    "Waypoint",
    "connect",
    "register",
    "rehearse",
    "run",
]

_MODULES = {
    "rehearsal.api": ("rehearse",),
    "core.config_errors": ("ConfigError",),
    "config.scenarios": ("Scenario",),
    "core.agent": (
        "Agent",
        "DeviceAgent",
        "Identity",
        "Question",
    ),
    "core.errors": ("UnknownNameError",),
    "core.exchange": ("Bid",),
    "core.parameters": (
        "Parameters",
        "Safety",
    ),
    "core.resources": (
        "WHEELS",
        "Resource",
    ),
    "core.services": (
        "Kind",
        "Service",
        "register",
    ),
    "launch.api": (
        "Holding",
        "Run",
        "run",
    ),
    "mesh.topology": (
        "MeshError",
        "TopologyError",
    ),
    "mobile.behaviour": ("Behaviour",),
    "mobile.messages": (
        "Cell",
        "Echo",
        "LocalMap",
        "MissionReply",
        "MissionRequest",
        "MissionState",
        "MissionStatus",
        "Origin",
        "Plan",
        "Planned",
        "PlanRequest",
        "PlanTask",
        "Pose",
        "Sonar",
        "Trajectory",
        "Truth",
        "Waypoint",
    ),
    "mobile.obstacles": ("Obstacles",),
    "mobile.resources": ("PLANNER",),
    "mobile.route": ("Route",),
    "observe.measures": (
        "Mark",
        "Result",
    ),
    "launch.client": (
        "Client",
        "Mission",
        "connect",
    ),
    "runtime.errors": (
        "AbsentError",
        "AgentFailedError",
        "MissionRefusedError",
        "MissionReplacedError",
        "ParameterError",
        "RunFailedError",
        "SocietyError",
        "StopError",
    ),
}
"""The modules of the public names; all others are in `core.messages`."""


_MOVED = {
    **dict.fromkeys(
        (
            *("Beliefs", "Charge", "Done", "Drive", "Explore", "Failed", "Going", "PlanStep"),
            *("Planner", "Progress", "Reach", "Stand", "SubplanRequest", "Surprise", "Task"),
        ),
        "agents.missions.api",
    ),
    **dict.fromkeys(("Stick", "TeleopStatus"), "watch.teleop.messages"),
}
"""Names that were public here, and their modules."""


if not TYPE_CHECKING:  # otherwise type checkers would accept any name

    def __getattr__(name: str) -> object:
        """Return a public name from its module (PEP 562)."""
        if name in _MOVED:
            raise ImportError(f"from armadico.{_MOVED[name]} import {name}: it has moved there")
        if name not in __all__:
            raise AttributeError(f"module 'armadico' has no attribute {name!r}")
        from importlib import import_module

        where = next((m for m, names in _MODULES.items() if name in names), "core.messages")
        found = getattr(import_module(f"armadico.{where}"), name)
        globals()[name] = found  # cached
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
