"""The meshes of the core's tests, virtual and real."""

from tests.core.mesh.conftest import crowd, join, route

__all__ = ["crowd", "join", "route"]
