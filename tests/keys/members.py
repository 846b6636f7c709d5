"""A society of all installed agents and guests, with its rights."""

from __future__ import annotations

from functools import cache

from armadico.core.discovery import AGENTS, installed
from armadico.keys.derived import derive
from armadico.keys.rights import Table
from armadico.keys.store import Member
from armadico.mesh.door import CLIENT, MCP, PAGE, ROBOT, ROS2, SIMULATOR, VIEWER, launcher, person

ANNA = person("anna")
ANNA_B = person("anna-b")  # whose instances an expression of Anna's covers, too
LAB = launcher("lab1")
CLAUDE = f"{CLIENT}claude"


def members(namespace: str = "robot1") -> list[Member]:
    """Every installed agent in a process of its own, and every guest."""
    agents = [name for name in installed(AGENTS) if name != ROBOT]
    found = [Member(f"{namespace}/{name}", "agent", (name,)) for name in agents]
    found.append(Member(f"{namespace}/{ROBOT}", ROBOT, (ROBOT,)))
    found.append(Member(f"{namespace}/{CLAUDE}", MCP))
    found += [Member(f"{namespace}/{n}", n) for n in (PAGE, MCP, ROS2, VIEWER, SIMULATOR)]
    found += [Member(f"{namespace}/{name}", "person") for name in (ANNA, ANNA_B)]
    found.append(Member(f"{namespace}/{LAB}", "launcher"))
    return found


@cache
def everybody(namespace: str = "robot1") -> Table:
    return derive(members(namespace), namespace)
