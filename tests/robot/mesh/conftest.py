"""The meshes of the core's tests, virtual and real."""

from tests.core.mesh.conftest import client, crowd, enter, join, route

__all__ = ["client", "crowd", "enter", "join", "route"]
