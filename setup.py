"""The wheel is pure Python; with ARMADICO_COMPILE=1 what agents stand on is compiled in it.

mypyc needs everything that they import, so it is built without isolation where the development
dependencies are: `make compiled`.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from setuptools import setup

if TYPE_CHECKING:
    from setuptools import Extension

ROOT = Path(__file__).resolve().parent
COMPILED = (
    *(
        "armadico/core/agent",
        "armadico/core/driver",
        "armadico/core/journal",
        "armadico/core/mailbox",
        "armadico/core/latched",
    ),
    *("armadico/core/coordination", "armadico/core/cycles", "armadico/core/exchange"),
    *("armadico/core/resources", "armadico/core/services", "armadico/core/geometry"),
    *("armadico/core/motion", "armadico/core/route", "armadico/core/safety"),
    "armadico/core/swept_path",
    *("armadico/mesh/virtual", "armadico/mesh/virtual_network", "armadico/mesh/virtual_session"),
    *("agents/methods/geometry", "agents/methods/free_heading", "agents/methods/local_map"),
    *("agents/methods/known_walls", "agents/methods/rows"),
    *("bridge/framing", "bridge/reflex", "bridge/p2os/packets"),
)
"""What a virtual second goes into, and `bridge/simulator`. Agents are not: everybody's are Python.
Nor is what declares types for msgspec: it reads them as they are written, and mypyc drops that."""

APART = ("__init__", "command", "ros2_line", "server")
"""Of `bridge/simulator`: nothing to compile, and what waits rather than computes."""


def compiled() -> list[Extension]:
    """The pattern of an agent, the virtual mesh, the methods and the simulated robot, by mypyc."""
    from mypyc.build import mypycify  # noqa: PLC0415 - not for the pure wheel

    robot = sorted((ROOT / "bridge" / "simulator").glob("*.py"))
    names = [*COMPILED, *(f"bridge/simulator/{p.stem}" for p in robot if p.stem not in APART)]
    modules = [f"armadico/{name.removeprefix('armadico/')}.py" for name in names]
    # From here, where setuptools runs this: mypyc names a module by its path.
    made: list[Extension] = mypycify(
        ["--config-file", "pyproject.toml", *modules],
        group_name="armadico",
        target_dir="build/mypyc",
    )
    return made


setup(ext_modules=compiled() if os.environ.get("ARMADICO_COMPILE") == "1" else [])
